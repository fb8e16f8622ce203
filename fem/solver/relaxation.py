"""Relaxation of the stress between two updates, exact for a stress that runs linearly."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from fem.online.creep import exponential_weights
from fem.solver.stresses import Weights

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
Coefficients = list[tuple[float, float, float, float]]


def history_coefficients(
    prony: tuple[tuple[float, float], ...], elapsed: float, ahead: float = 0.0
) -> Coefficients:
    """[(a, old, new, forward)] per term: q <- q + a (old S_old + new S_new - q), exact where S runs
    linearly.

    q_k is the relaxed stress of term k: q' = (S_e - q) / tau, S = S_e - sum g_k q_k. `forward`
    carries q to the middle of the `ahead` seconds to come.
    """
    return [
        (*exponential_weights(elapsed, tau), float(-np.expm1(-ahead / (2 * tau))))
        for _, tau in prony
    ]


class StressHistory:
    """The relaxed stresses q_k of a run of cells, and the viscous stress V = sum g_k q_k, which
    stands still between updates.

    Six components of S = F^-1 P each, for it is symmetric; q_k and the last S in float64 whatever
    the kernel's precision, V in the kernel's. All in the stress's unit, see Weights.
    """

    def __init__(
        self,
        prony: tuple[tuple[float, float], ...],
        shape: tuple[int, int],
        weights: Weights,
        dtype: np.dtype,
        scratch: Callable[..., np.ndarray],
    ) -> None:
        self.prony, self.shape, self.weights = prony, shape, weights
        self.dtype, self.scratch = dtype, scratch
        self.least = 1 - sum(g for g, _ in prony)  # share of the stress that never relaxes
        self.reset()

    @cached_property
    def _work(self):
        return self.scratch("HV", (3, 3, *self.shape))

    def reset(self) -> None:
        """Rest: no relaxed stress, no old stress, no viscous stress."""
        self.relaxed = np.zeros((len(self.prony), 6, *self.shape))
        self.old_stress = np.zeros((6, *self.shape))
        self.V = np.zeros((3, 3, *self.shape), self.dtype)
        self.bends: list[Any] = []
        self.pairing = 0.0  # J, the product of V and the strain at its last update

    def expect(self, coefficients: Coefficients, left: float, bends: list[Any]) -> np.ndarray:
        """Let V be what the past leaves of the stress after a step, Q / c with c = `left`: six
        components.

        The stress at the end of the step is c (S_e - V), for S_e that runs linearly over the step
        but for the `bends` b_k, what else of it has relaxed at the end:

            c = 1 - sum g_k a_k new_k,   Q = sum g_k ((1 - a_k) q_k + a_k old_k S_old + b_k)

        bends: one for each term, (6, Q, E) or 0, or none at all; the next `update` takes them too
        """
        total: Any = 0.0
        self.bends = bends or [0.0] * len(self.prony)
        for (g, _), (a, old, _, _), q, bend in zip(
            self.prony, coefficients, self.relaxed, self.bends, strict=True
        ):
            total = total + g / left * ((1 - a) * q + a * old * self.old_stress + bend)
        self._set_viscous(total)
        return total

    def second_stress(self, cof: np.ndarray, P: np.ndarray, J: np.ndarray) -> np.ndarray:
        """S = F^-1 P, six components (6, Q, E)."""
        stress: np.ndarray = np.empty((6, *self.shape))
        for k, (i, j) in enumerate(VOIGT):
            np.einsum("cqe,cqe->qe", cof[:, i], P[:, j], out=stress[k], casting="same_kind")
        stress /= J
        return stress

    def update(
        self, cof: np.ndarray, P: np.ndarray, J: np.ndarray, coefficients: Coefficients
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advance every relaxed stress to S = F^-1 P, and refresh V: (S, V) with six components."""
        stress = self.second_stress(cof, P, J)
        total: Any = 0.0
        for k, ((g, _), (a, old, new, forward), q) in enumerate(
            zip(self.prony, coefficients, self.relaxed, strict=True)
        ):
            q += a * (old * self.old_stress + new * stress - q)
            if self.bends:
                q += self.bends[k]
            total = total + g * (q + forward * (stress - q))
        self.old_stress, self.bends = stress, []
        self._set_viscous(total)
        return stress, total

    def _set_viscous(self, total):
        for k, (i, j) in enumerate(VOIGT):
            self.V[i, j] = self.V[j, i] = total[k]

    def subtract_viscous(self, H: np.ndarray, P: np.ndarray) -> None:
        """P -= F V."""
        T = self._work
        P -= self.V
        for k in range(3):
            P -= np.multiply(H[:, k, None], self.V[k], out=T)

    def pair(self, H: np.ndarray) -> float:
        """Integral of -V : E over the cells, in J, with the strain E = (H + H^T + H^T H) / 2."""
        total: Any = 0.0
        for i, j in VOIGT:
            strain = np.einsum("cqe,cqe->qe", H[:, i], H[:, j]) + H[i, j] + H[j, i]
            total -= (0.5 if i == j else 1.0) * np.sum(
                strain * self.V[i, j] * self.weights.points, dtype=float
            )
        return self.weights.factor * total
