"""Every law: closed forms, small strains, differences of energy and stress, special cases."""

import dataclasses
import doctest
import importlib
import pickle

import numpy as np
import pytest

from fem.errors import InputError
from fem.material import MooneyRivlin, NeoHooke, Ogden
from fem.material.base import (
    Hyperelastic,
    effective_poisson_ratio,
    poisson_ratio,
    shear_modulus,
    volumetric_modulus,
    wave_modulus,
)
from fem.material.check import check_law, slope

NEO = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
MOONEY = MooneyRivlin(c10=150.0, c01=50.0, nu=0.42, density=1000.0)
OGDEN = Ogden(terms=((40.0, 8.0), (-60.0, -4.0)), nu=0.42, density=1000.0)
LAWS = {"neo_hooke": NEO, "mooney_rivlin": MOONEY, "ogden": OGDEN}
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def states(shape=(4, 5), size=0.15, seed=0):
    """Random deformation gradients (3, 3, *shape)."""
    unit = np.eye(3).reshape(3, 3, *[1] * len(shape))
    return unit + np.random.default_rng(seed).normal(scale=size, size=(3, 3, *shape))


def rotation(seed=0):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def assert_close(actual, expected, tolerance):
    """Largest difference relative to the largest expected value."""
    assert np.abs(actual - expected).max() <= tolerance * np.abs(expected).max()


def stretched(law, l1, l2, l3):
    """The principal stresses dW/dl of the closed forms, each law written out in stretches."""
    stretches, J = np.array([l1, l2, l3]), l1 * l2 * l3
    P = law.K * (J - 1) * J / stretches
    if law is MOONEY:
        others = (stretches**2).sum() - stretches**2  # dI2/dl = 2 l (I1 - l^2)
        P += 2 * law.c10 * (stretches - 1 / stretches)
        P += law.c01 * (2 * stretches * others - 4 / stretches)
    else:
        for m, a in law.terms if law is OGDEN else ((law.mu, 2.0),):
            P += m * (stretches ** (a - 1) - 1 / stretches)
    return P


@every_law
@pytest.mark.parametrize("l1", [0.6, 0.9, 1.001, 1.2, 1.8])
def test_uniaxial_stress_equals_the_closed_form(law, l1):
    """A bar stretched to l1 with free sides: dW/dl, at the lateral stretch at which it vanishes."""
    low, high = 0.3, 3.0
    for _ in range(100):  # bisection
        middle = (low + high) / 2
        low, high = (middle, high) if stretched(law, l1, middle, middle)[1] < 0 else (low, middle)
    P = law.stress(np.diag([l1, middle, middle]))
    assert_close(P, np.diag(stretched(law, l1, middle, middle)), 1e-11)
    assert abs(P[1, 1]) < 1e-11 * wave_modulus(law)


@every_law
@pytest.mark.parametrize("gamma", [0.01, 0.3, 1.0])
def test_simple_shear_stress_equals_the_closed_form(law, gamma):
    """P_12 = dW/dgamma with the stretches l, 1/l, 1 of simple shear, l - 1/l = gamma."""
    F = np.eye(3)
    F[0, 1] = gamma
    stretch = gamma / 2 + np.sqrt(1 + gamma**2 / 4)
    force = stretched(law, stretch, 1 / stretch, 1.0)
    # dW/dgamma = (dW/dl1 - dW/dl2 / l^2) dl/dgamma, with dgamma/dl = 1 + 1/l^2
    expected = (force[0] - force[1] / stretch**2) / (1 + 1 / stretch**2)
    assert law.stress(F)[0, 1] == pytest.approx(expected, rel=1e-10)


@every_law
def test_principal_stresses_in_three_directions(law):
    """P = R diag(dW/dl) for F = R diag(l): different stretches, turned."""
    R, stretches = rotation(), (0.8, 1.1, 1.4)
    expected = R @ np.diag(stretched(law, *stretches))
    assert_close(law.stress(R @ np.diag(stretches)), expected, 1e-12)


