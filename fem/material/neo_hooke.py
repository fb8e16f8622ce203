"""Compressible neo-Hookean tissue with quasi-linear viscoelasticity."""

from dataclasses import dataclass

import numpy as np

from fem.errors import InputError


@dataclass(frozen=True)
class Material:
    """Tissue of arXiv 2301.04614.

        W = mu/2 (I1 - 3 - 2 ln J) + K/2 (J - 1)^2,   P = dW/dF = mu F + (K (J - 1) - mu/J) cof F
        K = 2 mu (1 + nu) / (3 (1 - 2 nu))
        S(t) = int G(t - s) dS_e(s),   G(t) = 1 - sum g_k + sum g_k exp(-t / tau_k)

    mu: shear modulus, Pa; nu: Poisson ratio, -; density: kg/m3; prony: ((g, tau s), ...), empty for
    elastic.

    In this W the modulus K takes the place of the Lame lambda: the effective small-strain Poisson
    ratio is K / (2 (K + mu)) (0.4277 for nu = 0.42), and dilatational waves run at sqrt((K + 2 mu)
    / density).
    """

    mu: float
    nu: float
    density: float
    prony: tuple[tuple[float, float], ...] = ()

    def __post_init__(self):
        if not 0 < self.mu < np.inf:
            raise InputError(f"material.mu = {self.mu} Pa must be positive")
        if not 0 <= self.nu < 0.5:
            raise InputError(
                f"material.nu = {self.nu} must be at least 0 and below 0.5; for nearly incompressible tissue take 0.499"
            )
        if not 0 < self.density < np.inf:
            raise InputError(
                f"material.density = {self.density} kg/m3 must be positive; water has 1000"
            )
        for g, tau in self.prony:
            if not (0 < g < np.inf and 0 < tau < np.inf):
                raise InputError(
                    f"material.prony has (g, tau) = ({g}, {tau}); both must be positive (leave the pair out to switch it off)"
                )
        if sum(g for g, _ in self.prony) >= 1:
            raise InputError(
                f"material.prony weights add up to {sum(g for g, _ in self.prony):g}; below 1 the tissue stays a solid"
            )

    @property
    def K(self):
        """Bulk modulus of the energy, Pa."""
        return 2 * self.mu * (1 + self.nu) / (3 * (1 - 2 * self.nu))

    @property
    def p_modulus(self):
        """K + 2 mu, Pa: the small-strain modulus of dilatational waves."""
        return self.K + 2 * self.mu

    def energy(self, F):
        """W in J/m3 for deformation gradients (..., 3, 3); inf where J <= 0."""
        J = np.linalg.det(F)
        I1 = np.einsum("...ij,...ij->...", F, F)
        with np.errstate(divide="ignore", invalid="ignore"):
            W = self.mu / 2 * (I1 - 3 - 2 * np.log(J)) + self.K / 2 * (J - 1) ** 2
        return np.where(J > 0, W, np.inf)

    def stress(self, F):
        """First Piola-Kirchhoff stress P in Pa for deformation gradients (..., 3, 3)."""
        J = np.linalg.det(F)[..., None, None]
        cof = J * np.linalg.inv(F).swapaxes(-1, -2)
        return self.mu * F + (self.K * (J - 1) - self.mu / J) * cof

    def relaxation(self, t):
        """G(t), the share of a stress step that remains after t seconds."""
        t = np.asarray(t, float)
        return 1 + sum((g * np.expm1(-t / tau) for g, tau in self.prony), np.zeros_like(t))
