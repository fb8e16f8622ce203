"""The quasi-static solver against the explicit one, felupe, closed forms and itself."""

import numpy as np
import pytest

from fem.contact.push import Contact, Load, Push
from fem.contact.surface import surface_of
from fem.errors import InputError, SolverStopped, Stop
from fem.material.groups import by_cells
from fem.material.mooney_rivlin import MooneyRivlin
from fem.material.neo_hooke import NeoHooke
from fem.material.ogden import Ogden
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box
from fem.online.creep import Creep
from fem.solver import balance, load_steps
from fem.solver.balance import Balance, by_newton
from fem.solver.energy import EnergyLedger, FrameBalances, worst_imbalance
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS, InternalForce
from fem.solver.quasistatic import QuasiStatic
from fem.solver.rest import equilibrium
from fem.solver.stiffness import Equations, Stiffness

PRONY = ((0.12, 330.0), (0.8, 11.0))
TISSUE = NeoHooke(400.0, 0.42, 1000.0, PRONY)
LAWS = {
    "neo_hooke": TISSUE,
    "mooney_rivlin": MooneyRivlin(120.0, 80.0, 0.42, 1000.0, PRONY),
    "ogden": Ogden(((300.0, 1.5), (-50.0, -4.0)), 0.42, 1000.0, PRONY),
}


@pytest.fixture(scope="module")
def block():
    return box((4, 4, 3), 1e-3)


def pressing(mesh, newton=4e-4):
    """A push on the middle of the top."""
    return Load(surface_of(mesh), [Push("middle", newton, 2e-3, ramp=0.5)])


def advance(solver, load, times):
    """Displacements (times, 3, N)."""
    found = []
    for time in times:
        solver.advance(time - solver.time, load)
        found.append(solver.u.copy())
    return np.array(found)


def distance(u, v):
    return np.linalg.norm(u - v) / np.linalg.norm(v)


@pytest.mark.filterwarnings("ignore:hourglass")
@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("law", LAWS)
def test_tangent_is_that_of_the_force(block, law, element):
    """K v is the difference of the internal force, with a stress history and at large strain, for
    every law and element."""
    solver = QuasiStatic(block, LAWS[law], element, tolerance=1e-6)
    advance(solver, pressing(block), [0.5, 2.0])
    equations, stiffness = solver.search.equations, solver.search.stiffness
    bends = [0.1 * solver.u, 0.2 * solver.u]
    solver.force.expect(1.0, bends)
    stiffness.follow(solver.force, 1.0, bends)
    x = equations.vector(solver.u)
    v = np.random.default_rng(0).normal(size=x.size)
    h = 1e-8 / np.abs(v).max()

    def force(x):
        return equations.vector(solver.force(equations.field(x)))

    exact = (force(x + h * v) - force(x - h * v)) / (2 * h)
    assert distance(stiffness.matrix(solver.u) @ v, exact) < 1e-7


def test_newton_converges_quadratically(block):
    """Each residual is of the size of the last one's square."""
    material = TISSUE.elastic()
    equations = Equations(block)
    stiffness = Stiffness(block, material, "full", 0.2, equations)
    watched = Watched(InternalForce(block, material), equations, pressing(block)(1.0), 1e-14)
    by_newton(watched, np.zeros(equations.size), stiffness)
    relative = np.array(watched.norms) / watched.norms[0]
    fast = relative[(relative < 0.1) & (relative > 1e-9)]
    assert len(fast) >= 2 and (fast[1:] < 5 * fast[:-1] ** 2).all()


class Watched(Balance):
    """A Balance that keeps the norms of its residuals."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.norms = []

    def residual(self, x):
        r, error = super().residual(x)
        self.norms.append(np.linalg.norm(r))
        return r, error


@pytest.mark.filterwarnings("ignore:hourglass")
@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("law", LAWS)
def test_every_step_ends_in_equilibrium(block, law, element):
    """The internal force with the stress history brought up to date, another path through the code
    than the one that is solved, is the load, for every law and element."""
    solver, load = QuasiStatic(block, LAWS[law], element, tolerance=1e-7), pressing(block)
    for time in (0.3, 1.0, 4.0):
        solver.advance(time - solver.time, load)
        residual = solver.search.equations.vector(load(time) - solver.force(solver.u))
        assert np.linalg.norm(residual) < 1e-7 * np.linalg.norm(load(time))


@pytest.mark.filterwarnings("ignore:hourglass")
@pytest.mark.parametrize("element", ELEMENTS)
def test_a_slow_push_is_that_of_the_explicit_solver(block, element):
    """At the true mass, up to what inertia and damping do."""
    load = Load(surface_of(block), [Push("middle", 4e-4, 2e-3, ramp=1.0)])
    times = [0.25, 0.5, 0.75, 1.0, 1.25]
    exact = Solver(block, TISSUE, element, "float32", damping=50.0)
    found = QuasiStatic(block, TISSUE, element, "float32")
    assert distance(advance(found, load, times), advance(exact, load, times)) < 4e-3


@pytest.mark.parametrize("level", range(4))
def test_elastic_answers_are_those_of_felupe(reference, level):
    """felupe's Newton solution under two nodal forces, at four loads."""
    ref = reference("ref1_block_two_nodal_forces_hex8")
    mesh = HexMesh(ref["points"], ref["cells"], ref["fixed"])
    load = (ref["levels"][level] * ref["loads"]).T
    solver = QuasiStatic(mesh, TISSUE.elastic(), tolerance=1e-9)
    solver.gate = None
    solver.advance(1.0, lambda t: load)
    assert distance(solver.u.T, ref["u"][level]) < 1e-8


