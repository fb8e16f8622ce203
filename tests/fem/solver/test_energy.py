"""The energy ledger: it balances for every kind of run, counts work exactly, and stops a run that
invents energy."""

import dataclasses
import warnings

import numpy as np
import pytest

from fem.contact.surface import Surface
from fem.errors import SolverStopped
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver.energy import COLUMNS, EnergyLedger, kinetic_energy
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS

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
    rows = dict(zip(COLUMNS, np.array(ledger.rows).T))
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

    def compare(s):
        errors.append(ledger.external - np.vdot(load, s.u))

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
        solver.advance(0.03, lambda t: load, [ledger, lambda s: record.append(balance(s, ledger))])
        errors.append(np.abs(record).max())
    assert np.polyfit(np.log(safeties), np.log(errors), 1)[0] == pytest.approx(2, abs=0.3)


def balance(solver, ledger):
    mean = 0.5 * (solver.v + solver.v_old) if solver.steps else solver.v_old
    return (
        ledger.external - kinetic_energy(solver.mass, mean) - sum(solver.force.energies(solver.u))
    )


def test_viscous_account_spares_in_loading_and_loses_in_unloading():
    """Up to the peak the viscous stresses spare work; after unloading more was done than the
    elastic energy that is left."""
    _, ledger = run(VISCOELASTIC, damping=30.0)
    rows = dict(zip(COLUMNS, np.array(ledger.rows).T))
    loading = (rows["time"] > 0) & (rows["time"] < 0.125)
    assert loading.any() and np.all(rows["viscous"][loading] < 0)
    assert (
        rows["viscous"][-1] > 0 and rows["external"][-1] - rows["damping"][-1] > rows["strain"][-1]
    )


def test_invented_energy_stops_the_run():
    """An observer that speeds everything up by 2 % a step is found out, with the reason 'energy
    imbalance'."""

    def cheat(solver):
        solver.v *= 1.02

    solver, ledger = Solver(MESH, ELASTIC), EnergyLedger()
    with pytest.raises(SolverStopped, match="out of balance by") as stop:
        solver.advance(1.0, push(), [ledger, cheat])
    assert stop.value.reason == "energy imbalance"
    assert ledger.worst_imbalance() > 0.1 and ledger.rows[-2][-1] <= 0.1


def test_step_past_the_limit_never_passes_for_a_result():
    """With safety above 1 a run stops before its first step."""
    solver, ledger = Solver(MESH, ELASTIC, safety=1.01), EnergyLedger()
    with pytest.raises(SolverStopped) as stop:
        solver.advance(5.0, push(), [ledger])
    assert stop.value.reason == "step too large"


def test_a_nan_is_out_of_balance():
    """An energy that is not a number stops the run: it does not pass for a small imbalance."""
    solver, ledger = Solver(MESH, ELASTIC), EnergyLedger()

    def poison(s):
        if s.steps == 100:
            s.v[0, ~MESH.fixed] = np.nan

    with pytest.raises(SolverStopped):
        solver.advance(1.0, push(), [ledger, poison])


def test_ledger_only_watches():
    """A run with a ledger has bit for bit the displacement of a run without, and a row each 128 to
    192 steps."""
    solver, ledger = run(VISCOELASTIC, duration=0.3, damping=30.0)
    alone = Solver(MESH, VISCOELASTIC, damping=30.0)
    alone.advance(0.3, push())
    assert np.array_equal(solver.u, alone.u) and np.array_equal(solver.v, alone.v)
    assert solver.steps // 192 <= len(ledger.rows) <= 1 + solver.steps // 128
    assert kinetic_energy(solver.mass, solver.v) == pytest.approx(
        0.5 * np.sum(solver.mass * solver.v**2), rel=1e-12
    )


def test_bending_on_a_coarse_reduced_mesh_is_warned_of_once_and_a_full_one_is_not():
    """A narrow push on 5 x 5 x 3 reduced cells puts over 5 % of the strain energy into hourglass
    motion."""
    with pytest.warns(RuntimeWarning, match="hourglass energy is .* refine the mesh") as said:
        run(element="reduced", damping=30.0)
    assert len([warning for warning in said if "hourglass" in str(warning.message)]) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(element="full", damping=30.0)
