"""Creep is the inverse of relaxation, and a filtered force is its convolution."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.creep import Creep, exponential_weights, remembered_force

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
