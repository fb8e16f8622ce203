"""Compressible Ogden tissue."""

from dataclasses import dataclass, replace

import numpy as np

from fem.errors import InputError
from fem.material.base import (
    DENSITY,
    NU,
    PRONY,
    TERM,
    Hyperelastic,
    bulk_modulus,
    check_parameters,
    pairs,
    require,
)
from fem.material.kinematics import (
    IDENTITY,
    cofactor,
    determinant,
    pressure_tangent,
    where_upright,
)
from fem.ranges import Range, number, numbers


@dataclass(frozen=True, eq=False)
class Ogden(Hyperelastic):
    """Tissue whose energy is a sum of powers of the principal stretches (Ogden 1972), compressible.

        W = sum_p m_p/a_p (l1^a_p + l2^a_p + l3^a_p - 3 - a_p ln J) + K/2 (J - 1)^2
        P = F g(C) + p cof F,   g(C) = sum_p m_p C^(a_p/2 - 1),   p = K (J - 1) - sum_p m_p/J
        A = d(F g(C))/dF + (K + sum_p m_p/J^2) cof F x cof F + p dcof F/dF
        mu = sum_p m_p a_p / 2,   K = 2 mu (1 + nu) / (3 (1 - 2 nu))

    terms: ((m Pa, a -), ...); nu: Poisson ratio, -; density: kg/m3; m, nu and density one value or
    one a cell; prony: ((g, tau s), ...), see Hyperelastic.

    The neo-Hookean law is a single term with a = 2. Equal stretches have no axes of their own, so
    that the stress takes none: it is Newton's interpolation of g in the matrix C = F^T F with the
    squared stretches c as nodes, and the tangent has quotients of them,

        g(C) = g(c1) I + g12 (C - c1 I) + g123 (C - c1 I)(C - c2 I)
        g_ab = (g(c_a) - g(c_b)) / (c_a - c_b),   g123 = (g23 - g12) / (c3 - c1)
        (c_a^b - c_b^b) / (c_a - c_b) = c_b^(b - 1) expm1(b log1p(x)) / x,   x = c_a/c_b - 1

    The last keeps its digits as two stretches become equal, and tends to b c^(b - 1).

    >>> tissue = Ogden(terms=((40.0, 8.0), (-60.0, -4.0)), nu=0.42, density=1000.0)
    >>> tissue.mu
    280.0
    >>> round(float(tissue.stress(np.diag([1.1, 1.0, 1.0]))[0, 0]), 1)
    224.5
    """

    terms: tuple[tuple[np.ndarray | float, float], ...] = numbers(Range(*TERM), Range(-100, 100))
    nu: np.ndarray | float = number(*NU)
    density: np.ndarray | float = number(*DENSITY)
    prony: tuple[tuple[float, float], ...] = numbers(*PRONY, default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", pairs("terms", self.terms))
        if not self.terms:
            raise InputError("material.terms is empty; give pairs of modulus and exponent")
        check_parameters(self)
        if any(a == 0 for _, a in self.terms):
            raise InputError("material.terms has an exponent a = 0; leave that pair out")
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
        c = _squared_stretches(np.einsum("ki...,kj...->ij...", F, F))
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
        C = np.einsum("ki...,kj...->ij...", F, F)
        c = _squared_stretches(C)
        g12, g23 = self._quotient(c[1], c[0]), self._quotient(c[1], c[2])
        gap = c[2] - c[0]
        g123 = np.divide(g23 - g12, gap, out=np.zeros_like(g12), where=gap > 0)
        first, second = C.copy(), C  # C - c1 I and C - c2 I
        for i in range(3):
            first[i, i] -= c[0]
            second[i, i] -= c[1]
        g = g12 * first + g123 * np.einsum("ij...,jk...->ik...", first, second)
        for i in range(3):
            g[i, i] += sum(m * c[0] ** (a / 2 - 1) for m, a in self.terms)
        return np.add(np.einsum("ij...,jk...->ik...", F, g), self._pressure(J) * cof, out=out)

    def tangent(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """A = dP/dF in Pa for deformation gradients (3, 3, ...)."""
        cof = cofactor(F)
        J = determinant(F, cof)
        slope = self.K + sum(m for m, _ in self.terms) / J**2
        A = pressure_tangent(F, cof, self._pressure(J), slope)
        c, N = _principal(F)
        v = np.einsum("iJ...,Ja...->ia...", F, N)
        g = sum(m * c ** (a / 2 - 1) for m, a in self.terms)
        A += np.einsum("ik,JL...->iJkL...", IDENTITY, np.einsum("Ja...,La...->JL...", g * N, N))
        # dC = F^T dF + dF^T F, and dg(C) = sum_ab g_ab N_a (N_a . dC N_b) N_b
        vN = np.einsum("ia...,Jb...->...abiJ", v, N)
        both = vN + vN.swapaxes(-4, -3)
        quotient = np.moveaxis(self._quotient(c[:, None], c[None]), (0, 1), (-2, -1))
        left, right = _as_matrices(quotient[..., None, None] * vN), _as_matrices(both)
        sum_ab = left.swapaxes(-1, -2) @ right  # (..., 9, 9)
        sum_ab = sum_ab.reshape(*sum_ab.shape[:-2], 3, 3, 3, 3)
        A += np.moveaxis(sum_ab, (-4, -3, -2, -1), (0, 1, 2, 3))
        return np.positive(A, out=out)

    def _quotient(self, c, d):
        """(g(c) - g(d)) / (c - d), and g'(c) where both are equal."""
        x = (c - d) / d
        equal = x == 0
        x = np.where(equal, 1.0, x)
        ln, total = np.log1p(x), 0.0
        for m, a in self.terms:
            b = a / 2 - 1
            total = total + m * d ** (b - 1) * np.where(equal, b, np.expm1(b * ln) / x)
        return total

    def _pressure(self, J):
        return self.K * (J - 1) - sum(m for m, _ in self.terms) / J

    def scaled(self, factor: float) -> "Ogden":
        """The law whose energy and stresses are `factor` times these."""
        return replace(self, terms=tuple((factor * m, a) for m, a in self.terms))


def _as_matrices(A):
    """A (..., 3, 3, 3, 3) as (..., 9, 9)."""
    return A.reshape(*A.shape[:-4], 9, 9)


def _squared_stretches(C):
    """The eigenvalues (3, ...) of C (3, 3, ...), from the smallest, by Cardano's formula.

    Near-equal ones are off by the root of float64's rounding, but such that the characteristic
    polynomial keeps its digits, and with it whatever is interpolated between them.
    """
    mean = (C[0, 0] + C[1, 1] + C[2, 2]) / 3
    B = C.copy()
    for i in range(3):
        B[i, i] -= mean
    size = np.sqrt(np.einsum("ij...,ij...->...", B, B) / 6)
    B /= np.where(size > 0, size, 1.0)
    angle = np.arccos(np.clip(determinant(B, cofactor(B)) / 2, -1, 1)) / 3
    low = mean + 2 * size * np.cos(angle + 2 * np.pi / 3)
    high = mean + 2 * size * np.cos(angle)
    return np.stack([low, np.clip(3 * mean - low - high, low, high), high])


def _principal(F):
    """The eigenvalues c (3, ...) of C = F^T F and its axes N (3, 3, ...), N[:, a] for c[a]."""
    C = np.einsum("ki...,kj...->...ij", F, F)
    finite = np.isfinite(C).all(axis=(-1, -2))
    if not finite.all():  # LAPACK would end the run; the solver names what went wrong
        C = np.where(finite[..., None, None], C, IDENTITY)
    c, N = np.linalg.eigh(C)
    c = np.where(finite[..., None], c, np.nan)
    return np.moveaxis(c, -1, 0), np.moveaxis(N, (-2, -1), (0, 1))
