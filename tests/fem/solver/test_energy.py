"""The energy ledger: it balances for every kind of run, counts work exactly, and stops a run that
invents energy."""

import dataclasses

import numpy as np
import pytest

from fem.contact.surface import Surface
from fem.errors import SolverStopped, Stop
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver.energy import (
    COLUMNS,
    Balance,
    EnergyLedger,
    FrameBalances,
    kinetic_share,
    worst_imbalance,
)
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS
from fem.solver.record import Energies, Step

ELASTIC = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
VISCOELASTIC = dataclasses.replace(ELASTIC, prony=((0.3, 2.0), (0.5, 0.3)))
EDGE = 1e-3  # m
MESH = box((5, 5, 3), EDGE)


def push(mesh=MESH, peak=2e-3):
    """A smooth push (3, N) with a shear component, and its history over 0.2 s: up, and half
    back."""
    share = Surface(mesh).footprint(np.array([2.3, 2.6, 3.0]) * EDGE, 2e-3)
    field = peak * np.array([[0.3], [0.1], [-1.0]]) * share
    return lambda t: field * (np.sin(np.pi * t / 0.25) ** 2 if t < 0.201 else 0.0)


def run(material=ELASTIC, mesh=MESH, duration=0.2, **choices):
    solver, ledger = Solver(mesh, material, **choices), EnergyLedger()
    solver.advance(duration, push(mesh), [ledger])
    return solver, ledger


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("material", [ELASTIC, VISCOELASTIC], ids=["elastic", "viscoelastic"])
@pytest.mark.parametrize("damping", [0.0, 30.0])
@pytest.mark.parametrize("kind", ELEMENTS)
def test_energy_balances(kind, damping, material, precision):
    """Work is stored, relaxed or damped to 0.1 % in every combination, and each account is used
    when it applies."""
    solver, ledger = run(material, element=kind, damping=damping, precision=precision)
    rows = dict(zip(COLUMNS, np.transpose(ledger.rows), strict=True))
    assert len(ledger.rows) >= 3 and ledger.external > 0
    assert ledger.worst_imbalance() < 1e-3
    assert (rows["damping"][-1] > 0) == (damping > 0)
    assert (rows["viscous"][-1] != 0) == bool(material.prony)
    assert (rows["hourglass"][-1] > 0) == (kind == "reduced")


def test_balance_on_distorted_cells(distort):
    """The balance does not need congruent cells."""
    _, ledger = run(VISCOELASTIC, distort(MESH), damping=30.0)
    assert ledger.worst_imbalance() < 1e-3


@pytest.mark.parametrize("material", [ELASTIC, VISCOELASTIC], ids=["elastic", "viscoelastic"])
def test_work_of_a_dead_load_is_exact(material):
    """A sudden constant force has done the work f . u at every step, to rounding."""
    solver, ledger, errors = Solver(MESH, material, damping=30.0), EnergyLedger(), []
    load = push(peak=1e-3)(0.125)

    def compare(step):
        errors.append(ledger.external - np.vdot(load, step.u))

    solver.advance(0.1, lambda t: load, [ledger, compare])
    assert errors[0] == 0 and ledger.external > 0
    assert np.abs(errors).max() < 1e-13 * ledger.external


def test_sudden_load_starts_in_balance():
    """At rest a sudden force has done no work and moved nothing: the first row is zero."""
    solver, ledger = Solver(MESH, ELASTIC), EnergyLedger()
    load = push()(0.125)
    solver.advance(0.1, lambda t: load, [ledger])
    assert not np.any(ledger.rows[0]) and len(ledger.rows) > 1


def test_imbalance_falls_with_the_square_of_the_step():
    """Under a sudden force, the hardest case, half the step leaves a quarter of the imbalance."""
    load, safeties, errors = push()(0.125), [0.6, 0.3, 0.15], []
    for safety in safeties:
        solver, ledger, record = Solver(MESH, ELASTIC, safety=safety), EnergyLedger(), []

        def balance(step, ledger=ledger, record=record):
            kinetic, strain, hourglass, _ = step.energies()
            record.append(ledger.external - kinetic - strain - hourglass)

        solver.advance(0.03, lambda t: load, [ledger, balance])
        errors.append(np.abs(record).max())
    assert np.polyfit(np.log(safeties), np.log(errors), 1)[0] == pytest.approx(2, abs=0.3)


