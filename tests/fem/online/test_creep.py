"""Creep is the inverse of relaxation, and a filtered force is its convolution."""

from dataclasses import replace

import numpy as np
import pytest

from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.online.creep import (
    MOST,
    RELAXED,
    Creep,
    CreepFilter,
    exponential_weights,
    relaxing,
    remembered_force,
    steps_within,
)
from fem.solver.explicit import Solver
from fem.solver.rest import equilibrium

PAPER = ((0.12, 330.0), (0.8, 11.0))


def relaxation(prony, t):
    return 1 - sum(g * -np.expm1(-t / tau) for g, tau in prony)


def test_the_papers_tissue_creeps_by_the_closed_form():
    """The roots of the relaxation polynomial of (0.12, 330 s), (0.8, 11 s), by hand."""
    assert np.allclose(Creep.of(PAPER).terms, [(3.2365, 50.68), (8.2635, 895.3)], rtol=1e-4)
    assert Creep.of(PAPER)(1e9) == pytest.approx(1 / 0.08)


@pytest.mark.parametrize("prony", [PAPER, ((0.5, 0.1),), ((0.3, 1e-3), (0.3, 1.0), (0.39, 1e3))])
def test_relaxation_of_creep_is_a_held_stress(prony):
    """The convolution of G with dD is one at every time: numerical inversion by trapezoids."""
    shortest = min(tau for _, tau in prony)
    t = np.linspace(0, 4 * shortest, 4001)
    D = Creep.of(prony)(t)
    middle = (t[1:] + t[:-1]) / 2
    stress = relaxation(prony, t[-1]) * D[0] + np.sum(
        relaxation(prony, t[-1] - middle) * np.diff(D)
    )
    assert stress == pytest.approx(1, abs=1e-6)


def test_one_term_retards_with_its_closed_form():
    g, tau = 0.7, 3.0
    ((weight, time),) = Creep.of(((g, tau),)).terms
    assert (weight, time) == pytest.approx((g / (1 - g), tau / (1 - g)))


def test_terms_of_equal_times_are_one_term():
    together, apart = Creep.of(((0.6, 2.0),)), Creep.of(((0.25, 2.0), (0.35, 2.0)))
    assert np.allclose(together.terms, apart.terms)


@pytest.mark.parametrize("prony", [PAPER, ((0.3, 1e-3), (0.3, 1.0), (0.39, 1e3))])
def test_long_held_it_has_relaxed_to_what_does_not_relax(prony):
    """The last of D is 1 / (1 - sum g), over six decades of times too."""
    left = 1 - sum(g for g, _ in prony)
    assert Creep.of(prony)(1e9) == pytest.approx(1 / left, rel=1e-9)


@pytest.mark.parametrize("prony", [PAPER, ((0.5, 30.0), (0.3, 30.0 + 1e-7), (0.1, 5.0))])
def test_volterras_equation_has_this_solution(prony):
    """The integral of G(t - s) dD(s) = 1 solved by the midpoint rule, step after step."""
    t = np.linspace(0, 60, 1201)
    D = np.ones_like(t)
    for n in range(1, len(t)):
        middle = relaxation(prony, t[n] - (t[1 : n + 1] + t[:n]) / 2)
        before = relaxation(prony, t[n]) * D[0] + middle[:-1] @ np.diff(D[:n])
        D[n] = D[n - 1] + (1 - before) / middle[-1]
    np.testing.assert_allclose(Creep.of(prony)(t), D, rtol=1e-5)


def test_a_weight_of_nearly_nothing_is_none():
    assert Creep.of(((0.0, 3.0),)).terms == ()
    assert Creep.of((*PAPER, (0.0, 7.0))) == Creep.of(PAPER)
    t = np.linspace(0, 1e3, 50)
    nearly = Creep.of((*PAPER, (1e-13, 7.0)))
    np.testing.assert_allclose(nearly(t), Creep.of(PAPER)(t), rtol=1e-10)
    np.testing.assert_allclose(Creep.of(((1e-15, 3.0),))(t), 1, rtol=1e-14)


@pytest.mark.parametrize(
    "prony",
    [
        ((0.3, 0.0),),
        ((0.3, -1.0),),
        ((0.3, np.inf),),
        ((0.3, np.nan),),
        ((-0.1, 1.0), (0.3, 2.0)),
        ((np.nan, 1.0),),
        ((np.inf, 1.0),),
        ((0.3, 1.0, 2.0),),
        "ab",
        0.3,
    ],
)
def test_series_of_no_tissue_are_refused(prony):
    with pytest.raises(InputError, match="give g of at least 0 and tau > 0|prony = .* must be"):
        Creep.of(prony)


def test_tissue_that_flows_is_refused_and_elastic_tissue_does_not_creep():
    with pytest.raises(InputError, match="add up to 1"):
        Creep.of(((0.4, 1.0), (0.6, 2.0)))
    assert Creep.of(())(np.array([0.0, 5.0])).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("x", [1e-9, 9e-5, 1.1e-4, 0.3, 50.0])
def test_exponential_weights_are_exact_for_a_ramp(x):
    """r' = (t - r) / tau from rest is t - tau (1 - exp(-t / tau))."""
    a, old, new = exponential_weights(x, 1.0)
    exact = x - -np.expm1(-x) if x > 1e-3 else x**2 / 2 - x**3 / 6
    assert a * new * x == pytest.approx(exact, rel=1e-6)
    assert old + new == pytest.approx(1)


def test_a_ramped_force_is_remembered_exactly_at_any_interval():
    """f = t: f~ = t + sum j (t - l (1 - exp(-t / l)))."""
    creep = Creep.of(PAPER)
    for interval in (0.25, 5.0):
        t = np.arange(9) * interval
        exact = t + sum(j * (t - time * -np.expm1(-t / time)) for j, time in creep.terms)
        assert np.allclose(remembered_force(creep, t[:, None], interval)[:, 0], exact)


