"""Time integration: conservation, stability, equilibrium, and the guards."""

import dataclasses
import tracemalloc

import numpy as np
import pytest

from fem.contact.surface import Surface
from fem.errors import InputError, SolverStopped, Stop
from fem.material.neo_hooke import NeoHooke
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box, tumour
from fem.solver.critical_step import lumped_mass
from fem.solver.energy import EnergyLedger
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS
from fem.solver.rest import equilibrium

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
VISCOUS = dataclasses.replace(TISSUE, prony=((0.12, 330.0), (0.8, 11.0)))
EDGE = 1e-3  # m
every_element = pytest.mark.parametrize("kind", ELEMENTS)


def no_load(mesh):
    return lambda t: np.zeros((3, mesh.n_nodes))


def moving(solver, speed, seed=0):
    """The solver with a random velocity of its free nodes."""
    random = np.random.default_rng(seed).normal(scale=speed, size=solver.v.shape)
    solver.v[:] = np.where(solver.mesh.fixed, 0, random)
    return solver


def top_push(mesh, peak):
    """(3, N) downward force of a footprint of 2.2 mm in the middle of the top."""
    load = np.zeros((3, mesh.n_nodes))
    centre = [*mesh.points[:, :2].mean(axis=0), mesh.points[:, 2].max()]
    load[2] = -peak * Surface(mesh).footprint(np.array(centre), 2.2e-3)
    return load


def test_lumped_mass_is_positive_and_complete(distort):
    """Nodal masses add up to density times volume, in any mesh, and a corner of a cube carries an
    eighth."""
    mesh = distort(box((4, 3, 2), EDGE))
    mass = lumped_mass(mesh, 1000.0)
    assert mass.min() > 0 and mass.sum() == pytest.approx(1000.0 * mesh.volume(), rel=1e-13)
    assert np.allclose(lumped_mass(box((1, 1, 1), EDGE), 1000.0), 1000.0 * EDGE**3 / 8, rtol=1e-13)


@every_element
def test_free_flight_keeps_momentum_and_angular_momentum(kind, distort):
    """A free block in random motion keeps both momenta to rounding, step by step."""
    mesh = distort(box((4, 3, 3), EDGE, "none"))
    solver, record = moving(Solver(mesh, TISSUE, kind), 0.03), []

    def observe(step):
        p = solver.mass * step.v_after
        record.append([*p.sum(axis=1), *np.cross((mesh.points.T + step.u).T, p.T).sum(axis=0)])

    size = np.abs(solver.mass * solver.v).sum()
    solver.advance(100 * solver.critical_step, no_load(mesh), [observe], steps=200)
    drift = np.abs(np.array(record) - record[0]).max(axis=0)
    assert len(record) == 200 and np.ptp(solver.u) > 0.01 * EDGE
    assert drift[:3].max() < 1e-13 * size
    assert drift[3:].max() < 1e-13 * size * np.ptp(mesh.points)


@pytest.mark.parametrize("mesh", [box((4, 4, 3), EDGE), tumour()], ids=["box", "tumour"])
@every_element
def test_critical_step_is_sharp(kind, mesh):
    """600 steps of 0.98 of the critical step keep a small motion small; with 1.02 it grows without
    bound."""
    stable = moving(Solver(mesh, TISSUE, kind), 1e-9)
    speed = np.linalg.norm(stable.v)
    stable.advance(600 * 0.98 * stable.critical_step, no_load(mesh), steps=600)
    assert np.linalg.norm(stable.v) < 2 * speed
    unstable = moving(Solver(mesh, TISSUE, kind), 1e-9)
    duration = 600 * 1.02 * unstable.critical_step
    unstable.pace.critical = np.inf  # or the step would be refused at once
    with pytest.raises(SolverStopped):
        unstable.advance(duration, no_load(mesh), steps=600)
    assert unstable.steps > 16


