"""The stiffness at rest is the slope of the internal force, and the compliance its inverse."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver import compliance as module
from fem.solver.compliance import compliance, stiffness_at_rest
from fem.solver.internal_force import ELEMENTS, InternalForce
from fem.solver.rest import equilibrium

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0, prony=((0.12, 330.0), (0.8, 11.0)))


@pytest.fixture(scope="module")
def mesh(distort):
    return distort(box((4, 3, 3), 1e-3))


@pytest.mark.parametrize("element", ELEMENTS)
def test_it_is_the_slope_of_the_internal_force(mesh, element):
    K = stiffness_at_rest(mesh, TISSUE, element)
    assert abs(K - K.T).max() == 0
    force = InternalForce(mesh, TISSUE.elastic(), element)
    u = 1e-8 * np.random.default_rng(0).normal(size=(3, mesh.n_nodes))
    slope = (force(u) - force(-u)) / 2
    np.testing.assert_allclose(K @ u.ravel(), slope.ravel(), atol=1e-6 * np.abs(slope).max())


def test_rigid_motion_costs_nothing(mesh):
    K = stiffness_at_rest(mesh, TISSUE)
    x, y, _ = mesh.points.T
    for motion in (np.ones((3, mesh.n_nodes)), np.array([-y, x, 0 * x])):
        assert np.abs(K @ motion.ravel()).max() < 1e-7 * np.abs(K).max() * np.abs(motion).max()


def test_unit_forces_give_what_a_small_force_does(mesh):
    free = np.unique(mesh.contact_faces)
    nodes = np.concatenate([free[~mesh.fixed[free]][:40], np.flatnonzero(mesh.fixed)[:2]])
    C = compliance(mesh, TISSUE, nodes)
    assert C.shape == (len(nodes), 3, mesh.n_nodes, 3)
    assert not C[:, :, mesh.fixed].any() and not C[-2:].any()
    f = 1e-9 * np.random.default_rng(1).normal(size=(len(nodes), 3))  # N
    load = np.zeros((mesh.n_nodes, 3))
    load[nodes] = f
    rest = equilibrium(mesh, TISSUE.elastic(), load, residual=1e-7).displacement
    found = np.einsum("ni,nimj->mj", f, C)
    assert np.linalg.norm(found - rest) < 1e-5 * np.linalg.norm(rest)


def test_what_does_not_fit_into_memory_is_refused(mesh, monkeypatch):
    monkeypatch.setattr(module, "LARGEST", 10_000)
    with pytest.raises(InputError, match="take a coarser mesh"):
        compliance(mesh, TISSUE, np.arange(8))