def piecewise(creep, t, f, at):
    """The integral of D(at - s) df(s) for f linear between its values at t, in closed form."""

    def integral(x):  # of D from 0 to x
        return x + sum(j * (x + time * np.expm1(-x / time)) for j, time in creep.terms)

    return sum(
        (f1 - f0) / (t1 - t0) * (integral(at - t0) - integral(at - t1))
        for t0, t1, f0, f1 in zip(t[:-1], t[1:], f[:-1], f[1:], strict=True)
        if t1 <= at
    )


@pytest.mark.parametrize("prony", [PAPER, ((0.3, 1e-3), (0.3, 1.0), (0.39, 1e3))])
def test_the_filter_is_exact_whatever_the_intervals(prony):
    rng = np.random.default_rng(0)
    dt = 10 ** rng.uniform(-2, 1, 40)
    t = np.concatenate([[0.0], np.cumsum(dt)])
    f = np.concatenate([np.zeros((1, 2, 3)), rng.normal(size=(40, 2, 3))])
    creep = Creep.of(prony)
    memory = CreepFilter(creep, (2, 3))
    found = np.array([memory.step(now, elapsed) for now, elapsed in zip(f[1:], dt, strict=True)])
    exact = np.array([piecewise(creep, t, f, at) for at in t[1:]])
    np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9)


def test_a_step_may_be_divided_where_the_force_is_linear():
    creep = Creep.of(PAPER)
    whole, parts = CreepFilter(creep, (3,)), CreepFilter(creep, (3,))
    force = np.array([1.0, -2.0, 0.5])
    expected = whole.step(force, 1.0)
    for n in range(1, 11):
        found = parts.step(n / 10 * force, 0.1)
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_the_filters_state_resets_and_is_restored():
    memory = CreepFilter(Creep.of(PAPER), (4, 3))
    forces = np.random.default_rng(1).normal(size=(3, 4, 3)).astype("float32")
    first = memory.step(forces[0], 0.25)
    assert first.dtype == float and first.shape == (4, 3)
    kept = memory.state()
    after = memory.step(forces[1], 0.25)
    again = CreepFilter(Creep.of(PAPER), (4, 3))
    again.restore(kept)
    np.testing.assert_array_equal(again.step(forces[1], 0.25), after)
    memory.reset()
    np.testing.assert_array_equal(memory.step(forces[0], 0.25), first)
    for wrong in ({}, {"remembered": kept["remembered"][1:]}, {"remembered": np.nan * after}):
        with pytest.raises(InputError, match="the state holds"):
            again.restore(wrong)


def test_what_the_filter_refuses_leaves_it_as_it_was():
    memory = CreepFilter(Creep.of(PAPER), (3,))
    memory.step(np.ones(3), 0.1)
    before = memory.state()["remembered"]
    for force, dt in (
        (np.ones(4), 0.1),
        (np.ones(3, bool), 0.1),
        (np.array([1, np.nan, 1]), 0.1),
        (np.array([1, np.inf, 1]), 0.1),
        (np.ones(3), 0.0),
        (np.ones(3), -0.1),
        (np.ones(3), np.nan),
        (np.ones(3), np.inf),
    ):
        with pytest.raises(InputError, match="give|must be"):
            memory.step(force, dt)
    np.testing.assert_array_equal(memory.state()["remembered"], before)


def test_elastic_tissue_keeps_nothing():
    memory = CreepFilter(Creep.of(()), (2, 3))
    force = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(memory.step(force, 0.1), force)
    assert memory.state() == {}
    memory.restore({})


@pytest.mark.parametrize("element", ["full", "reduced"])
def test_the_solver_creeps_under_a_held_force(element):
    """A small force on a block of tissue moves it by D(t) times the elastic answer."""
    prony = ((0.3, 0.1), (0.4, 0.6))
    elastic = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
    mesh = box((2, 2, 2), 2e-3)
    load = np.zeros((mesh.n_nodes, 3))
    load[np.unique(mesh.contact_faces), 2] = -1e-8  # N: strains of some 1e-5
    rest = equilibrium(mesh, elastic, load, element=element).displacement
    solver = Solver(mesh, replace(elastic, prony=prony), element, damping=30.0)
    ratios, times = [], np.array([0.25, 0.5, 1.0, 2.0])
    for t in times:
        solver.advance(t - solver.time, lambda _: load.T)
        ratios.append(np.vdot(solver.u.T, rest) / np.vdot(rest, rest))
    np.testing.assert_allclose(ratios, Creep.of(prony)(times), rtol=5e-3)


@pytest.mark.parametrize("prony", [(), ((0.12, 330.0), (0.8, 11.0)), ((0.5, 1.0),)])
def test_a_frame_takes_as_many_steps_as_relax_little_each(prony):
    for dt in (0.01, 0.25, 2.5, 25.0, 250.0):
        count = steps_within(prony, dt)
        assert relaxing(prony, dt / count) <= RELAXED
        assert count == 1 or relaxing(prony, dt / (count - 1)) > RELAXED
    assert steps_within(prony, 0.1) == 1
    assert steps_within(((0.9, 1e-3),), 100.0) == MOST


def test_a_filter_tells_the_last_force():
    memory = CreepFilter(Creep.of(((0.5, 1.0),)), (2,))
    memory.step(np.array([1.0, 2.0]), 0.1)
    memory.step(np.array([3.0, 4.0]), 0.1)
    np.testing.assert_array_equal(memory.last, [3, 4])
