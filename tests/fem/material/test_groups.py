"""Cell groups with parameters of their own: what a scene file says, and what the mesh takes."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from fem import settings
from fem.data.scene import Scene, load_scene
from fem.errors import InputError
from fem.material import MooneyRivlin, NeoHooke, Ogden
from fem.material.groups import by_cells, check_groups
from fem.mesh.shapes import box, refined

TISSUE = NeoHooke(400.0, 0.42, 1000.0, ((0.12, 330.0),))
STIFF = np.arange(24) % 3 == 0
MESH = box((4, 3, 2), 1e-3).with_sets(stiff=STIFF, light=np.arange(24) == 1)


def built(tiny, **groups):
    tiny["material"] |= groups
    return settings.build(Scene, tiny)


def test_a_file_is_read_written_and_numbered_with_its_groups(tiny, tmp_path):
    text = settings.dump_toml(tiny) + "\n[material.stiff]\nmu = 1200\n[material.light]\nnu = 0.3\n"
    (tmp_path / "scene.toml").write_text(text)
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.material == settings.build(Scene, tiny).material
    assert scene.groups == {"stiff": {"mu": 1200.0}, "light": {"nu": 0.3}}
    again = settings.build(Scene, tomllib.loads(scene.toml()))
    assert again == scene and again.digest() == scene.digest() and hash(again) == hash(scene)
    other = replace(scene, groups={"light": {"nu": np.float64(0.3)}, "stiff": {"mu": 1200}})
    assert other == scene and other.toml() == scene.toml()


def test_every_change_makes_another_digest_and_no_group_the_former_text(tiny):
    plain = built(tiny)
    assert plain.groups == {} and tomllib.loads(plain.toml())["material"].keys() == {
        *("mu", "nu", "density", "prony")
    }
    tables = {"stiff": {"mu": 1200.0}}, {"stiff": {"mu": 1201.0}}, {"stuff": {"mu": 1200.0}}
    digests = [replace(plain, groups=groups).digest() for groups in ({}, *tables)]
    assert digests[0] == plain.digest() and len(set(digests)) == 4


def test_the_cells_of_a_group_have_its_parameters_and_all_else_is_one_value(tiny):
    scene = built(tiny, stiff={"mu": 1200.0}, light={"mu": 100.0})
    law = scene.material_on(MESH)
    assert type(law) is NeoHooke and (law.nu, law.density, law.prony) == (
        *(0.42, 1000.0, scene.material.prony),
    )
    expected = np.full(24, 400.0)
    expected[STIFF], expected[1] = 1200.0, 100.0
    np.testing.assert_array_equal(law.mu, expected)
    fine = scene.material_on(refined(MESH))
    np.testing.assert_array_equal(fine.mu, np.repeat(expected, 8))


def test_a_law_without_differences_has_no_value_a_cell():
    everywhere = MESH.with_sets(stiff=np.ones(24, bool), light=np.zeros(24, bool))
    assert by_cells(TISSUE, MESH, {}) is TISSUE
    assert by_cells(TISSUE, MESH, {"stiff": {"mu": 400.0, "density": 1000.0}}) == TISSUE
    assert by_cells(TISSUE, everywhere, {"light": {"mu": 1.0}}) == TISSUE
    assert by_cells(TISSUE, everywhere, {"stiff": {"mu": 1.0}}) == replace(TISSUE, mu=1.0)


@pytest.mark.parametrize(
    "law, changes, name, expected",
    [
        (MooneyRivlin(150.0, 50.0, 0.42, 1000.0), {"c01": 80.0, "density": 900.0}, "c01", (80, 50)),
        (
            Ogden(((40.0, 8.0), (-60.0, -4.0)), 0.42, 1000.0),
            {"terms": [[80, 8], [-60, -4]]},
            "terms",
            (80, 40),
        ),
    ],
)
def test_every_law_takes_groups(law, changes, name, expected):
    found = by_cells(law, MESH, check_groups(law, {"stiff": changes}))
    values = getattr(found, name) if name != "terms" else found.terms[0][0]
    np.testing.assert_array_equal(values, np.where(STIFF, *expected))
    if name == "terms":
        assert found.terms[1] == (-60.0, -4.0)


@pytest.mark.parametrize(
    "groups, message",
    [
        ({"stiff": {"muu": 1.0}}, "unknown key 'material.stiff.muu'; the nearest .*stiff.mu'"),
        ({"stiff": {"mu": "hard"}}, "material.stiff.mu = 'hard' must be a number"),
        ({"stiff": {"mu": -1.0}}, "material.stiff.mu = -1.0 must be from 0.001 to .* Pa"),
        ({"stiff": {"prony": []}}, "material.stiff.prony has no meaning, for all cells share it"),
        ({"stiff": {"kind": "ogden"}}, "material.stiff.kind has no meaning"),
        ({"stiff": 3.0}, "unknown key 'material.stiff'"),
        ({"c10": {"mu": 3.0}}, "unknown key 'material.c10'"),
        ({"nu": {"mu": 3.0}}, "material.nu = .* must be a number"),
    ],
)
def test_what_a_group_cannot_have_is_refused(groups, message, tiny):
    with pytest.raises(InputError, match=message):
        built(tiny, **groups)


def test_groups_stand_in_the_material(tiny):
    with pytest.raises(InputError, match=r"unknown key 'groups'; .* as \[material.<cell set>\]"):
        settings.build(Scene, tiny | {"groups": {"stiff": {"mu": 1.0}}})
    scene = built(tiny)
    with pytest.raises(InputError, match="cell group 'nu' has the name of a parameter"):
        replace(scene, groups={"nu": {"mu": 1.0}})
    with pytest.raises(InputError, match="'material.stiff' must be a table, not 3"):
        replace(scene, groups={"stiff": 3})


def test_ogden_groups_share_number_and_exponents_of_the_terms():
    law = Ogden(((40.0, 8.0), (-60.0, -4.0)), 0.42, 1000.0)
    with pytest.raises(InputError, match="material.stiff.terms has 1 entries; give 2"):
        check_groups(law, {"stiff": {"terms": [[40.0, 8.0]]}})
    with pytest.raises(InputError, match="material.terms = .* must be a list of pairs of numbers"):
        by_cells(law, MESH, check_groups(law, {"stiff": {"terms": [[40.0, 6.0], [-60.0, -4.0]]}}))


def test_an_unknown_set_is_named_with_those_that_there_are(tiny):
    scene = built(tiny, tumor={"mu": 1200.0})
    with pytest.raises(InputError, match="no such set; it has stiff, light"):
        scene.build_solver(MESH)
    with pytest.raises(InputError, match=r"\[material.tumor\] is for the cell set .* it has none"):
        scene.material_on(box((2, 2, 2), 1e-3))


def test_groups_that_share_cells_are_refused():
    both = MESH.with_sets(light=np.arange(24) == 3)
    with pytest.raises(InputError, match="cell 3 is in 'light' and in another group"):
        by_cells(TISSUE, both, {"stiff": {"mu": 1.0}, "light": {"mu": 2.0}})
