"""Creep of linear viscoelastic tissue, and forces as the tissue remembers them."""

from dataclasses import dataclass

import numpy as np

from fem.errors import InputError


def exponential_weights(elapsed: float, tau: float) -> tuple[float, float, float]:
    """(a, old, new) of r <- r + a (old f_old + new f_new - r), the solution of r' = (f - r) / tau
    after `elapsed` seconds, exact where f runs linearly from f_old to f_new.

    `expm1` keeps a = 1 - exp(-x) exact for steps far below tau, and a series takes over where the
    quotient would cancel.
    """
    x = elapsed / tau
    a = float(-np.expm1(-x))
    new = (1 - a / x) / a if x > 1e-4 else 0.5 + x / 12
    return a, 1 - new, new


@dataclass(frozen=True)
class Creep:
    """D(t) = 1 + sum j_k (1 - exp(-t / l_k)): the displacement under a held force, in elastic
    answers.

    terms: ((j, l in s), ...), the weights and retardation times.
    """

    terms: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, prony: tuple[tuple[float, float], ...]) -> "Creep":
        """The creep function of the relaxation function G(t) = 1 - sum g_k (1 - exp(-t / tau_k)).

        With the relaxed strains q_k' = (e - q_k) / tau_k the stress is s = e - sum g_k q_k. In the
        coordinates y_k = sqrt(g_k tau_k) q_k the answer to a stress is e = s + v . y,
        y' = S y + v s with v_k = sqrt(g_k / tau_k) and the symmetric S = v v^T - diag(1 / tau):
        each eigenvector of S is one retardation. Terms of equal times come out as one.

        Raises InputError where sum g is 1 or more: such tissue flows without end.
        """
        if not prony:
            return cls(())
        g, tau = np.array(prony, float).T
        if not g.sum() < 1:
            raise InputError(
                f"the weights g of the Prony series add up to {g.sum():g}: such tissue flows"
                " without end; keep their sum below 1"
            )
        v = np.sqrt(g / tau)
        rates, vectors = np.linalg.eigh(np.outer(v, v) - np.diag(1 / tau))
        times = -1 / rates
        weights = (vectors.T @ v) ** 2 * times
        order = np.argsort(times)
        kept = order[weights[order] > 1e-12 * weights.sum()]
        return cls(tuple((float(weights[k]), float(times[k])) for k in kept))

    def __call__(self, t: np.ndarray | float) -> np.ndarray:
        """D at t seconds after the force came, of the shape of t."""
        t = np.asarray(t, float)
        total = np.ones_like(t)
        for weight, time in self.terms:
            total -= weight * np.expm1(-t / time)
        return total


def remembered_force(creep: Creep, force: np.ndarray, interval: float) -> np.ndarray:
    """The force that would give an elastic tissue of the same stiffness the same displacement, as
    far as it is linear: f~(t) = integral of D(t - s) df(s), at the frames of `force`.

    force: (..., frames, d), `interval` s apart and linear between, none before the first frame.
    """
    result = np.array(force, float)
    for weight, time in creep.terms:
        a, old, new = exponential_weights(interval, time)
        slow = np.zeros_like(result[..., 0, :])
        for frame in range(1, force.shape[-2]):
            slow = slow + a * (old * force[..., frame - 1, :] + new * force[..., frame, :] - slow)
            result[..., frame, :] += weight * slow
    return result
