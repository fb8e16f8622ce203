"""The state of rest by dynamic relaxation."""

import numpy as np
import pytest

from fem.errors import InputError, SolverStopped
from fem.material.neo_hooke import NeoHooke
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box
from fem.solver.rest import equilibrium

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)


@pytest.fixture(scope="module")
def block(request):
    with np.load(
        request.config.rootpath / "tests/data/ref1_block_two_nodal_forces_hex8.npz"
    ) as data:
        return {name: data[name] for name in data.files}


@pytest.fixture(scope="module")
def block_mesh(block):
    return HexMesh(block["points"], block["cells"], block["fixed"])


@pytest.mark.parametrize("level", range(4))
def test_rest_under_two_forces_is_that_of_a_newton_solver(block, block_mesh, level):
    """felupe's static solution, to 1e-5 at the default residual of 1e-6."""
    found = equilibrium(block_mesh, TISSUE, block["levels"][level] * block["loads"])
    expected = block["u"][level]
    assert found.residual <= 1e-6
    assert np.linalg.norm(found.displacement - expected) < 1e-5 * np.linalg.norm(expected)


def test_the_residual_asked_for_decides_the_error(block, block_mesh):
    errors = [
        np.linalg.norm(
            equilibrium(block_mesh, TISSUE, block["loads"], residual).displacement - block["u"][3]
        )
        for residual in (1e-3, 1e-9)
    ]
    assert errors[1] < 1e-4 * errors[0] and errors[1] < 1e-7 * np.linalg.norm(block["u"][3])


def test_with_prony_terms_rest_is_the_relaxed_state(block, block_mesh):
    """Relaxed stress is g0 times the elastic one, so a quarter of the force at g0 = 1/4 gives the
    elastic answer."""
    relaxed = NeoHooke(400.0, 0.42, 1000.0, prony=((0.5, 11.0), (0.25, 330.0)))
    found = equilibrium(block_mesh, relaxed, 0.25 * block["loads"])
    assert np.linalg.norm(found.displacement - block["u"][3]) < 1e-5 * np.linalg.norm(block["u"][3])


def test_what_cannot_rest_is_stopped_and_wrong_loads_are_named():
    mesh, free = box((2, 2, 2), 1e-3, "bottom"), box((2, 2, 2), 1e-3, "none")
    load = np.zeros(mesh.points.shape)
    assert not equilibrium(mesh, TISSUE, load).displacement.any()
    with pytest.raises(InputError, match=r"\(27, 3\)"):
        equilibrium(mesh, TISSUE, load.T)
    load[-1, 2] = 1e-6
    with pytest.raises(SolverStopped) as stop:
        equilibrium(free, TISSUE, load, max_steps=2000)
    assert stop.value.reason in ("not at rest", "diverged")
    load[-1, 2] = -1.0
    with pytest.raises(SolverStopped) as stop:
        equilibrium(mesh, TISSUE, load)
    assert stop.value.reason in ("crushed cell", "inverted cell", "diverged", "no stable step")