def test_distorted_cells_have_their_own_critical_step(distort):
    """The estimate is sharp on a mesh of warped, unequal cells too."""
    mesh = distort(box((4, 4, 3), EDGE), 0.25)
    solver = moving(Solver(mesh, TISSUE), 1e-9)
    speed = np.linalg.norm(solver.v)
    solver.advance(600 * 0.98 * solver.critical_step, no_load(mesh), steps=600)
    assert np.linalg.norm(solver.v) < 2 * speed
    steps, duration = solver.steps, 600 * 1.02 * solver.critical_step
    solver.pace.critical = np.inf  # or the step would be refused at once
    with pytest.raises(SolverStopped):
        solver.advance(duration, no_load(mesh), steps=600)
    assert solver.steps > steps + 16


@pytest.mark.parametrize("precision, tolerance", [("float64", 1e-6), ("float32", 2e-5)])
def test_damping_comes_to_the_equilibrium_of_another_code(precision, tolerance, reference):
    """Dynamic relaxation under two nodal forces ends at felupe's static solution."""
    ref = reference("ref1_block_two_nodal_forces_hex8")
    mesh = HexMesh(ref["points"], ref["cells"], ref["fixed"])
    solver = Solver(mesh, TISSUE, precision=precision, damping=400.0)
    solver.advance(0.08, lambda t: ref["loads"].T)
    assert np.linalg.norm(solver.u.T - ref["u"][-1]) < tolerance * np.linalg.norm(ref["u"][-1])
    assert solver.steps < 400


def test_equilibrium_of_another_code(reference):
    """`equilibrium` finds felupe's static solutions at all four loads, from a residual of 1e-7."""
    ref = reference("ref1_block_two_nodal_forces_hex8")
    mesh = HexMesh(ref["points"], ref["cells"], ref["fixed"])
    for level, u in zip(ref["levels"], ref["u"], strict=True):
        found = equilibrium(mesh, TISSUE, level * ref["loads"], residual=1e-7)
        assert found.residual <= 1e-7 and found.steps < 1500
        assert np.linalg.norm(found.displacement - u) < 1e-6 * np.linalg.norm(u)


def test_equilibrium_of_relaxed_tissue():
    """With Prony terms the rest state is that of the tissue with g0 times the moduli."""
    mesh = box((4, 4, 3), EDGE)
    load = top_push(mesh, 2e-4).T
    relaxed = equilibrium(
        mesh, dataclasses.replace(TISSUE, prony=((0.12, 330.0), (0.63, 11.0))), load, residual=1e-9
    )
    soft = equilibrium(mesh, dataclasses.replace(TISSUE, mu=100.0), load, residual=1e-9)
    assert np.allclose(
        relaxed.displacement, soft.displacement, atol=1e-7 * np.abs(soft.displacement).max()
    )


def test_equilibrium_says_what_is_wrong():
    """A load of the wrong shape or size, or too few steps, is an error with its reason."""
    mesh = box((4, 4, 3), EDGE)
    load = top_push(mesh, 1e-3).T
    for bad in (load.T, load * np.nan):
        with pytest.raises(InputError, match="must be finite and of shape"):
            equilibrium(mesh, TISSUE, bad)
    with pytest.raises(SolverStopped, match="residual .* after 200 steps") as stop:
        equilibrium(mesh, TISSUE, load, residual=1e-12, max_steps=200)
    assert stop.value.reason is Stop.NOT_AT_REST
    assert not equilibrium(mesh, TISSUE, 0 * load).displacement.any()


def test_step_follows_the_compressed_tissue():
    """A push that blows up at the step of the rest shape stays balanced to 1e-4 when the step is
    estimated again."""
    mesh = box((6, 6, 4), EDGE)
    peak, duration = top_push(mesh, 7e-3), 0.3

    def ramp(t):
        return peak * min(t / (0.6 * duration), 1)

    fixed = Solver(mesh, TISSUE, damping=50.0)
    rest = fixed.critical_step
    with pytest.raises(SolverStopped):
        fixed.advance(
            duration, ramp, [EnergyLedger()], steps=int(np.ceil(duration / fixed.max_step))
        )
    solver, ledger = Solver(mesh, TISSUE, damping=50.0), EnergyLedger()
    solver.advance(duration, ramp, [ledger])
    assert solver.critical_step < 0.86 * rest and ledger.smallest_J < 0.32
    assert ledger.worst_imbalance() < 1e-4
    solver.advance(duration, no_load(mesh), [ledger])
    assert solver.critical_step > 0.97 * rest


