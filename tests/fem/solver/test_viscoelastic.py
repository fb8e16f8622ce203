"""Quasi-linear viscoelasticity: stress histories against quadrature, and what a run makes of
them."""

import dataclasses
from decimal import Decimal, getcontext

import numpy as np
import pytest

from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver.energy import EnergyLedger
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS, InternalForce
from fem.solver.relaxation import history_coefficients

PAPER = ((0.12, 330.0), (0.8, 11.0))
TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0, prony=PAPER)
ELASTIC = dataclasses.replace(TISSUE, prony=())
EDGE = 1e-3  # m


def confined_stress(times, stretch, material=TISSUE, kind="full", precision="float64"):
    """S (n, 3, 3) of one cell stretched along x at `times`, without lateral strain, from its nodal
    forces."""
    mesh = box((1, 1, 1), EDGE)
    force, stress, last = InternalForce(mesh, material, kind, precision), [], times[0]
    for t, a in zip(times, stretch, strict=True):
        force.relax(t - last)
        last, F = t, np.diag([a, 1, 1])
        P = (
            force((F - np.eye(3)) @ mesh.points.T) @ mesh.points / EDGE**3
        )  # the virial: sum f_a X_a = P V
        stress.append(np.linalg.solve(F, P))
    return np.array(stress)


