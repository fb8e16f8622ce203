"""The stability map: it runs, nothing in it is wrong, and what it has found stays found."""

import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fem.contact.surface import Surface
from fem.errors import InputError, SolverStopped, Stop
from fem.material.neo_hooke import NeoHooke
from fem.measure import limits, limits_report
from fem.measure.sweeps import Sweep
from fem.mesh.shapes import box
from fem.solver.body import LOCKING_NU
from fem.solver.energy import EnergyLedger
from fem.solver.explicit import Solver
from fem.solver.internal_force import InternalForce
from fem.solver.rest import equilibrium

ROOT = Path(__file__).parents[3]
TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
EDGE = 1e-3  # m
BLOCK = box((6, 6, 4), EDGE)


def push(peak):
    """(3, N) downward force on a footprint of 2.2 mm in the middle of the block."""
    load = np.zeros((3, BLOCK.n_nodes))
    load[2] = -peak * Surface(BLOCK).footprint(np.array([3, 3, 4]) * EDGE, 2.2e-3)
    return load


def cells(folder):
    """[(sweep, value, outcome, error, tolerance)] of the table in stability.md."""
    rows = [
        [part.strip() for part in line.split("|")[1:-1]]
        for line in (folder / "stability.md").read_text().splitlines()
        if line.startswith("|")
    ]
    return [row[:5] for row in rows if len(row) == 6 and row[0] != "sweep" and set(row[0]) != {"-"}]


def assert_nothing_wrong(table):
    for sweep, value, outcome, error, tolerance in table:
        assert re.fullmatch(r"accurate|(stopped|rejected): [a-z ]+", outcome), (
            f"{sweep} {value}: {outcome} {error}"
        )
        assert outcome != "accurate" or float(error) <= float(tolerance)


@pytest.mark.slow
def test_quick_map_has_no_wrong_cell(tmp_path):
    """`python tools/stability.py --quick` ends well and writes a figure and a table in which every
    cell is accurate, stopped or rejected."""
    command = [sys.executable, "tools/stability.py", "--quick", "--out", str(tmp_path)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stdout + run.stderr
    table = cells(tmp_path)
    assert len(table) >= 30 and (tmp_path / "stability.png").stat().st_size > 10_000
    assert_nothing_wrong(table)
    assert {"accurate"} < {row[2] for row in table}


def test_a_map_of_nothing_is_refused():
    """`--only` with a word that no sweep has tests nothing, and says which words there are."""
    command = [sys.executable, "tools/stability.py", "--only", "zzz"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 2 and "no cell of the map has 'zzz' in its name" in run.stderr
    assert "density contrast" in run.stderr and not run.stdout
    with pytest.raises(InputError, match="'one hour'"):
        limits.measure(quick=True, only="one hour")


def test_a_run_that_hangs_is_wrong(monkeypatch):
    """It is ended after the time limit and counts as WRONG; where the system has no alarm it goes
    on."""
    monkeypatch.setattr(limits, "HANG", 1)
    sweep = Sweep("endless", (0.0,), lambda x: time.sleep(5) or x, "nothing", 1.0)
    assert limits.evaluate(sweep, 0.0).reason == "hangs"
    monkeypatch.setattr(limits, "HAS_ALARM", False)
    quick = Sweep("short", (0.0,), lambda x: time.sleep(1.2) or x, "nothing", 1.0)
    assert limits.evaluate(quick, 0.0).status == "accurate"


def test_locking_is_seen_without_touching_the_limit():
    """The full element's error above the limit is that of a locking one, and is refused as
    before."""
    stiff = NeoHooke(mu=400.0, nu=0.4999, density=1000.0)
    with pytest.raises(InputError, match="locks"):
        equilibrium(BLOCK, stiff, push(1e-4).T)
    locked = equilibrium(BLOCK, stiff, push(1e-4).T, 1e-3, allow_locking=True).displacement
    free = equilibrium(BLOCK, stiff, push(1e-4).T, 1e-3, "mean_dilatation").displacement
    assert 0 < np.linalg.norm(locked) < 0.5 * np.linalg.norm(free)


def test_published_map_is_complete_and_has_no_wrong_cell():
    """docs/stability.md holds every sweep and value of the map, under the text that would be
    written."""
    table = cells(ROOT / "docs")
    assert [(row[0], row[1]) for row in table] == [
        (sweep.name, sweep.label(value)) for sweep in limits.rows() for value in sweep.values
    ]
    assert_nothing_wrong(table)
    published = (ROOT / "docs/stability.md").read_text()
    for part in (*limits_report.INTRODUCTION.split("{counts}"), limits_report.LOCKING):
        assert part in published


@pytest.mark.parametrize("kind", ["full", "reduced", "mean_dilatation"])
@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e-2])
def test_single_precision_keeps_small_strains(kind, size):
    """The float32 force is true to 1e-5 for strains down to 1e-9, and at nu = 0.4999."""
    u = size * EDGE * np.random.default_rng(0).uniform(-1, 1, (3, BLOCK.n_nodes))
    material = NeoHooke(mu=400.0, nu=0.4999 if kind == "mean_dilatation" else 0.42, density=1000.0)
    single, double = (
        InternalForce(BLOCK, material, kind, precision)(u) for precision in ("float32", "float64")
    )
    assert np.linalg.norm(single - double) < 1e-5 * np.linalg.norm(double)