@every_law
def test_stress_is_the_gradient_of_the_energy(law):
    """P = dW/dF by central differences."""
    F = states()
    assert_close(law.stress(F), slope(law.energy, F), 1e-8)


@every_law
def test_tangent_is_the_gradient_of_the_stress(law):
    """A = dP/dF by central differences, and A_iJkL = A_kLiJ."""
    F = states()
    A = law.tangent(F)
    assert_close(A, Hyperelastic.tangent(law, F), 1e-8)
    assert_close(A, A.transpose(2, 3, 0, 1, 4, 5), 1e-14)


@every_law
@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
def test_equal_principal_stretches(law, gap):
    """Two and three stretches that are equal, or nearly, leave stress and tangent exact."""
    R = rotation(1)
    for base in ((1.3, 1.3, 0.8), (1.0, 1.0, 1.0), (1.2, 1.2, 1.2)):
        U = np.diag(np.array(base) * (1 + gap * np.array([1, -1, 0.3])))
        F = rotation(2) @ R @ U @ R.T
        expected = Hyperelastic.tangent(law, F)
        assert_close(law.tangent(F), expected, 1e-8)
        P = rotation(2) @ R @ np.diag(stretched(law, *np.diag(U))) @ R.T
        assert np.abs(law.stress(F) - P).max() < 1e-12 * wave_modulus(law)


@every_law
def test_stress_turns_with_the_tissue(law):
    """W(R F) = W(F) and P(R F) = R P(F); a rotation alone leaves no stress."""
    F, R = states(), rotation()
    turned = np.einsum("ij,jk...->ik...", R, F)
    assert_close(law.energy(turned), law.energy(F), 1e-12)
    assert_close(law.stress(turned), np.einsum("ij,jk...->ik...", R, law.stress(F)), 1e-12)
    assert np.abs(law.stress(R)).max() < 1e-12 * wave_modulus(law)


@every_law
def test_small_strain_limits(law):
    """Shear and wave modulus at rest are the slopes of a strain of 1e-6, and mu is the law's."""
    e = 1e-6
    P = law.stress(np.eye(3) + e * np.array([[1, 0.5, 0], [0, 0, 0], [0, 0, 0]]))
    assert P[0, 0] / e == pytest.approx(wave_modulus(law), rel=1e-4)
    assert P[0, 1] / e == pytest.approx(0.5 * shear_modulus(law), rel=1e-4)
    assert shear_modulus(law) == pytest.approx(law.mu, rel=1e-14)
    lame = P[1, 1] / e
    assert effective_poisson_ratio(law) == pytest.approx(lame / (2 * (lame + law.mu)), rel=1e-4)
    assert poisson_ratio(law) == 0.42


@every_law
def test_energy_is_infinite_where_the_tissue_is_inverted(law):
    """W is zero at rest, positive elsewhere and infinite for J <= 0."""
    assert abs(law.energy(np.eye(3))) < 1e-13 * law.mu
    assert law.energy(np.diag([1.1, 1, 1])) > 0
    for J in (-1.0, 0.0):
        assert np.isinf(law.energy(np.diag([J, 1, 1])))


def test_special_cases_are_the_neo_hookean_law():
    """Mooney-Rivlin with c01 = 0 and Ogden with one exponent of 2 have its energy, stress and
    tangent."""
    F = states()
    for law in (
        MooneyRivlin(200.0, 0.0, 0.42, 1000.0),
        Ogden(((400.0, 2.0),), 0.42, 1000.0),
        Ogden(((100.0, 2.0), (300.0, 2.0)), 0.42, 1000.0),
    ):
        for method in ("energy", "stress", "tangent"):
            assert_close(getattr(law, method)(F), getattr(NEO, method)(F), 1e-13)


@pytest.mark.parametrize("module", LAWS)
def test_examples_of_the_docstrings(module):
    """What the docstring of a law shows is what it gives."""
    result = doctest.testmod(importlib.import_module(f"fem.material.{module}"))
    assert result.attempted >= 2 and result.failed == 0