def largest(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


def slope(sizes, errors):
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


@pytest.mark.parametrize("kind", ELEMENTS)
def test_stress_step_relaxes_as_prony_series(kind, reference):
    """After a stretch to 1.2 the stress is S_e G(t), exactly, for steps of a millisecond to
    minutes."""
    ref = reference("ref3_qlv_one_element")
    stress = confined_stress(ref["t"], np.full(61, ref["stretch"]), kind=kind)
    assert largest(stress[0], ref["S_elastic"]) < 1e-13
    assert largest(stress, ref["S_step"]) < 1e-13


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_ramp_and_hold(precision, reference):
    """A ramp of 1 s in 160 steps, held to 1000 s, follows the quadrature to 1e-6 (to rounding in
    float32)."""
    ref = reference("ref3_qlv_one_element")
    held = ref["ramp_t"] > 1.0001
    times = np.concatenate([np.linspace(0, 1, 161), ref["ramp_t"][held]])
    S11 = confined_stress(times, 1 + 0.2 * np.minimum(times, 1), precision=precision)[:, 0, 0]
    sample = np.concatenate([S11[:161:8], S11[161:]])
    assert largest(sample, ref["ramp_S11"]) < (1e-6 if precision == "float64" else 2e-6)


def test_cyclic_stretch_converges_in_second_order(reference):
    """A 1 Hz stretch of 5 % converges to the quadrature with the square of the step, to below
    1e-6."""
    ref = reference("ref3_qlv_one_element")
    steps, errors = np.array([1, 2, 4, 8, 16]), []
    for n in steps:
        times = np.linspace(0, 3, 60 * n + 1)
        stretch = 1 + ref["cyc_amp"] * np.sin(2 * np.pi * ref["cyc_f"] * times)
        errors.append(largest(confined_stress(times, stretch)[::n, 0, 0], ref["cyc_S11"]))
    assert errors[-1] < 1e-6
    assert slope(1 / steps, errors) == pytest.approx(2, abs=0.05)


def test_instantaneous_response_is_elastic():
    """Without time the tissue with Prony terms has the elastic force, at any displacement."""
    mesh = box((3, 2, 2), EDGE)
    u = 0.1 * EDGE * np.random.default_rng(0).uniform(-1, 1, (3, mesh.n_nodes))
    force = InternalForce(mesh, TISSUE)
    force.relax(0.0)
    assert largest(force(u), InternalForce(mesh, ELASTIC)(u)) < 1e-13


@pytest.mark.parametrize("kind", ELEMENTS)
def test_relaxed_stress_turns_with_the_tissue(kind):
    """A rotation after relaxation turns the forces and changes nothing else: the history is of S,
    not of P."""
    mesh = box((2, 2, 1), EDGE)
    u = 0.1 * EDGE * np.random.default_rng(0).uniform(-1, 1, (3, mesh.n_nodes))
    c, s = np.cos(1.0), np.sin(1.0)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    still, turned = InternalForce(mesh, TISSUE, kind), InternalForce(mesh, TISSUE, kind)
    for elapsed, Q in ((0.0, np.eye(3)), (5.0, R), (5.0, R @ R)):
        still.relax(elapsed)
        expected = Q @ still(u)
        turned.relax(elapsed)
        f = turned(Q @ (mesh.points.T + u) - mesh.points.T)
    assert largest(f, expected) < 1e-12


@pytest.mark.parametrize(
    "x", ["1e-15", "1e-9", "1e-6", "0.9e-4", "1.1e-4", "1e-2", "1", "30", "1e6", "1e9"]
)
def test_history_coefficients_are_exact_for_any_relaxation_time(x):
    """a = 1 - exp(-x) and new = 1/a - 1/x equal 60-digit arithmetic, from x = 1e-15 to 1e9."""
    getcontext().prec = 60
    exact = Decimal(float(x))
    a = 1 - (-exact).exp()
    ((got, old, new, forward),) = history_coefficients(((0.5, 1.0),), float(x), float(x))
    assert got == pytest.approx(float(a), rel=1e-15)
    assert new == pytest.approx(float(1 / a - 1 / exact), rel=1e-11)
    assert old + new == pytest.approx(1, rel=1e-15)
    assert forward == pytest.approx(float(1 - (-exact / 2).exp()), rel=1e-15)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_slow_terms_are_not_lost_in_small_steps(precision):
    """2000 steps of 0.1 ms relax a 330 s term as one step of 0.2 s: no rounding away, in float32
    either."""
    mesh, u = box((1, 1, 1), EDGE), np.zeros((3, 8))
    u[0] = 0.2 * np.arange(8) % 2 * EDGE
    small = InternalForce(mesh, TISSUE, "reduced", precision)
    large = InternalForce(mesh, TISSUE, "reduced")
    for force, steps in ((small, 2000), (large, 1)):
        force.relax(0.0)
        force(u)
        for _ in range(steps):
            force.relax(0.2 / steps)
            last = force(u)
        force.result = last
    assert largest(small.result, large.result) < (1e-10 if precision == "float64" else 1e-6)


def pushed(material, duration, **choices):
    """Displacement of a block's top under a small uniform push down, at `duration`."""
    mesh = box((2, 2, 2), EDGE, "bottom")
    solver = Solver(mesh, material, **choices)
    load = np.zeros((3, mesh.n_nodes))
    load[2, mesh.points[:, 2] == 2 * EDGE] = -1e-7
    ledger = EnergyLedger()
    solver.advance(duration, lambda t: load, [ledger])
    return solver.u, ledger


def test_relaxation_far_faster_than_a_step_leaves_the_soft_tissue():
    """A term of 1e-6 s acts as an elastic tissue with the moduli times 1 - g, over a whole
    vibration."""
    fast = dataclasses.replace(TISSUE, prony=((0.5, 1e-6),))
    soft = dataclasses.replace(ELASTIC, mu=200.0)
    step = 0.5 * Solver(box((2, 2, 2), EDGE, "bottom"), ELASTIC).critical_step
    results = []
    for material in (fast, soft):
        solver = Solver(box((2, 2, 2), EDGE, "bottom"), material)
        load = np.zeros_like(solver.u)
        load[2, solver.mesh.points[:, 2] == 2 * EDGE] = -1e-6
        solver.advance(100 * step, lambda t, load=load: load, steps=100)
        results.append(solver.u)
    assert largest(*results) < 0.01


def test_relaxation_far_slower_than_the_run_leaves_the_stiff_tissue():
    """A term of 1e6 s changes a run of 0.05 s by less than 1e-6."""
    slow = dataclasses.replace(TISSUE, prony=((0.5, 1e6),))
    assert largest(pushed(slow, 0.05)[0], pushed(ELASTIC, 0.05)[0]) < 1e-6


def test_held_force_creeps_by_the_creep_function():
    """A held small force creeps by D(t) = 12.5 - 3.2365 exp(-t/50.68) - 8.2635 exp(-t/895.3): 1.35
    times in 5 s."""
    slow_motion = {"mass_scaling": 100.0, "damping": 40.0}
    elastic, _ = pushed(ELASTIC, 1.0, **slow_motion)
    for t, creep in ((1.0, 1.07), (5.0, 1.35)):
        D = 12.5 - 3.2365 * np.exp(-t / 50.68) - 8.2635 * np.exp(-t / 895.3)
        assert D == pytest.approx(creep, abs=0.005)
        u, ledger = pushed(TISSUE, t, **slow_motion)
        assert np.linalg.norm(u) / np.linalg.norm(elastic) == pytest.approx(D, rel=2e-3)
        assert ledger.worst_imbalance() < 5e-3


def test_standing_still_is_second_order(monkeypatch):
    """Holding the viscous stress for 8 and 16 steps costs an error that grows with the square of
    that time."""
    material, mesh = (
        dataclasses.replace(TISSUE, prony=((0.6, 0.01),)),
        box((2, 2, 2), EDGE, "bottom"),
    )
    shape = np.zeros((3, mesh.n_nodes))
    shape[2, mesh.points[:, 2] == 2 * EDGE] = -2e-6
    steps, duration, runs = 640, 0.02, []
    for stride in (1, 8, 16):
        monkeypatch.setattr(
            "fem.solver.step_control.STANDSTILL", (stride + 0.5) * duration / steps / 0.01
        )
        solver = Solver(mesh, material)
        solver.advance(duration, lambda t: np.sin(50 * t) * shape, steps=steps)
        runs.append(solver.u)
    errors = [largest(u, runs[0]) for u in runs[1:]]
    assert slope([8, 16], errors) == pytest.approx(2, abs=0.3)


@pytest.mark.parametrize("tau", [1e-6, 1e-4, 1e-3, 1e-2, 1.0])
def test_relaxation_only_damps(tau):
    """At 0.98 of the critical step Prony terms of any relaxation time take energy from a random
    motion and add none."""
    solver = Solver(box((4, 4, 3), EDGE), dataclasses.replace(TISSUE, prony=((0.9, tau),)))
    solver.v[:] = np.where(
        solver.mesh.fixed, 0, np.random.default_rng(0).normal(scale=1e-9, size=solver.v.shape)
    )
    speed = np.linalg.norm(solver.v)
    solver.advance(500 * 0.98 * solver.critical_step, lambda t: np.zeros_like(solver.u), steps=500)
    assert np.linalg.norm(solver.v) < speed
