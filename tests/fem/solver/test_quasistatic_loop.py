"""The quasi-static solver as a stepper."""

from dataclasses import replace

import numpy as np
import pytest

from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.online.grid import MM, MN
from fem.online.stepper import Stepper
from fem.solver.quasistatic import QuasiStatic
from fem.solver.quasistatic_loop import QuasiStaticLoop

TISSUE = NeoHooke(400.0, 0.42, 1000.0, ((0.12, 330.0), (0.8, 11.0)))
MESH = box((4, 4, 2), 1e-3)


def forces(n=5):
    """(n, N, 3) float32 mN that push the top down and sideways."""
    field = np.zeros((MESH.n_nodes, 3))
    field[(MESH.points[:, 2] > 1.9e-3) & ~MESH.fixed] = [0.004, 0.002, -0.02]
    return (np.sin(np.arange(1, n + 1) / 2)[:, None, None] * field).astype(np.float32)


def answers(loop, field=None, intervals=(0.25, 0.01, 2.0, 0.25, 0.1)):
    field = forces() if field is None else field
    return np.array([loop.step(force, dt) for force, dt in zip(field, intervals, strict=True)])


def test_it_is_a_stepper_of_any_interval_in_both_layouts():
    loop, grid = QuasiStaticLoop(MESH, TISSUE), MESH.grid
    assert isinstance(loop, Stepper) and loop.interval is None
    nodal = answers(loop)
    assert nodal.dtype == np.float32 and nodal.any()
    on_grid = answers(QuasiStaticLoop(MESH, TISSUE), grid.to_grid(forces()))
    np.testing.assert_array_equal(grid.from_grid(on_grid), nodal)
    loose = QuasiStaticLoop(replace(MESH, grid=None), TISSUE)
    np.testing.assert_array_equal(answers(loose), nodal)


def test_a_call_is_one_advance_under_a_force_that_ramps():
    """In mN and mm, what the solver gives in N and m."""
    solver, loop = QuasiStatic(MESH, TISSUE, precision="float32"), QuasiStaticLoop(MESH, TISSUE)
    load = forces(1)[0].T / MN
    solver.advance(0.25, lambda t: t / 0.25 * load)
    assert (
        np.abs(loop.step(forces(1)[0], 0.25) - solver.u.T * MM).max()
        < 1e-6 * np.abs(solver.u * MM).max()
    )


def test_states_go_on_to_the_bit_and_reset_is_rest():
    loop = QuasiStaticLoop(MESH, TISSUE)
    first = answers(loop)
    kept = loop.state()
    second = answers(loop)
    loop.restore(kept)
    np.testing.assert_array_equal(answers(loop), second)
    loop.reset()
    np.testing.assert_array_equal(answers(loop), first)
    with pytest.raises(InputError, match="the state is"):
        loop.restore({"u": kept["u"]})
    with pytest.raises(InputError, match="the state is"):
        QuasiStaticLoop(MESH, TISSUE.elastic()).restore(kept)


@pytest.mark.parametrize(
    "force, dt, message",
    [
        (np.zeros((3, 3)), 0.25, r"of shape \(3, 3\)"),
        (np.full((MESH.n_nodes, 3), np.nan), 0.25, "give finite"),
        (np.zeros((MESH.n_nodes, 3)), None, "give dt"),
        (np.zeros((MESH.n_nodes, 3)), -1.0, "dt = -1.0 s must be positive"),
    ],
)
def test_bad_calls_change_nothing(force, dt, message):
    loop = QuasiStaticLoop(MESH, TISSUE)
    with pytest.raises(InputError, match=message):
        loop.step(force, dt)
    np.testing.assert_array_equal(answers(loop), answers(QuasiStaticLoop(MESH, TISSUE)))
