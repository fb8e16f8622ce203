"""The lines of docs/extending.md, exactly as they stand there."""

import dataclasses
import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import fem
import unet_fem
from fem.material import KINDS
from fem.settings import dump_toml
from unet_fem.networks.registry import NETWORKS
from unet_fem.runtime.replay import replay
from unet_fem.steppers import STEPPERS, stepper
from unet_fem.training.settings import from_tree

PAGE = (Path(__file__).parents[1] / "docs/extending.md").read_text()
BLOCKS = dict(re.findall(r"^## A (\w+)$.*?^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE))
TABLES = KINDS, NETWORKS, STEPPERS


@pytest.fixture
def module(tmp_path, monkeypatch):
    """module(what, name): the lines on "A <what>" imported as a module; its row goes at the end."""
    before = [dict(table) for table in TABLES]
    monkeypatch.syspath_prepend(tmp_path)

    def load(what, name):
        (tmp_path / f"{name}.py").write_text(BLOCKS[what])
        monkeypatch.delitem(sys.modules, name, raising=False)
        return importlib.import_module(name)

    yield load
    for table, rows in zip(TABLES, before, strict=True):
        table.clear()
        table.update(rows)


def test_the_page_has_a_block_for_each():
    assert BLOCKS.keys() == {"material", "network", "stepper"}
    assert PAGE.count("```python") == 3


def test_a_material_of_the_users_own_rests_at_its_closed_form(module):
    """Held below and under the stress of F = diag(1, 1, 1.1) on all other sides, a block rests at
    F."""
    law = module("material", "law").SaintVenantKirchhoff(lame=500.0, mu=400.0, density=1000.0)
    mesh = fem.box((3, 3, 2), 1e-3)
    height = mesh.points[:, 2] - mesh.points[:, 2].min()
    mesh = dataclasses.replace(mesh, fixed=height == 0)
    # P = F S along each axis, for E = diag(0, 0, 0.105)
    stress = 0.105 * np.array([500.0, 500.0, 1.1 * (500.0 + 2 * 400.0)])
    load = np.zeros(mesh.points.shape)
    for face in mesh.free_faces:
        a, b, c, d = mesh.points[face]
        load[face] += stress * np.cross(c - a, d - b) / 2 / 4
    rest = fem.equilibrium(mesh, law, load)
    exact = np.outer(0.1 * height, [0, 0, 1])
    np.testing.assert_allclose(rest.displacement, exact, atol=1e-6 * exact.max())


def test_a_scene_file_names_the_material(module, tiny, tmp_path):
    law = module("material", "law").SaintVenantKirchhoff
    tissue = {"lame": 500.0, "mu": 400.0, "density": 1000.0}
    tiny["material"] = {"kind": "saint_venant_kirchhoff", **tissue}
    (tmp_path / "scene.toml").write_text(dump_toml(tiny))
    assert fem.load_scene(tmp_path / "scene.toml").material == law(**tissue)


@pytest.mark.slow
def test_a_network_of_the_users_own_trains_for_a_step(
    module, tiny, tiny_dataset, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    module("network", "network")
    Path("scene.toml").write_text(dump_toml(tiny))
    settings = from_tree(
        {
            "name": "dense",
            "scene": "scene.toml",
            "data": str(tiny_dataset),
            "train": {"epochs": 1, "batch_size": 100},
            "model": {"kind": "dense", "units": 8},
        }
    )
    unet_fem.train(settings)
    body = unet_fem.open_stepper(settings.folder / "best.keras")
    assert isinstance(body, fem.Stepper)
    assert body.step(np.zeros((5, 5, 3, 3))).shape == (5, 5, 3, 3)


def test_a_stepper_of_the_users_own_is_played(module):
    springs = module("stepper", "springs").Springs
    grid = fem.NodeGrid((2, 2, 2), np.array([0, 3, 5]))
    body = stepper("springs", grid, stiffness=2.0, damping=0.5)
    assert isinstance(body, springs) and isinstance(body, fem.Stepper)

    force = np.arange(9.0).reshape(3, 3)
    creep = force / 2 * (1 - np.exp(-2.0 * 0.1 / 0.5))
    np.testing.assert_allclose(body.step(force, 0.1), creep, rtol=1e-12)
    kept = body.state()
    after = body.step(grid.to_grid(force), 0.2)
    body.restore(kept)
    np.testing.assert_array_equal(body.step(force, 0.2), grid.from_grid(after))
    with pytest.raises(fem.InputError, match="of these springs"):
        body.restore({})

    times = np.array([0.0, 0.05, 0.1])
    played = replay(body, np.repeat(force[None], 3, axis=0), times, rate=100)
    calls = np.array([1, 6, 11])[:, None, None]
    rests = force / 2 * (1 - np.exp(-2.0 * 0.01 * calls / 0.5))
    np.testing.assert_allclose(played["displacement"], rests, rtol=1e-9)
