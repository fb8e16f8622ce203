"""The compliance is what small forces do to a body at rest."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver import compliance as module
from fem.solver.compliance import compliance
from fem.solver.internal_force import ELEMENTS, InternalForce

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0, prony=((0.12, 330.0), (0.8, 11.0)))


@pytest.fixture(scope="module")
def mesh(distort):
    return distort(box((4, 3, 3), 1e-3))


@pytest.mark.parametrize("element", ELEMENTS)
def test_unit_forces_are_balanced_by_the_internal_force(mesh, element):
    """At the displacement under a tiny force the internal force is that force again."""
    free = np.unique(mesh.contact_faces)
    nodes = np.concatenate([free[~mesh.fixed[free]][:40], np.flatnonzero(mesh.fixed)[:2]])
    C = compliance(mesh, TISSUE, nodes, element)
    assert C.shape == (len(nodes), 3, mesh.n_nodes, 3)
    assert not C[:, :, mesh.fixed].any() and not C[-2:].any()
    f = 1e-9 * np.random.default_rng(1).normal(size=(len(nodes), 3))  # N
    load = np.zeros((mesh.n_nodes, 3))
    load[nodes[:-2]] = f[:-2]
    u = np.einsum("ni,nimj->jm", f, C)
    force = InternalForce(mesh, TISSUE.elastic(), element)
    internal = ((force(u) - force(-u)) / 2).T
    error = np.linalg.norm((internal - load)[~mesh.fixed])
    assert error < 1e-6 * np.linalg.norm(load)


def test_it_is_symmetric(mesh):
    nodes = np.flatnonzero(~mesh.fixed)
    C = compliance(mesh, TISSUE, nodes)[:, :, nodes].reshape(3 * len(nodes), -1)
    np.testing.assert_allclose(C, C.T, atol=1e-7 * np.abs(C).max())


def test_what_does_not_fit_into_memory_is_refused(mesh, monkeypatch):
    monkeypatch.setattr(module, "LARGEST", 10_000)
    with pytest.raises(InputError, match="take a coarser mesh"):
        compliance(mesh, TISSUE, np.arange(8))
