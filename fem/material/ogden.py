"""Compressible Ogden tissue."""

from dataclasses import dataclass, replace

import numpy as np

from fem.errors import InputError
from fem.material.base import (
    Hyperelastic,
    bulk_modulus,
    check_parameters,
    parameter,
    require,
)
from fem.material.kinematics import (
    IDENTITY,
    cofactor,
    determinant,
    pressure_tangent,
    where_upright,
)


@dataclass(frozen=True, eq=False)
class Ogden(Hyperelastic):
    """Tissue whose energy is a sum of powers of the principal stretches (Ogden 1972), compressible.

        W = sum_p m_p/a_p (l1^a_p + l2^a_p + l3^a_p - 3 - a_p ln J) + K/2 (J - 1)^2
        P = F g(C) + p cof F,   g(C) = sum_p m_p C^(a_p/2 - 1),   p = K (J - 1) - sum_p m_p/J
        A = d(F g(C))/dF + (K + sum_p m_p/J^2) cof F x cof F + p dcof F/dF
        mu = sum_p m_p a_p / 2,   K = 2 mu (1 + nu) / (3 (1 - 2 nu))

    terms: ((m Pa, a -), ...); nu: Poisson ratio, -; density: kg/m3; m, nu and density one value or
    one a cell; prony: ((g, tau s), ...), see Hyperelastic.

    The neo-Hookean law is a single term with a = 2. The stress is written with a function of the
    tensor C = F^T F, not with one stretch after the other, and its slope with quotients

        (c_a^b - c_b^b) / (c_a - c_b) = c_b^(b - 1) expm1(b log1p(x)) / x,   x = c_a/c_b - 1

    of the principal values c, which keep their digits as two stretches become equal and tend to b.

    >>> tissue = Ogden(terms=((40.0, 8.0), (-60.0, -4.0)), nu=0.42, density=1000.0)
    >>> tissue.mu
    280.0
    """

    terms: tuple[tuple[float | np.ndarray, float], ...]
    nu: float | np.ndarray
    density: float | np.ndarray
    prony: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        check_parameters(self)
        terms = tuple((parameter(m), float(a)) for m, a in self.terms)
        object.__setattr__(self, "terms", terms)
        if not terms:
            raise InputError("material.terms is empty; give pairs of modulus and exponent")
        for m, a in terms:
            if not (np.isfinite(m).all() and np.isfinite(a) and a != 0):
                raise InputError(
                    f"material.terms has (m, a) = ({m}, {a}); both must be finite and a not 0"
                )
        mu = self.mu
        require("terms: mu = sum m a / 2", mu, (0 < mu) & (mu < np.inf), "Pa must be positive")

    @property
    def mu(self) -> float | np.ndarray:
        """Shear modulus at rest, Pa."""
        return sum(m * a for m, a in self.terms) / 2

    @property
    def K(self) -> float | np.ndarray:
        """Bulk modulus of the energy, Pa."""
        return bulk_modulus(self.mu, self.nu)

    def energy(self, F: np.ndarray) -> np.ndarray:
        """W in J/m3 for deformation gradients (3, 3, ...); inf where J <= 0."""
        J = determinant(F, cofactor(F))
        c, _ = _principal(F)
        with np.errstate(divide="ignore", invalid="ignore"):
            ln_J = np.log(J)
            W = self.K / 2 * (J - 1) ** 2
            for m, a in self.terms:
                W = W + m / a * ((c ** (a / 2)).sum(axis=0) - 3 - a * ln_J)
        return where_upright(J, W)

    def stress(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """P in Pa for deformation gradients (3, 3, ...)."""
        cof = cofactor(F)
        J = determinant(F, cof)
        c, N = _principal(F)
        v = np.einsum("iJ...,Ja...->ia...", F, N)
        g = sum(m * c ** (a / 2 - 1) for m, a in self.terms)
        P = np.einsum("ia...,Ja...->iJ...", g * v, N)
        return np.add(P, self._pressure(J) * cof, out=out)

    def tangent(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """A = dP/dF in Pa for deformation gradients (3, 3, ...)."""
        cof = cofactor(F)
        J = determinant(F, cof)
        c, N = _principal(F)
        v = np.einsum("iJ...,Ja...->ia...", F, N)
        g = sum(m * c ** (a / 2 - 1) for m, a in self.terms)
        quotient = sum(m * _quotients(c, a / 2 - 1) for m, a in self.terms)  # (3, 3, ...)
        G = np.einsum("Ja...,La...->JL...", g * N, N)
        A = np.einsum("ik,JL...->iJkL...", IDENTITY, G)
        vN = np.einsum("ia...,Jb...->abiJ...", v, N)  # dC turns into N_a (F^T dF + dF^T F) N_b
        A = A + np.einsum("abiJ...,abkL...->iJkL...", quotient[:, :, None, None] * vN, vN)
        A += np.einsum("abiJ...,bakL...->iJkL...", quotient[:, :, None, None] * vN, vN)
        slope = self.K + sum(m for m, _ in self.terms) / J**2
        return np.add(A, pressure_tangent(F, cof, self._pressure(J), slope), out=out)

    def _pressure(self, J):
        return self.K * (J - 1) - sum(m for m, _ in self.terms) / J

    def scaled(self, factor: float) -> "Ogden":
        """The law whose energy and stresses are `factor` times these."""
        return replace(self, terms=tuple((factor * m, a) for m, a in self.terms))


def _principal(F):
    """Principal values c (3, ...) of C = F^T F and its axes N (3, 3, ...), N[:, a] for c[a]."""
    C = np.einsum("ki...,kj...->...ij", F, F)
    finite = np.isfinite(C).all(axis=(-1, -2))
    if not finite.all():  # a run that diverges is found by the solver, as NaN
        C = np.where(finite[..., None, None], C, IDENTITY)
    c, N = np.linalg.eigh(C)
    c = np.where(finite[..., None], c, np.nan)
    return np.moveaxis(c, -1, 0), np.moveaxis(N, (-2, -1), (0, 1))


def _quotients(c, b):
    """(c_a^b - c_b^b) / (c_a - c_b), (3, 3, ...), and b c^(b - 1) where both are equal."""
    x = (c[:, None] - c[None]) / c[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(x == 0, b, np.expm1(b * np.log1p(x)) / x)
    return c ** (b - 1) * ratio
