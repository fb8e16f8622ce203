"""Compressible neo-Hookean tissue."""

from dataclasses import dataclass, replace

import numpy as np

from fem.material.base import (
    DENSITY,
    MODULUS,
    NU,
    PRONY,
    Hyperelastic,
    bulk_modulus,
    check_parameters,
)
from fem.material.kinematics import (
    add_to_diagonal,
    cofactor,
    determinant,
    pressure_tangent,
    where_upright,
)
from fem.ranges import number, numbers


@dataclass(frozen=True, eq=False)
class NeoHooke(Hyperelastic):
    """Tissue of arXiv 2301.04614.

        W = mu/2 (I1 - 3 - 2 ln J) + K/2 (J - 1)^2
        P = mu F + p cof F,   p = K (J - 1) - mu/J
        A = mu d_ik d_JL + (K + mu/J^2) cof F x cof F + p dcof F/dF
        K = 2 mu (1 + nu) / (3 (1 - 2 nu))

    mu: shear modulus, Pa; nu: Poisson ratio, -; density: kg/m3; each one value or one a cell;
    prony: ((g, tau s), ...), see Hyperelastic.

    In this W the modulus K takes the place of the Lame lambda: the effective small-strain Poisson
    ratio is K / (2 (K + mu)) (0.4277 for nu = 0.42), and dilatational waves run at sqrt((K + 2 mu)
    / density).

    The solver has a kernel of its own for this law, and none for a class that derives from it.

    >>> tissue = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
    >>> round(float(tissue.stress(np.diag([1.1, 1.0, 1.0]))[0, 0]), 1)
    313.0
    """

    mu: np.ndarray | float = number(*MODULUS)
    nu: np.ndarray | float = number(*NU)
    density: np.ndarray | float = number(*DENSITY)
    prony: tuple[tuple[float, float], ...] = numbers(*PRONY, default=())

    def __post_init__(self) -> None:
        check_parameters(self, "mu")

    @property
    def K(self) -> float | np.ndarray:
        """Bulk modulus of the energy, Pa."""
        return bulk_modulus(self.mu, self.nu)

    def energy(self, F: np.ndarray) -> np.ndarray:
        """W in J/m3 for deformation gradients (3, 3, ...); inf where J <= 0."""
        J = determinant(F, cofactor(F))
        I1 = np.einsum("ij...,ij...->...", F, F)
        with np.errstate(divide="ignore", invalid="ignore"):
            W = self.mu / 2 * (I1 - 3 - 2 * np.log(J)) + self.K / 2 * (J - 1) ** 2
        return where_upright(J, W)

    def stress(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """P in Pa for deformation gradients (3, 3, ...)."""
        cof = cofactor(F)
        J = determinant(F, cof)
        return np.add(self.mu * F, (self.K * (J - 1) - self.mu / J) * cof, out=out)

    def tangent(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """A = dP/dF in Pa for deformation gradients (3, 3, ...)."""
        cof = cofactor(F)
        J = determinant(F, cof)
        p, slope = self.K * (J - 1) - self.mu / J, self.K + self.mu / J**2
        return np.positive(add_to_diagonal(pressure_tangent(F, cof, p, slope), self.mu), out=out)

    def scaled(self, factor: float) -> "NeoHooke":
        """The law whose energy and stresses are `factor` times these."""
        return replace(self, mu=factor * self.mu)