def test_mass_scaling_lengthens_the_step_by_its_root():
    """Sixteen times the mass takes four times the step."""
    mesh = box((4, 4, 3), EDGE)
    assert Solver(mesh, TISSUE, mass_scaling=16.0).critical_step == pytest.approx(
        4 * Solver(mesh, TISSUE).critical_step, rel=1e-6
    )


def test_fixed_number_of_steps():
    """`steps` takes exactly that many; with the number that the stable step asks for nothing
    changes."""
    mesh = box((4, 4, 3), EDGE)
    load = top_push(mesh, 0.8e-3)
    free, fixed = Solver(mesh, TISSUE), Solver(mesh, TISSUE)
    free.advance(0.02, lambda t: load)
    fixed.advance(0.02, lambda t: load, steps=free.steps)
    assert fixed.steps == free.steps and np.array_equal(free.u, fixed.u)
    fixed.advance(1e-3, lambda t: load, steps=50)
    assert fixed.steps == free.steps + 50 and fixed.time == pytest.approx(0.021, rel=1e-12)


def test_crushed_cell_stops_the_run_and_is_named():
    """A slow push beyond what a cell can bear stops with 'crushed cell' and its number, before J is
    negative."""
    mesh = box((1, 1, 1), EDGE, "bottom")
    solver = Solver(mesh, TISSUE, damping=500.0)
    weight = np.where(mesh.points[:, 2] > 0, -4e-3, 0) * np.array([[0], [0], [1]])
    with pytest.raises(SolverStopped, match="cell 0 is crushed to J = 0.0") as stop:
        while solver.time < 0.2:
            solver.advance(solver.max_step, lambda t: t / 0.2 * weight)
            solver.u[:2] = solver.v[:2] = 0  # no lateral strain
    assert (
        stop.value.reason is Stop.CRUSHED_CELL and solver.time > 0.1 and np.isfinite(solver.u).all()
    )


@pytest.mark.parametrize("peak", [1e-3, 1e-2, 3e-2, 0.1, 1.0, 1e3, 1e100, np.nan])
def test_no_run_ends_with_nonsense(peak):
    """Whatever the sudden push, a run ends with a finite balanced state or stops with a reason."""
    mesh = box((4, 4, 3), EDGE)
    load = top_push(mesh, 1.0) * peak
    solver, ledger = Solver(mesh, TISSUE), EnergyLedger()
    try:
        solver.advance(0.1, lambda t: load, [ledger])
    except SolverStopped as stop:
        assert peak > 1e-3 or np.isnan(peak)
        assert stop.reason in (
            Stop.DIVERGED,
            Stop.CRUSHED_CELL,
            Stop.INVERTED_CELL,
            Stop.NO_STABLE_STEP,
            Stop.ENERGY_IMBALANCE,
        )
        assert str(stop).endswith(stop.reason.remedy)
    else:
        assert peak == 1e-3 and np.isfinite(solver.u).all() and ledger.smallest_J > 0.05


def test_impossible_settings_are_refused():
    """A mesh that cannot move and settings without meaning are InputErrors that name the
    setting."""
    mesh = box((2, 2, 2), EDGE)
    held = dataclasses.replace(mesh, fixed=np.ones(mesh.n_nodes, bool))
    with pytest.raises(InputError, match="every node"):
        Solver(held, TISSUE)
    for name, value in (
        ("damping", -1.0),
        ("mass_scaling", 0.5),
        ("safety", 0.0),
        ("hourglass_stiffness", np.nan),
    ):
        with pytest.raises(InputError, match=f"solver.{name} = {value}"):
            Solver(mesh, TISSUE, **{name: value})


@pytest.mark.parametrize("duration", [-1.0, np.nan, np.inf])
def test_a_time_that_cannot_pass_is_refused(duration):
    mesh = box((2, 2, 2), EDGE)
    solver = Solver(mesh, TISSUE)
    with pytest.raises(InputError, match=f"duration = {duration} must be from 0"):
        solver.advance(duration, no_load(mesh))
    assert solver.time == 0 and solver.steps == 0