@pytest.mark.parametrize("times", [[1.0, 5.0, 30.0, 120.0, 600.0], [600.0]])
def test_a_held_force_creeps_as_the_creep_function(block, times):
    """In the small, for steps of any length: the step knows what of the stress bends."""
    load = 1e-4 * pressing(block)(1.0)
    solver, elastic = (
        QuasiStatic(block, law, tolerance=1e-8) for law in (TISSUE, TISSUE.elastic())
    )
    elastic.advance(1.0, lambda t: load)
    for time in times:
        solver.advance(time - solver.time, lambda t: load)
        assert distance(solver.u, Creep.of(PRONY)(time) * elastic.u) < 1e-3
    assert solver.steps < 20 * len(times)


def test_the_error_is_of_second_order_in_the_step(block, monkeypatch):
    """Where a step knows nothing of what bends."""
    monkeypatch.setattr(load_steps, "BEND", np.inf)
    monkeypatch.setattr(load_steps, "STRAIGHT", np.inf)
    load = Load(surface_of(block), [Push("middle", 4e-4, 2e-3, ramp=4.0)])

    def end(steps):
        solver = QuasiStatic(block, TISSUE, tolerance=1e-8)
        return advance(solver, load, np.linspace(0, 8, steps + 1)[1:])[-1]

    exact = end(128)
    errors = [distance(end(steps), exact) for steps in (4, 8, 16)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[0] < 2e-3 and (orders > 1.8).all() and (orders < 2.5).all()


def test_long_frames_end_where_short_ones_do(block):
    """An oscillation within a frame is followed by as many steps as it takes."""
    contact = Contact(
        np.array([2e-3, 2e-3, 3e-3]),
        np.array([2.5e-3, 2e-3, 3e-3]),
        np.array([0.0, 0.0, -1.0]),
        2e-3,
        4e-4,
        pattern="oscillate",
        hold=0.2,
        rate=0.7,
        duration=5.0,
    )
    load = Load(surface_of(block), [contact])
    short, long = (QuasiStatic(block, TISSUE) for _ in "ab")
    short, steps = advance(short, load, np.arange(1, 41) / 8), long
    long = advance(long, load, [2.5, 5.0])
    assert 2 < steps.steps < 20 and distance(long, short[[19, 39]]) < 3e-3


def test_a_sudden_force_gives_the_elastic_answer_at_once(block):
    load = pressing(block)(1.0)
    solver, elastic = QuasiStatic(block, TISSUE), QuasiStatic(block, TISSUE.elastic())
    for one in (solver, elastic):
        one.advance(1e-3, lambda t: load)
    assert distance(solver.u, elastic.u) < 1e-3
    solver.advance(5.0, lambda t: load)
    assert distance(solver.u, elastic.u) > 0.2
    for _ in range(4):
        solver.advance(30.0, lambda t: 0.0 * load)
    assert np.abs(solver.u).max() < 0.5 * np.abs(elastic.u).max()


def test_elastic_tissue_has_no_history_and_takes_one_step_a_frame(block):
    solver, load = QuasiStatic(block, TISSUE.elastic()), pressing(block)
    advance(solver, load, [2.5, 5.0])
    assert solver.steps == 2 and not solver.force.state() and not solver.load_steps.state()
    assert all(chunk.history is None for chunk in solver.force._chunks)
    assert solver.elastic_force is solver.force
    rest = equilibrium(block, TISSUE.elastic(), load(5.0).T, 1e-4)
    assert distance(solver.u.T, rest.displacement) < 1e-3


def test_cells_of_their_own_material_are_followed():
    """A stiff core under the push: the state of rest of the same mesh."""
    mesh = box((4, 4, 3), 1e-3)
    mesh = mesh.with_sets(core=mesh.points[mesh.cells].mean(axis=1)[:, 2] > 2e-3)
    law = by_cells(TISSUE.elastic(), mesh, {"core": {"mu": 4000.0}})
    solver, load = QuasiStatic(mesh, law, tolerance=1e-5), pressing(mesh)
    solver.advance(1.0, load)
    assert distance(solver.u.T, equilibrium(mesh, law, load(1.0).T).displacement) < 1e-4


@pytest.mark.parametrize("most", [2, 6])
def test_newton_takes_over_where_chords_do_not_come_to_an_end(block, most, monkeypatch):
    """The answer is the same; with few iterations of each, after load increments."""
    load = pressing(block)
    easy = QuasiStatic(block, TISSUE, tolerance=1e-6)
    easy.advance(1.0, load)
    monkeypatch.setattr(balance, "MOST_CHORDS", 1)
    monkeypatch.setattr(balance, "MOST_NEWTONS", most)
    solver = QuasiStatic(block, TISSUE, tolerance=1e-6)
    solver.advance(1.0, load)
    assert distance(solver.u, easy.u) < 1e-5


def test_a_snapshot_goes_on_bit_for_bit(block, monkeypatch):
    """In another solver too, with a stiffness that is no longer that of rest."""
    monkeypatch.setattr(balance, "MOST_CHORDS", 3)
    load = pressing(block, 1e-3)
    one, other = (QuasiStatic(block, TISSUE, precision="float32") for _ in "ab")
    one.gate = other.gate = None
    advance(one, load, [0.25, 0.5])
    assert one.search.stiffened_at.any()
    kept = one.snapshot()
    expected = advance(one, load, [1.0, 2.0])
    other.restore(kept)
    assert np.array_equal(advance(other, load, [1.0, 2.0]), expected)
    one.restore(kept)
    assert np.array_equal(advance(one, load, [1.0, 2.0]), expected)
    with pytest.raises(InputError, match="is of another"):
        QuasiStatic(block, TISSUE.elastic()).restore(kept)


def test_what_has_no_equilibrium_is_stopped_where_it_was(block):
    solver, load = QuasiStatic(block, TISSUE), pressing(block)
    solver.advance(0.5, load)
    u = solver.u.copy()
    with pytest.raises(
        SolverStopped, match="the residual is .* of the load at 0.5 s.*lower"
    ) as stop:
        solver.advance(1.0, lambda t: 1e4 * load(t))
    assert stop.value.reason is Stop.NOT_IN_EQUILIBRIUM
    assert solver.time == 0.5 and np.array_equal(solver.u, u)
    other = QuasiStatic(block, TISSUE)
    for one in (solver, other):
        one.advance(2.0 - one.time, load)
    assert distance(solver.u, other.u) < 3e-3


def test_bad_input_changes_nothing(block):
    solver, load = QuasiStatic(block, TISSUE), pressing(block)
    for duration in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="duration"):
            solver.advance(duration, load)
    with pytest.raises(InputError, match="the load has shape"):
        solver.advance(1.0, lambda t: load(t).T)
    with pytest.raises(InputError, match="not finite"):
        solver.advance(1.0, lambda t: np.nan * load(1.0))
    assert solver.time == 0 and not solver.u.any()
    with pytest.raises(InputError, match="tolerance = 1e-06 must be from 1e-05"):
        QuasiStatic(block, TISSUE, precision="float32", tolerance=1e-6)
    with pytest.raises(InputError, match="can move without force"):
        QuasiStatic(box((2, 2, 2), 1e-3, "none"), TISSUE)
    with pytest.raises(InputError, match="can move without force"):
        QuasiStatic(box((3, 3, 3), 1e-3, "bottom"), TISSUE, "reduced", hourglass_stiffness=0.0)


