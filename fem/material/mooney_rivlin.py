"""Compressible Mooney-Rivlin tissue."""

from dataclasses import dataclass, replace

import numpy as np

from fem.material.base import (
    DENSITY,
    NU,
    PRONY,
    TERM,
    Hyperelastic,
    bulk_modulus,
    check_parameters,
    require,
)
from fem.material.kinematics import (
    IDENTITY,
    add_to_diagonal,
    cofactor,
    determinant,
    pressure_tangent,
    where_upright,
)
from fem.ranges import number, numbers


@dataclass(frozen=True, eq=False)
class MooneyRivlin(Hyperelastic):
    """Tissue that also resists the stretching of surfaces (Mooney 1940, Rivlin 1948), compressible.

        W = c10 (I1 - 3 - 2 ln J) + c01 (I2 - 3 - 4 ln J) + K/2 (J - 1)^2
        P = 2 c10 F + 2 c01 (I1 F - F C) + p cof F,   p = K (J - 1) - (2 c10 + 4 c01)/J
        A = 2 c10 d_ik d_JL + 2 c01 (2 F_iJ F_kL + I1 d_ik d_JL - d_ik C_JL - F_iL F_kJ - B_ik d_JL)
            + (K + (2 c10 + 4 c01)/J^2) cof F x cof F + p dcof F/dF
        I1 = tr C,   I2 = (I1^2 - tr C^2) / 2,   C = F^T F,   B = F F^T
        mu = 2 (c10 + c01),   K = 2 mu (1 + nu) / (3 (1 - 2 nu))

    c10, c01: Pa; nu: Poisson ratio, -; density: kg/m3; each one value or one a cell; prony: ((g,
    tau s), ...), see Hyperelastic.

    The neo-Hookean law is c01 = 0. The term in c01 adds 4 c01 to the Lame lambda of small strains,
    so that dilatational waves run at sqrt((K + 4 c01 + 2 mu) / density).

    >>> tissue = MooneyRivlin(c10=150.0, c01=50.0, nu=0.42, density=1000.0)
    >>> round(float(tissue.stress(np.diag([1.1, 1.0, 1.0]))[0, 0]), 1)
    332.1
    """

    c10: np.ndarray | float = number(*TERM)
    c01: np.ndarray | float = number(*TERM)
    nu: np.ndarray | float = number(*NU)
    density: np.ndarray | float = number(*DENSITY)
    prony: tuple[tuple[float, float], ...] = numbers(*PRONY, default=())

    def __post_init__(self) -> None:
        check_parameters(self, "c10", "c01")
        mu = self.mu
        require("c10 + c01", mu / 2, (0 < mu) & (mu < np.inf), "Pa must be positive")

    @property
    def mu(self) -> float | np.ndarray:
        """Shear modulus at rest, Pa."""
        return 2 * (self.c10 + self.c01)

    @property
    def K(self) -> float | np.ndarray:
        """Bulk modulus of the energy, Pa."""
        return bulk_modulus(self.mu, self.nu)

    def energy(self, F: np.ndarray) -> np.ndarray:
        """W in J/m3 for deformation gradients (3, 3, ...); inf where J <= 0."""
        cof = cofactor(F)
        J = determinant(F, cof)
        I1 = np.einsum("ij...,ij...->...", F, F)
        I2 = np.einsum("ij...,ij...->...", cof, cof)
        with np.errstate(divide="ignore", invalid="ignore"):
            ln_J = np.log(J)
            W = self.c10 * (I1 - 3 - 2 * ln_J) + self.c01 * (I2 - 3 - 4 * ln_J)
            W = W + self.K / 2 * (J - 1) ** 2
        return where_upright(J, W)

    def stress(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """P in Pa for deformation gradients (3, 3, ...)."""
        cof = cofactor(F)
        J = determinant(F, cof)
        I1 = np.einsum("ij...,ij...->...", F, F)
        C = np.einsum("ki...,kj...->ij...", F, F)
        FC = np.einsum("ik...,kj...->ij...", F, C)
        P = (2 * self.c10 + 2 * self.c01 * I1) * F - 2 * self.c01 * FC
        return np.add(P, self._pressure(J) * cof, out=out)

    def tangent(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """A = dP/dF in Pa for deformation gradients (3, 3, ...)."""
        cof = cofactor(F)
        J = determinant(F, cof)
        I1 = np.einsum("ij...,ij...->...", F, F)
        C = np.einsum("ki...,kj...->ij...", F, F)
        B = np.einsum("ik...,jk...->ij...", F, F)
        second = add_to_diagonal(2 * np.einsum("iJ...,kL...->iJkL...", F, F), I1)
        second -= np.einsum("ik,JL...->iJkL...", IDENTITY, C)
        second -= np.einsum("iL...,kJ...->iJkL...", F, F)
        second -= np.einsum("ik...,JL->iJkL...", B, IDENTITY)
        slope = self.K + (2 * self.c10 + 4 * self.c01) / J**2
        A = 2 * self.c01 * second + pressure_tangent(F, cof, self._pressure(J), slope)
        return np.positive(add_to_diagonal(A, 2 * self.c10), out=out)

    def _pressure(self, J):
        return self.K * (J - 1) - (2 * self.c10 + 4 * self.c01) / J

    def scaled(self, factor: float) -> "MooneyRivlin":
        """The law whose energy and stresses are `factor` times these."""
        return replace(self, c10=factor * self.c10, c01=factor * self.c01)
