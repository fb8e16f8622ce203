"""Relaxation of the stress between two updates, exact for a stress that runs linearly."""

import numpy as np


def history_coefficients(prony, elapsed, ahead=0.0):
    """[(a, old, new, forward)] per term: q <- q + a (old S_old + new S_new - q), exact where S runs
    linearly.

    q_k is the relaxed stress of term k: q' = (S_e - q) / tau, S = S_e - sum g_k q_k. `expm1` keeps
    a = 1 - exp(-x) exact for steps far below the relaxation time. `forward` carries q to the middle
    of the `ahead` seconds to come.
    """
    result = []
    for _, tau in prony:
        x = elapsed / tau
        a = -np.expm1(-x)
        new = (
            (1 - a / x) / a if x > 1e-4 else 0.5 + x / 12
        )  # the series where the quotient would cancel
        result.append((a, 1 - new, new, -np.expm1(-ahead / (2 * tau))))
    return result