def test_viscous_account_spares_in_loading_and_loses_in_unloading():
    """Up to the peak the viscous stresses spare work; after unloading more was done than the
    elastic energy that is left."""
    _, ledger = run(VISCOELASTIC, damping=30.0)
    rows = dict(zip(COLUMNS, np.transpose(ledger.rows), strict=True))
    loading = (rows["time"] > 0) & (rows["time"] < 0.125)
    assert loading.any() and np.all(rows["viscous"][loading] < 0)
    assert (
        rows["viscous"][-1] > 0 and rows["external"][-1] - rows["damping"][-1] > rows["strain"][-1]
    )


def test_invented_energy_stops_the_run():
    """A body that is sped up by 2 % a step is found out, with the reason ENERGY_IMBALANCE."""
    solver, ledger = Solver(MESH, ELASTIC), EnergyLedger()
    with pytest.raises(SolverStopped) as stop:
        while solver.time < 1:
            solver.advance(solver.max_step, push(), [ledger])
            solver.v[:] *= 1.02
    assert stop.value.reason is Stop.ENERGY_IMBALANCE
    assert ledger.worst_imbalance() <= 0.1  # all rows before


def test_step_past_the_limit_never_passes_for_a_result():
    """With safety above 1 a run stops before its first step."""
    solver, ledger = Solver(MESH, ELASTIC, safety=1.01), EnergyLedger()
    with pytest.raises(SolverStopped) as stop:
        solver.advance(5.0, push(), [ledger])
    assert stop.value.reason is Stop.STEP_TOO_LARGE


def test_a_nan_is_out_of_balance():
    """An energy that is not a number stops the run: it does not pass for a small imbalance."""
    solver, ledger = Solver(MESH, ELASTIC), EnergyLedger()
    solver.advance(100 * solver.max_step, push(), [ledger])
    solver.v[0, ~MESH.fixed] = np.nan
    with pytest.raises(SolverStopped):
        solver.advance(1.0, push(), [ledger])


def test_ledger_only_watches():
    """A run with a ledger has bit for bit the displacement of a run without, and a row each 128 to
    192 steps."""
    solver, ledger = run(VISCOELASTIC, duration=0.3, damping=30.0)
    alone = Solver(MESH, VISCOELASTIC, damping=30.0)
    alone.advance(0.3, push())
    assert np.array_equal(solver.u, alone.u) and np.array_equal(solver.v, alone.v)
    assert solver.steps // 192 <= len(ledger.rows) <= 1 + solver.steps // 128
    assert solver.leapfrog.kinetic_energy(solver.v) == pytest.approx(
        0.5 * np.sum(solver.mass * solver.v**2), rel=1e-12
    )


class Weight:
    """A mass on a spring that a force moves slowly: a body of another solver than the explicit."""

    damping, negligible_energy, stiffness = 0.0, 1e-12, 100.0

    def kinetic_energy(self, velocity):
        return 0.0

    def energies(self, u, velocity):
        return Energies(0.0, 0.5 * self.stiffness * float(np.sum(u**2)), 0.0, 0.0)


def test_the_ledger_and_the_frames_watch_any_solver():
    """Increments of a quasi-static body balance too: a record of the step is all that they see."""
    body, times = Weight(), np.linspace(0, 1, 5)
    ledger = EnergyLedger()
    frames, dt = FrameBalances(ledger, times, ()), 1e-3
    for n in range(1000):
        u = np.array([[1e-6 * n]])
        speed = np.full((1, 1), 1e-6 / dt)
        before = speed if n else 0 * speed
        force = body.stiffness * u
        step = Step(n * dt, dt, n, u, before, speed, force, force, 1.0, True, n == 999, body)
        for observer in (ledger, frames):
            observer(step)
    assert len(ledger.rows) == 8 and ledger.worst_imbalance() < 1e-9
    strain = frames.at_frames()[:, COLUMNS.index("strain") - 1]
    np.testing.assert_allclose(strain, 50 * (1e-3 * times) ** 2, atol=2e-7)


def test_shares_are_of_the_balances_that_are_given():
    """Means for the kinetic share, extremes for the imbalance; a NaN is never the smaller."""
    rows = [Balance(0.0, 1.0, 4.0, 1.0, 0, 0, 0, 0.1), Balance(1.0, 0.0, 6.0, 3.0, 0, 0, 0, 0.2)]
    assert kinetic_share(rows) == 0.1
    assert worst_imbalance(rows) == 0.2 and worst_imbalance([]) == 0.0
    assert np.isnan(worst_imbalance([rows[0]._replace(imbalance=np.nan), rows[1]]))
