"""The gate tells a wrong answer where energy, kinetic share and J at the points of integration do
not, and leaves a right one alone."""

import dataclasses
import warnings

import numpy as np
import pytest

from fem.contact.push import smooth_step
from fem.contact.surface import Surface
from fem.errors import SolverStopped, Stop
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver.energy import EnergyLedger, kinetic_share
from fem.solver.explicit import Solver
from fem.solver.gate import LIMITS, Gate, Signs, doubts
from fem.solver.rest import equilibrium

ELASTIC = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
VISCOELASTIC = dataclasses.replace(ELASTIC, prony=((0.12, 330.0), (0.8, 11.0)))
EDGE = 1e-3  # m
BLOCK = box((6, 6, 4), EDGE)
FINE = box((12, 12, 8), EDGE / 2)


def push(mesh, peak, radius):
    """(3, N) downward force in the middle of the top."""
    load = np.zeros((3, mesh.n_nodes))
    load[2] = -peak * Surface(mesh).footprint(np.array([3, 3, 4]) * EDGE, radius)
    return load


def slow_push(peak=1e-3, **choices):
    """A push of 2 s that comes and goes: (displacement at 20 frames, solver, ledger)."""
    solver, ledger, load = (
        Solver(BLOCK, VISCOELASTIC, **choices),
        EnergyLedger(),
        push(BLOCK, peak, 2.2e-3),
    )
    frames = []
    for frame in range(1, 21):
        solver.advance(
            0.1 * frame - solver.time,
            lambda t: smooth_step(t / 0.6) * (1 - smooth_step((t - 1) / 0.6)) * load,
            [ledger],
        )
        frames.append(solver.u.copy())
    return np.array(frames), solver, ledger


def error(got, exact):
    return np.linalg.norm(got - exact) / np.linalg.norm(exact)


