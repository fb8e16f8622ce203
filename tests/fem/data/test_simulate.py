"""A simulation without a scene."""

import numpy as np
import pytest

from fem.contact.push import Push
from fem.data.simulate import simulate
from fem.errors import InputError, SolverStopped
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver.explicit import Solver

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
MESH = box((3, 3, 2), 1e-3)
FORCE = np.zeros((3, MESH.n_nodes))
FORCE[2, (MESH.points[:, 2] > 1.9e-3) & ~MESH.fixed] = -1e-4


def test_mesh_material_load_and_times_are_enough():
    frames = simulate(MESH, TISSUE, lambda t: 10 * t * FORCE, [0.0, 0.01, 0.03], damping=50.0)
    solver = Solver(MESH, TISSUE, damping=50.0)
    for time, force, u, volume in zip([0.0, 0.01, 0.03], *frames, strict=True):
        solver.advance(time - solver.time, lambda t: 10 * t * FORCE)
        np.testing.assert_array_equal(force, (10 * time * FORCE.T * 1e3).astype(np.float32))
        np.testing.assert_array_equal(u, (solver.u.T * 1e3).astype(np.float32))
        assert volume == MESH.volume(solver.u.T) * 1e9
    assert frames.displacement[-1].any() and frames.volume[-1] < frames.volume[0]


def test_a_push_is_enough_of_a_load():
    push = Push(at="top", force=1e-4, radius=1.5e-3, ramp=0.02)
    frames = simulate(MESH, TISSUE, push, [0.0, 0.02], damping=50.0)
    assert not frames.force[0].any() and frames.displacement[1, :, 2].min() < 0
    np.testing.assert_allclose(frames.force[1].sum(axis=0), [0, 0, -0.1], atol=1e-6)


@pytest.mark.parametrize("times", [[], [0.1, 0.1], [-0.1, 0.1], [0.0, np.nan], [[0.0, 1.0]]])
def test_times_that_do_not_ascend_are_refused(times):
    with pytest.raises(InputError, match="must ascend"):
        simulate(MESH, TISSUE, lambda t: FORCE, times)


def test_a_run_that_cannot_go_on_stops():
    with pytest.raises(SolverStopped):
        simulate(MESH, TISSUE, lambda t: 1e3 * FORCE, [0.0, 0.1])
