"""Scenes built in Python: equal settings are equal however they are given, and none is ignored."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from fem import settings as config
from fem.contact.draw import ContactRange
from fem.data.scene import Frames, Health, Interactions, MeshChoice, Scene, SolverChoice
from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box, tumour
from fem.solver.explicit import Solver
from fem.solver.quasistatic import QuasiStatic


def scene(kind=float, pair=tuple):
    """A scene whose numbers are of type `kind` and whose pairs are of type `pair`."""
    return Scene(
        NeoHooke(kind(400), 0.42, 1000.0, ((0.5, 11.0),)),
        ContactRange(2, pair([kind(1), kind(2)]), force=pair([kind(0), kind(3)]), cone=kind(30)),
        Frames(3, kind(1)),
        Interactions(1, 2, 1, 2, hard=pair([1, 2]), hard_force=pair([kind(2), kind(2)])),
        MeshChoice("box", edge=kind(1), cells=pair([4, 4, 2])),
        SolverChoice(damping=kind(40), mass_scaling=kind(4)),
        Health(min_J=kind(0)),
    )


@pytest.mark.parametrize("kind", [int, np.float64, np.float32, np.int64])
@pytest.mark.parametrize("pair", [tuple, list, np.array])
def test_equal_scenes_are_equal_however_they_are_written(kind, pair):
    """Ints for floats, lists and arrays for tuples and NumPy's numbers make the same scene, text
    and digest, and the text reads back as the scene."""
    one, other = scene(), scene(kind, pair)
    assert one == other and one.digest() == other.digest() and one.toml() == other.toml()
    assert hash(one) == hash(other)
    assert config.build(Scene, tomllib.loads(other.toml())) == one


def test_without_hard_tests_none_is_hard():
    """`hard` may be left out: fewer than 85 tests have none, from 85 on they are the paper's."""
    few, many = Interactions(1, 2, 1, 8), Interactions(1, 2, 1, 100)
    assert few.hard is None and not any(few.is_hard(*which) for which in few.all())
    assert many.hard == (78, 85) and many.hard_force == (1.3, 1.6)
    assert [n for split, n in many.all() if many.is_hard(split, n)] == list(range(78, 86))
    other = replace(scene(), interactions=few)
    assert config.build(Scene, tomllib.loads(other.toml())) == other
    with pytest.raises(InputError, match=r"hard_force = \[2.0, 3.0\] has no meaning without"):
        Interactions(1, 2, 1, 8, hard_force=(2.0, 3.0))


def test_every_interaction_of_the_hard_set_is_hard():
    """They come after all others, whether or not some tests are hard; without them there is no such
    split."""
    for hard in (None, (2, 3)):
        chosen = Interactions(1, 2, 1, 4, hard=hard, hard_set=3)
        assert chosen.all() == [
            *Interactions(1, 2, 1, 4, hard=hard).all(),
            *(("hard", number) for number in (1, 2, 3)),
        ]
        assert [which for which in chosen.all() if chosen.is_hard(*which)] == [
            *(("test", number) for number in (2, 3) if hard),
            *(("hard", number) for number in (1, 2, 3)),
        ]
        assert chosen.hard_force == (1.3, 1.6)
    other = replace(scene(), interactions=chosen)
    assert config.build(Scene, tomllib.loads(other.toml())) == other
    with pytest.raises(InputError, match="interactions.hard_set = -1 must be from 0"):
        Interactions(1, 2, 1, 4, hard_set=-1)


def test_settings_without_a_say_are_refused():
    """What a kind of mesh or element would ignore is an InputError, also where it is the default of
    another."""
    for wrong in (
        {"cells": (16, 16, 8)},
        {"fixed": "bottom"},
        {"loaded": "top"},
        {"grid": (9, 9, 5)},
        {"kind": "box", "grid": (9, 9, 5)},
        {"kind": "box", "scale": 1.0},
        {"kind": "file", "file": "a.vtu", "cells": (2, 2, 2)},
        {"kind": "given", "edge": 1.0},
    ):
        name = list(wrong)[-1]
        with pytest.raises(InputError, match=f"mesh.{name} = .* has no meaning for mesh.kind"):
            MeshChoice(**wrong)
    with pytest.raises(InputError, match="hourglass_stiffness = 0.1 has no meaning for .*'full'"):
        SolverChoice(hourglass_stiffness=0.1)
    assert SolverChoice("reduced").hourglass_stiffness == 0.2
    with pytest.raises(InputError, match="tolerance = 0.001 has no meaning for .*'explicit'"):
        SolverChoice(tolerance=1e-3)
    for wrong in ({"damping": 20.0}, {"mass_scaling": 4.0}, {"safety": 0.5}):
        (name,) = wrong
        with pytest.raises(
            InputError, match=f"solver.{name} = .* no meaning for solver.kind = 'quasistatic'"
        ):
            SolverChoice(kind="quasistatic", **wrong)


def test_a_quasistatic_scene_says_so_and_an_explicit_one_reads_as_before():
    """The text of a scene has what its solver knows, and reads back as the scene."""
    explicit = scene()
    quasistatic = replace(explicit, solver=SolverChoice(kind="quasistatic"), health=Health())
    text = tomllib.loads(quasistatic.toml())
    assert text["solver"] == {
        "kind": "quasistatic",
        "element": "full",
        "precision": "float32",
        "tolerance": 1e-3,
    }
    assert config.build(Scene, text) == quasistatic
    old = tomllib.loads(explicit.toml())
    assert set(old["solver"]) == {"element", "precision", "damping", "mass_scaling", "safety"}
    assert "pull" not in old["contact"]
    assert explicit.health.imbalance == 0.01 < quasistatic.health.imbalance
    mesh = box((4, 4, 2), 1e-3)
    assert isinstance(quasistatic.build_solver(mesh), QuasiStatic)
    assert isinstance(explicit.build_solver(mesh), Solver)


def test_a_box_is_held_and_loaded_as_chosen():
    choice = MeshChoice("box", edge=1e-3, cells=(4, 3, 2))
    assert choice.fixed == "all but top" and choice.build() == box((4, 3, 2), 1e-3)
    bottom = replace(choice, fixed="bottom", loaded="top").build()
    assert bottom == box((4, 3, 2), 1e-3, "bottom").with_sets(loaded="top")
    assert np.array_equal(replace(choice, fixed="x min").build().fixed, bottom.points[:, 0] == 0)
    with pytest.raises(InputError, match="no fixed node"):
        replace(choice, fixed="none").build()


def test_equal_choices_build_one_mesh():
    assert MeshChoice().build() is MeshChoice("tumour").build() and MeshChoice().build() == tumour()


def test_a_mesh_that_is_not_held_makes_no_scene():
    with pytest.raises(InputError, match="no fixed node"):
        scene().with_mesh(box((2, 2, 2), 1e-3, "none"))