def said_of(run):
    """What a run warns of, and what it returns."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = run()
    return [str(warning.message) for warning in said], result


def test_mass_that_is_scaled_too_far_is_told_by_disequilibrium_alone():
    """Scaled by 16 the answer is 0.3 % wrong and passes without a word; by 1024 it is over 5 %
    wrong with energy and kinetic share as they should be, and is warned of once and rejected."""
    exact, true, _ = slow_push(damping=20.0)
    said, (right, light, _) = said_of(lambda: slow_push(damping=20.0, mass_scaling=16.0))
    assert error(right, exact) < 0.01 and not said and not doubts(light.gate.signs)
    said, (wrong, heavy, ledger) = said_of(lambda: slow_push(damping=20.0, mass_scaling=1024.0))
    assert error(wrong, exact) > 0.05
    assert ledger.worst_imbalance() < 0.01 and kinetic_share(ledger.rows) < 0.05
    assert doubts(heavy.gate.signs) == [Stop.DISEQUILIBRIUM]
    (only,) = said
    assert "of the scaled mass" in only and "lower solver.mass_scaling" in only
    assert true.gate.signs.disequilibrium < light.gate.signs.disequilibrium < LIMITS.disequilibrium


def test_a_blow_at_the_true_mass_is_no_error():
    """A sudden force is out of equilibrium by its nature: no warning, but no data either."""

    def blow():
        solver, load = Solver(BLOCK, ELASTIC), push(BLOCK, 1e-3, 2.2e-3)
        solver.advance(0.02, lambda t: load)
        return solver

    said, solver = said_of(blow)
    assert not said and doubts(solver.gate.signs) == [Stop.DISEQUILIBRIUM]


def test_a_faint_first_touch_is_no_disequilibrium():
    """Looked at while a force has hardly begun, inertia is as large as the force: only what follows
    may tell."""
    solver, load = (
        Solver(BLOCK, ELASTIC, damping=20.0, mass_scaling=16.0),
        push(BLOCK, 1e-3, 2.2e-3),
    )
    rise = lambda t: smooth_step((t - 0.1) / 1.0) * load  # noqa: E731
    said, _ = said_of(lambda: solver.advance(0.102, rise))
    assert not said and solver.gate.signs.disequilibrium > LIMITS.disequilibrium
    said, _ = said_of(lambda: solver.advance(1.4, rise))
    assert not said and solver.gate.signs.disequilibrium < LIMITS.disequilibrium


@pytest.mark.parametrize(
    "stiffness, radius, sign",
    [
        (0.2, 2.2e-3, None),
        (0.0, 1.3e-3, Stop.HOURGLASS_MOTION),
        (0.02, 1.3e-3, Stop.HOURGLASS_MOTION),
        (1.6, 2.2e-3, Stop.HOURGLASS_ENERGY),
    ],
)
def test_hourglass_stiffness_that_is_too_weak_or_too_strong_is_told(stiffness, radius, sign):
    """The usual one passes; none, a weak and a strong one are over 10 % wrong, are warned of once
    and rejected. For the weak ones hourglass energy is below 2 % of strain energy."""
    load = push(FINE, 0.5e-3, radius)
    solver = Solver(FINE, ELASTIC, "reduced", hourglass_stiffness=stiffness, damping=100.0)
    ledger = EnergyLedger()
    said, _ = said_of(lambda: solver.advance(0.3, lambda t: smooth_step(t / 0.15) * load, [ledger]))
    assert (doubts(solver.gate.signs) or [None])[0] == sign and len(said) == (sign is not None)
    exact = equilibrium(FINE, ELASTIC, load.T, 1e-4, "mean_dilatation").displacement.T
    assert (error(solver.u, exact) > 0.08) == (sign is not None)
    if sign is Stop.HOURGLASS_MOTION:
        assert "refine the mesh" in said[0] and ledger.worst_imbalance() < 0.01
        assert solver.gate.signs.hourglass_share < 0.02


def test_a_crushed_corner_is_told_where_the_points_of_integration_are_well():
    """A push whose smallest J is as the data allow has a corner below a tenth of its volume; a
    weaker one has not."""
    signs = []
    for peak in (4e-3, 7.2e-3):
        _, (_, solver, ledger) = said_of(
            lambda peak=peak: slow_push(peak, damping=20.0, mass_scaling=16.0)
        )
        signs.append(solver.gate.signs)
        assert ledger.smallest_J > 0.15
    assert not doubts(signs[0]) and doubts(signs[1]) == [Stop.CRUSHED_CORNER]


def test_a_corner_that_inverts_stops_the_run_where_the_step_is_not_estimated_again():
    """Hourglass motion folds the cells over at their full volume, which no estimate of the step
    sees: the gate does, at the next look."""
    corners = []
    for watched in (False, True):
        solver = Solver(box((4, 4, 4), EDGE, "bottom"), ELASTIC, "reduced", hourglass_stiffness=0.0)
        ijk = np.rint(solver.mesh.points / EDGE).astype(int)
        solver.v[0] = np.where(ijk[:, 2] > 2, 1e-2 * (-1.0) ** ijk.sum(axis=1), 0.0)
        solver.gate = Gate() if watched else None
        still = np.zeros_like(solver.u)
        try:
            solver.advance(0.5, lambda t, still=still: still)
        except SolverStopped as stop:
            assert watched and stop.reason is Stop.INVERTED_CELL and solver.force.min_J > 0.5
        corners.append(solver.leapfrog.corner_J(solver.u).min())
    assert corners[0] < corners[1] < 0


def test_the_gate_only_watches_and_leaves_fixed_steps_alone():
    """A run is bit for bit the same without it; a number of steps that is given, as in a real-time
    loop, is not looked at."""
    load = push(BLOCK, 1e-3, 2.2e-3)
    watched, alone = (Solver(BLOCK, VISCOELASTIC, damping=20.0) for _ in range(2))
    alone.gate = None
    for solver in (watched, alone):
        solver.advance(0.2, lambda t: smooth_step(t / 0.1) * load)
    assert np.array_equal(watched.u, alone.u) and watched.gate.signs.corner_J < 1
    loop = Solver(BLOCK, VISCOELASTIC, mass_scaling=1e4)
    loop.advance(0.2, lambda t: load, steps=20)
    assert loop.gate.signs == Signs()


def test_signs_of_nothing_and_of_no_number():
    """No load is no doubt, and a NaN is one."""
    assert not doubts(Signs())
    for name in Signs._fields:
        assert len(doubts(Signs()._replace(**{name: np.nan}))) == 1