def test_locking_element_is_refused_with_the_remedy():
    """The full element is an InputError above the limit that names another; the others take nu =
    0.4999."""
    stiff = NeoHooke(mu=400.0, nu=0.4999, density=1000.0)
    with pytest.raises(
        InputError, match="locks at material.nu = 0.4999 .*; use element = 'mean_dilatation'"
    ):
        Solver(BLOCK, stiff)
    Solver(BLOCK, NeoHooke(400.0, LOCKING_NU, 1000.0))
    depth = [
        -np.vdot(push(1.0).T, equilibrium(BLOCK, stiff, push(1e-4).T, 1e-3, kind).displacement)
        for kind in ("reduced", "mean_dilatation")
    ]
    assert depth[0] == pytest.approx(depth[1], rel=0.15) and depth[0] < 0


def test_hourglass_control_relaxes_with_the_stress():
    """A reduced block creeps under a footprint as its stress does: 3.77 times in a minute, not 3.37
    times."""
    viscous = NeoHooke(mu=400.0, nu=0.42, density=1000.0, prony=((0.12, 330.0), (0.8, 11.0)))
    load = push(1e-7)
    solver, ledger = (
        Solver(BLOCK, viscous, "reduced", mass_scaling=1e4, damping=2.0),
        EnergyLedger(),
    )
    solver.advance(60.0, lambda t: load, [ledger])
    elastic = equilibrium(BLOCK, TISSUE, load.T, 1e-5, "reduced").displacement.T
    creep = 12.5 - 3.2365 * np.exp(-60 / 50.68) - 8.2635 * np.exp(-60 / 895.3)
    assert np.vdot(load, solver.u) / np.vdot(load, elastic) == pytest.approx(creep, rel=5e-3)


def test_short_pulse_keeps_its_impulse():
    """A pulse of twelve steps, shorter than the usual time between samples of the load, gives a
    free block its momentum."""
    mesh = box((2, 2, 2), EDGE, "none")
    solver = Solver(mesh, TISSUE)
    start, length = 100.3 * solver.max_step, 6.1 * solver.max_step
    force = 1e-6 * np.outer([0, 0, 1], solver.mass / solver.mass.sum())
    solver.advance(150 * solver.max_step, lambda t: force * max(0.0, 1 - abs(t - start) / length))
    assert (solver.mass * solver.v[2]).sum() == pytest.approx(1e-6 * length, rel=0.05)


@pytest.mark.parametrize("peak", [2e-3, 5e-3])
def test_impact_is_saved_by_smaller_steps(peak):
    """A sudden force that crushed cells at the usual step ends in balance, close to the run with
    small steps."""
    load, depths = push(peak), []
    for safety in (0.85, 0.1):
        solver, ledger, record = Solver(BLOCK, TISSUE, safety=safety), EnergyLedger(), []

        def watch(step, record=record):
            record.append((step.time, np.vdot(load, step.u)))

        solver.advance(0.03, lambda t: load, [ledger, watch])
        assert ledger.worst_imbalance() < 0.03 and ledger.smallest_J > 0.2
        depths.append(np.interp(np.linspace(0, 0.03, 100), *np.transpose(record)))
    assert np.linalg.norm(depths[0] - depths[1]) < 0.08 * np.linalg.norm(depths[1])


def test_tangled_cells_stop_the_run():
    """A reduced cell that folds over although its centre keeps its volume is found out."""
    load = push(5e-3)
    solver = Solver(BLOCK, TISSUE, "reduced", damping=50.0)
    with pytest.raises(SolverStopped, match="cell .* is turned inside out at a corner") as stop:
        solver.advance(0.15, lambda t: min(1.0, t / 0.1) * load, [EnergyLedger()])
    assert stop.value.reason is Stop.INVERTED_CELL and solver.force.min_J > 0.5


def test_step_past_the_critical_is_refused():
    """As a safety above 1 or as too few steps, it is stopped before the first step; so is a run
    without end."""
    still = np.zeros((3, BLOCK.n_nodes))
    for solver, steps in ((Solver(BLOCK, TISSUE, safety=1.05), None), (Solver(BLOCK, TISSUE), 99)):
        with pytest.raises(SolverStopped, match="exceeds the critical") as stop:
            solver.advance(100 * solver.critical_step, lambda t: still, steps=steps)
        assert stop.value.reason is Stop.STEP_TOO_LARGE and solver.steps == 0
    with pytest.raises(
        SolverStopped,
        match="cell .* is the thinnest; repair the thinnest cell or raise solver.mass_scaling",
    ) as stop:
        Solver(BLOCK, TISSUE).advance(1e6, lambda t: still)
    assert stop.value.reason is Stop.TOO_MANY_STEPS


def test_mass_scaling_may_differ_from_cell_to_cell():
    """One factor a cell acts on that cell's mass; a wrong number of factors is refused."""
    half = np.where(np.arange(BLOCK.n_cells) < 72, 1.0, 16.0)
    assert Solver(BLOCK, TISSUE, mass_scaling=half).mass.sum() == pytest.approx(
        8.5 * Solver(BLOCK, TISSUE).mass.sum(), rel=1e-12
    )
    assert np.array_equal(
        Solver(BLOCK, TISSUE, mass_scaling=np.full(144, 4.0)).mass,
        Solver(BLOCK, TISSUE, mass_scaling=4.0).mass,
    )
    for wrong in (half[:-1], -half, half * np.nan):
        with pytest.raises(InputError, match="mass_scaling"):
            Solver(BLOCK, TISSUE, mass_scaling=wrong)