@pytest.mark.parametrize("steps", [0, -3, 2.5, "many"])
def test_a_number_of_steps_that_means_none_is_refused(steps):
    mesh = box((2, 2, 2), EDGE)
    solver = Solver(mesh, TISSUE)
    with pytest.raises(
        InputError, match=f"steps = '?{steps}'? must be a whole number|steps = .* must be from 1"
    ):
        solver.advance(0.01, no_load(mesh), steps=steps)
    assert solver.time == 0 and solver.steps == 0


@pytest.mark.parametrize("shape", [(3, 1), (3,), (27, 3), ()])
def test_a_load_that_is_not_one_force_a_node_is_refused(shape):
    """It would be broadcast to all nodes, or fail in the middle of a step."""
    solver = moving(Solver(box((2, 2, 2), EDGE), TISSUE), 1e-9)
    before = solver.snapshot()
    with pytest.raises(
        InputError, match=r"load has shape \(.*give nodal forces of shape \(3, 27\)"
    ):
        solver.advance(0.01, lambda t: np.ones(shape))
    after = solver.snapshot()
    assert all(np.array_equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("material", [TISSUE, VISCOUS], ids=["elastic", "viscous"])
@pytest.mark.parametrize("kind, precision", [("full", "float64"), ("reduced", "float32")])
def test_a_snapshot_goes_on_bit_for_bit(material, kind, precision):
    """A run that is restored, in another solver too, ends as the run that went on."""
    mesh = box((4, 4, 3), EDGE)
    load = top_push(mesh, 3e-3)
    first, second = (Solver(mesh, material, kind, precision, damping=20.0) for _ in range(2))
    first.advance(0.02, lambda t: min(1.0, t / 0.03) * load)
    kept = first.snapshot()
    ends = []
    for solver in (first, first, second):
        solver.restore(kept)
        solver.advance(0.02, lambda t: min(1.0, t / 0.03) * load)
        ends.append(solver.snapshot())
    assert ends[0]["state.u"].any() and ends[0]["state.steps"] > kept["state.steps"]
    for end in ends[1:]:
        assert all(np.array_equal(end[name], ends[0][name]) for name in end)
    with pytest.raises(InputError, match="of another solver"):
        Solver(box((2, 2, 2), EDGE), material).restore(kept)


def test_a_step_leaves_the_state_before_it_as_it_was():
    """The leapfrog returns a new state; only the step after the next writes to its arrays again."""
    mesh = box((4, 4, 3), EDGE)
    leapfrog = Solver(mesh, TISSUE).leapfrog
    state = leapfrog.rest()
    state.load[:] = top_push(mesh, 1e-3)
    for _ in range(4):
        u, v = state.u.copy(), state.v.copy()
        new, stop = leapfrog.step(state, 1e-4)
        assert stop is None and new.steps == state.steps + 1
        assert np.array_equal(state.u, u) and np.array_equal(state.v, v)
        assert not np.shares_memory(new.u, state.u)
        state = new
    assert state.u.any()


def test_a_step_says_why_the_run_must_stop():
    """A cell that is crushed or no number at all is a result of the step, not an exception."""
    mesh = box((1, 1, 1), EDGE, "bottom")
    leapfrog = Solver(mesh, TISSUE).leapfrog
    state = leapfrog.rest()
    state.u[2] = -0.96 * mesh.points[:, 2]
    assert leapfrog.step(state, 1e-6)[1] is Stop.CRUSHED_CELL
    state.u[2] = np.nan
    with np.errstate(invalid="ignore"):
        assert leapfrog.step(state, 1e-6)[1] is Stop.DIVERGED


def test_the_loop_allocates_nothing_that_grows_with_the_mesh():
    """200 steps need no more memory at their peak than the block that samples the load."""
    mesh = box((12, 12, 8), EDGE)
    solver, load = Solver(mesh, TISSUE), top_push(mesh, 1e-6)
    solver.advance(0.005, lambda t: load)
    tracemalloc.start()
    for _ in range(20):
        solver.state, _ = solver.leapfrog.step(solver.state, solver.max_step)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 * solver.u.nbytes