@every_law
def test_out_is_filled(law):
    """stress and tangent write into `out`, and return it."""
    F = states()
    for method, shape in (("stress", F.shape), ("tangent", (3, 3, *F.shape))):
        out = np.empty(shape)
        assert getattr(law, method)(F, out=out) is out
        assert np.array_equal(out, getattr(law, method)(F))
    numeric = np.empty((3, 3, *F.shape))
    assert Hyperelastic.tangent(law, F, out=numeric) is numeric


@every_law
def test_scaled_and_elastic_twins(law):
    """`scaled` multiplies energy, stress and tangent, `elastic` drops the Prony terms, and both are
    of the same class."""
    viscous = dataclasses.replace(law, prony=((0.5, 1.0),))
    twin = viscous.scaled(0.25)
    F = states()
    for method in ("energy", "stress", "tangent"):
        assert_close(getattr(twin, method)(F), 0.25 * getattr(law, method)(F), 1e-13)
    assert type(twin) is type(law) and twin.prony == viscous.prony
    assert viscous.elastic() == law and viscous != law and hash(viscous.elastic()) == hash(law)


@every_law
def test_one_value_a_cell(law):
    """Parameters with one value a cell give each cell the answer of its own uniform law."""
    half = law.scaled(0.5)
    fields = [f.name for f in dataclasses.fields(law) if f.name not in ("terms", "prony")]
    values = {name: [getattr(law, name), getattr(half, name)] for name in fields}
    if law is OGDEN:
        values["terms"] = tuple(
            (np.array([m, h]), a) for (m, a), (h, _) in zip(law.terms, half.terms, strict=True)
        )
    both = type(law)(**values)
    F = states((4, 2))
    for method in ("energy", "stress", "tangent"):
        got = getattr(both, method)(F)
        for cell, uniform in enumerate((law, half)):
            assert_close(got[..., cell], getattr(uniform, method)(F)[..., cell], 1e-14)
    assert shear_modulus(both) == pytest.approx([law.mu, half.mu])
    assert both.of_cells(slice(1, 2), 2).mu == pytest.approx([half.mu])
    assert both == pickle.loads(pickle.dumps(both)) and both != law
    with pytest.raises(InputError, match=r"has shape \(2,\); give one value, .* 3 cells"):
        both.of_cells(slice(0, 2), 3)


@pytest.mark.parametrize(
    "make, named",
    [
        (lambda: MooneyRivlin(100.0, -100.0, 0.42, 1000.0), r"c10 \+ c01 = 0.0"),
        (lambda: MooneyRivlin(100.0, 0.0, 0.5, 1000.0), "nu = 0.5"),
        (lambda: Ogden((), 0.42, 1000.0), "terms is empty"),
        (lambda: Ogden(((400.0, 0.0),), 0.42, 1000.0), "exponent a = 0"),
        (lambda: Ogden(((400.0, -2.0),), 0.42, 1000.0), "mu = sum m a / 2 = -400.0"),
        (lambda: Ogden(((400.0, 2.0),), 0.42, -1.0), "density = -1.0"),
    ],
)
def test_impossible_parameters_are_refused(make, named):
    """A value outside its range is an InputError that names it."""
    with pytest.raises(InputError, match=named):
        make()


class Blatz(Hyperelastic):
    """Blatz-Ko rubber of another's own, W = m/2 (I1 - 3 + 2 (1/J - 1)), with nothing but energy and
    stress."""

    density = 1000.0

    def __init__(self, m=400.0, energy=1.0):
        self.m, self.factor = m, energy

    def energy(self, F):
        I1 = np.einsum("ij...,ij...->...", F, F)
        return self.factor * self.m / 2 * (I1 - 3 + 2 * (1 / self.J(F) - 1))

    def stress(self, F):
        inverse = np.linalg.inv(np.moveaxis(F, (0, 1), (-2, -1)))
        return self.m * (F - np.moveaxis(inverse, (-1, -2), (0, 1)) / self.J(F))

    def J(self, F):
        return np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1)))


