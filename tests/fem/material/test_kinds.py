"""The laws that a scene can name, and what a scene file says of them."""

import tomllib

import numpy as np
import pytest

from fem import settings
from fem.data.scene import Scene
from fem.errors import InputError
from fem.material import KINDS, Hyperelastic, MooneyRivlin, NeoHooke, Ogden
from fem.material.kinds import from_table, to_table

TABLES = {
    "neo_hooke": {"mu": 400, "nu": 0.42, "density": 1000.0},
    "mooney_rivlin": {"c10": 150.0, "c01": 50.0, "nu": 0.42, "density": 1000.0},
    "ogden": {"terms": [[40.0, 8.0], [-60, -4]], "nu": 0.42, "density": 1000.0},
}


@pytest.mark.parametrize("kind", KINDS)
def test_scene_names_a_law(kind, tiny):
    """`kind` picks the class, and the scene that is written is the scene that was read."""
    tiny["material"] = {"kind": kind, "prony": [[0.12, 330.0]]} | TABLES[kind]
    scene = settings.build(Scene, tiny)
    assert type(scene.material) is KINDS[kind] and scene.material.prony == ((0.12, 330.0),)
    again = settings.build(Scene, tomllib.loads(scene.toml()))
    assert again == scene and again.digest() == scene.digest()
    solver = scene.build_solver(scene.mesh.build())
    load = np.where(solver.mesh.fixed, 0.0, np.array([[0.0], [0.0], [-1e-5]]))
    solver.advance(5e-3, lambda t: load)
    assert solver.steps > 1 and solver.u[2].min() < 0


def test_default_is_not_written(tiny):
    """A scene without `kind` is neo-Hookean, and is written and numbered as before there were
    others."""
    scene = settings.build(Scene, tiny)
    tiny["material"]["kind"] = "neo_hooke"
    assert settings.build(Scene, tiny) == scene
    assert (
        type(scene.material) is NeoHooke and "kind" not in tomllib.loads(scene.toml())["material"]
    )
    assert list(to_table(scene.material)) == ["mu", "nu", "density", "prony"]


@pytest.mark.parametrize(
    "table, message",
    [
        ({"kind": "mooney"}, "material.kind = 'mooney' is not one of .*; the nearest is 'mooney_r"),
        ({"kind": 3}, "material.kind = 3 is not one of"),
        (
            {"kind": "mooney_rivlin", "mu": 400.0},
            "unknown key 'material.mu'; the nearest valid one",
        ),
        ({"kind": "mooney_rivlin", "c10": 1.0}, "'material.c01' is missing"),
        ({"kind": "ogden", "terms": [[1.0]]}, r"material.terms\[0\] = .* must have 2 entries"),
        ({"c10": 400.0}, "unknown key 'material.c10'"),
        ({"mu": "soft"}, "material.mu = 'soft' must be a number"),
        ("soft", "'material' must be a table"),
    ],
)
def test_what_a_law_does_not_have_is_refused(table, message):
    """An unknown kind and a parameter of another law are errors that name the nearest."""
    with pytest.raises(InputError, match=message):
        from_table(table)


def test_what_a_file_cannot_hold_is_refused():
    """A law of one's own and one value a cell have no place in a scene file."""

    class Own(NeoHooke):
        pass

    with pytest.raises(InputError, match="a scene file cannot hold a material Own; use one of"):
        to_table(Own(400.0, 0.42, 1000.0))
    with pytest.raises(InputError, match="cannot hold material.mu with one value a cell"):
        to_table(NeoHooke([400.0, 300.0], 0.42, 1000.0))
    with pytest.raises(InputError, match="cannot hold material.terms"):
        to_table(Ogden(((np.array([400.0, 300.0]), 2.0),), 0.42, 1000.0))


def test_numbers_of_numpy_make_the_same_law():
    """np.float64, int and lists are stored as float and tuples, so that equal laws are written
    alike."""
    law, plain = NeoHooke(np.float64(400), 0.42, 1000, [[0.5, 1]]), NeoHooke(400.0, 0.42, 1000.0)
    assert law.elastic() == plain and type(law.mu) is float and law.prony == ((0.5, 1.0),)
    assert to_table(law.elastic()) == to_table(plain)
    assert issubclass(MooneyRivlin, Hyperelastic)
