"""Datasets and single simulations by the quasi-static solver."""

import numpy as np
import pytest

import fem
from fem import settings as config
from fem.data.build import generate
from fem.data.confirm import Confirmation, check_confirmed
from fem.data.scene import Scene
from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box

TISSUE = NeoHooke(400.0, 0.42, 1000.0, ((0.12, 330.0), (0.8, 11.0)))


@pytest.fixture
def quasistatic(tiny):
    """The tiny scene, with ramps that the explicit solver follows almost at rest."""
    tree = config.merge(tiny, {"contact": {"ramp": [0.3, 0.4]}, "health": {"min_J": 0.6}})
    tree["solver"] = {"kind": "quasistatic"}
    return config.build(Scene, tree)


def test_a_dataset_is_made_and_confirmed_by_the_explicit_solver(quasistatic, tmp_path):
    """It holds what every dataset does: contacts, energies, health, and the distance of a sample
    from the explicit solver at the true mass."""
    generate(quasistatic, tmp_path / "data.h5", workers=1)
    dataset = fem.open_dataset(tmp_path / "data.h5")
    assert dataset.scene == quasistatic
    (row,) = dataset.confirmation
    assert 1e-4 < row["error"] < 0.01
    found = dataset.read("train")
    assert np.abs(found["displacement"][:, -1]).max() > 0.01 and not found["force"][:, 0].any()
    again = fem.data.interaction.simulate(
        quasistatic,
        dataset.fem_mesh,
        dataset.contacts("train", 1),
        fem.contact.surface.surface_of(dataset.fem_mesh),
    )
    np.testing.assert_array_equal(again["displacement"], dataset.sequence("train", 1).displacement)
    assert again["kinetic_share"] == 0 and again["disequilibrium"] <= 1e-3
    assert again["energy"].shape == (3, 7) and again["imbalance"] < 0.05


def test_data_too_far_from_the_explicit_solver_are_not_written(quasistatic):
    with pytest.raises(InputError, match="3.00% away .*; take solver.kind = 'explicit', or let"):
        check_confirmed(quasistatic, [Confirmation("train", 1, 0.03)])
    with pytest.raises(InputError, match="without inertia alone and stops at the true mass; let"):
        check_confirmed(quasistatic, [Confirmation("train", 1, np.inf)])


def test_one_call_simulates_by_either_solver():
    mesh, push = box((4, 4, 2), 1e-3), fem.Push("middle", 3e-4, 2e-3, ramp=1.0)
    times = [0.0, 0.5, 1.0]
    explicit = fem.simulate(mesh, TISSUE, push, times, damping=50.0)
    found = fem.simulate(mesh, TISSUE, push, times, kind="quasistatic", tolerance=1e-4)
    apart = np.linalg.norm(found.displacement - explicit.displacement)
    assert apart < 5e-3 * np.linalg.norm(explicit.displacement)
    with pytest.raises(InputError, match="kind 'static' is not one of explicit, quasistatic"):
        fem.simulate(mesh, TISSUE, push, times, kind="static")