def test_energy_balances_to_second_order_in_the_frame(block):
    """What the load does is what is stored, and what relaxation spares."""
    load = Load(surface_of(block), [Push("middle", 4e-4, 2e-3, ramp=1.0)])
    worst = []
    for frames in (10, 20, 40):
        ledger, times = EnergyLedger(), np.linspace(0, 2, frames + 1)
        balances = FrameBalances(ledger, times, PRONY)
        solver = QuasiStatic(block, TISSUE, tolerance=1e-6)
        for time in times[1:]:
            solver.advance(time - solver.time, load, [ledger, balances])
        assert [row.time for row in balances.rows] == pytest.approx(times, abs=1e-9)
        worst.append(worst_imbalance(balances.rows))
        last = balances.rows[-1]
    assert worst[0] < 0.01 and worst[2] < worst[0] / 8
    assert last.kinetic == 0 and last.viscous < 0 < last.strain
    assert last.external == pytest.approx(last.strain + last.viscous, rel=1e-3)


def test_the_gate_looks_at_the_end_of_every_advance(block):
    solver = QuasiStatic(block, TISSUE)
    solver.advance(1.0, pressing(block))
    signs = solver.gate.signs
    assert 0 < signs.disequilibrium <= 1e-3 and 0.5 < signs.corner_J < 1