def test_what_follows_from_a_law_of_ones_own():
    """With energy and stress alone, tangent, moduli at rest and twins are derived."""
    law = Blatz()
    check_law(law, 4)
    assert shear_modulus(law) == pytest.approx(400, rel=1e-8)
    assert wave_modulus(law) == pytest.approx(1200, rel=1e-8)  # lambda = mu: nu = 1/4
    assert poisson_ratio(law) == pytest.approx(0.25, rel=1e-8)
    twin = law.scaled(3.0)
    check_law(twin, 4)
    assert shear_modulus(twin) == pytest.approx(1200, rel=1e-8) and law.elastic().prony == ()


def test_a_new_stress_leaves_nothing_of_the_old_law():
    """A class that overrides energy and stress does not inherit the tangent, the scaling or K of
    the law that it derives from."""

    class Hard(NeoHooke):
        def energy(self, F):
            return 100 * super().energy(F)

        def stress(self, F, out=None):
            return np.multiply(100, super().stress(F), out=out)

    hard = Hard(400.0, 0.42, 1000.0)
    check_law(hard, 1)
    assert shear_modulus(hard) == pytest.approx(40_000, rel=1e-8)
    assert shear_modulus(hard.scaled(0.5)) == pytest.approx(20_000, rel=1e-8)
    assert volumetric_modulus(hard) is None and hard.elastic() == hard
    assert volumetric_modulus(NEO.scaled(0.5)) == 0.5 * NEO.K


class Wrong(NeoHooke):
    def stress(self, F, out=None):
        return np.multiply(100, super().stress(F), out=out)


class Loaded(NeoHooke):
    def energy(self, F):
        return super().energy(F) + 100 * (F[0, 0] - 1)

    def stress(self, F, out=None):
        P = super().stress(F, out)
        P[0, 0] += 100
        return P


class Fixed(NeoHooke):
    """A spring from each point to its place in space: not objective."""

    def energy(self, F):
        H = F - np.eye(3).reshape(3, 3, *[1] * (F.ndim - 2))
        return np.einsum("ij...,ij...->...", H, H)

    def stress(self, F, out=None):
        return 2 * (F - np.eye(3).reshape(3, 3, *[1] * (F.ndim - 2)))


class Stale(NeoHooke):
    def tangent(self, F, out=None):
        return 2 * super().tangent(F, out)


class Matrices(NeoHooke):
    """The other layout, (..., 3, 3)."""

    def energy(self, F):
        return np.linalg.det(F) - 1

    def stress(self, F, out=None):
        return np.linalg.det(F)[..., None, None] * np.linalg.inv(F)


class Half(Hyperelastic):
    density = 1000.0

    def energy(self, F):
        return NEO.energy(F)


@pytest.mark.parametrize(
    "make, message",
    [
        (Wrong, "Wrong: stress is not the derivative of energy; .* differ by up to"),
        (Loaded, "Loaded: stress must vanish at rest"),
        (Fixed, "Fixed: energy changes with a rotation"),
        (Stale, "Stale: tangent is not the derivative of stress"),
        (Matrices, "Matrices: energy.F. fails for F of shape"),
    ],
)
def test_inconsistent_laws_are_refused(make, message):
    """The error says what does not fit together."""
    with pytest.raises(InputError, match=message):
        check_law(make(400.0, 0.42, 1000.0), 8)


def test_incomplete_laws_are_refused():
    """What is missing is named: a method, the density, the base class."""

    class Weightless(Blatz):
        density = property()

    with pytest.raises(InputError, match=r"Half has no stress\(F\)"):
        check_law(Half(), 8)
    with pytest.raises(InputError, match="Weightless has no density"):
        check_law(Weightless(), 8)
    with pytest.raises(InputError, match="SimpleLaw must derive from fem.material.Hyperelastic"):
        check_law(type("SimpleLaw", (), {})(), 8)
