"""What the length of a frame and a Prony series come down to in the constitutive network."""

import numpy as np

from fem.online.creep import Creep, exponential_weights


def rates(
    prony: tuple[tuple[float, float], ...], dt: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(c (1, 1), past (1, 1, K + 1), advance (1, K + 1, K + 2), creep (1, C + 1, C + 2), remembered
    (1, 1, C + 1)) float32 of a frame of dt seconds, with the symbols of fem.online.reduced:

    c Q = past @ [q_1 .. q_K, S_old];  [q_1 .. q_K, S_old] <- advance @ [q_1 .. q_K, S_old, S]
    and for the retardations [s_1 .. s_C, g_old] <- creep @ [s_1 .. s_C, g_old, g], l = g +
    remembered @ [s_1 .. s_C, g].
    """
    advance, creep = _advance(prony, dt), _advance(Creep.of(prony).terms, dt)
    g = np.array([share for share, _ in prony])
    past = g @ advance[:-1, :-1]
    c = 1 - g @ advance[:-1, -1]
    j = np.array([share for share, _ in Creep.of(prony).terms] + [0.0])
    values = np.array([c]), past[None], advance, creep, j[None]
    return tuple(value[None].astype("float32") for value in values)  # type: ignore[return-value]


def _advance(terms, dt):
    """(k + 1, k + 2): what each relaxed value keeps of itself, of the last input, of the new."""
    k = len(terms)
    rows = np.zeros((k + 1, k + 2))
    for n, (_, tau) in enumerate(terms):
        a, old, new = exponential_weights(dt, tau)
        rows[n, n], rows[n, k:] = 1 - a, (a * old, a * new)
    rows[k, k + 1] = 1
    return rows
