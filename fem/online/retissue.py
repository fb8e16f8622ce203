"""Another tissue for a reduced model and its learned step, without fitting anything again.

The law stands in the model. A common factor on all moduli divides the answers to a force, and the
Prony series is in nothing but the filters. Another K / mu changes the stiffness at rest too,

    K_r' = K_r + d K_v,   d = K'/mu' - K/mu,   V = K_r^-1 K_v (R_b, R_b) of each parity
    X = (I + d V)^-1:   M' = X [M_T | M_b - d M_T tr(A) I],   encoder' = X encoder,   N' = X N

with K_v the stiffness of a unit of K / mu, which stands in a file as V<b>.
"""

from dataclasses import replace

import numpy as np

from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.online.creep import Creep
from fem.online.reduced_model import ReducedModel
from fem.ranges import checked

Learned = dict[str, np.ndarray]


def with_tissue(
    model: ReducedModel,
    learned: Learned,
    mu: float | None = None,
    K: float | None = None,
    prony: tuple[tuple[float, float], ...] | None = None,
) -> tuple[ReducedModel, Learned]:
    """The model and {"gain", "N0", ..., "V0", ...} with other moduli in Pa or another Prony series;
    what is None stays.

    Raises InputError where the law is not neo-Hookean, values have no meaning, tissue differs from
    point to point and more than a Prony series is asked for, or K / mu would change and there is no
    V.
    """
    law = model.law
    if not isinstance(law, NeoHooke):
        raise InputError(f"moduli are for the neo-Hookean law, not for {type(law).__name__}")
    if any(np.ndim(given) for given in (mu, K) if given is not None):
        raise InputError(
            "give one mu and one K for all of the tissue; a part of it that is softer or stiffer"
            " moves otherwise than in the data: train on a scene with [material.<cell set>]"
        )
    if (mu, K) != (None, None) and (np.ndim(law.mu) or np.ndim(law.nu)):
        raise InputError(
            "this tissue differs from point to point; one mu or K for all of it has no meaning:"
            " scale the forces for a common factor, or train on another scene"
        )
    if prony is None:
        prony = tuple((float(g), float(tau)) for g, tau in model.prony)
    Creep.of(prony)  # refuses a series without meaning
    meta_law = model.meta["law"] | {"prony": [list(term) for term in prony]}
    blocks, factor = list(model.blocks), 1.0
    if (mu, K) != (None, None):
        old_mu, old_K = float(law.mu), float(law.K)
        for name, given in (("mu", mu), ("K", K)):
            if given is not None:
                checked(name, given, 1e-9, 1e15, "Pa")
        mu, K = old_mu if mu is None else float(mu), old_K if K is None else float(K)
        if not (0 < mu < np.inf and 2 * mu / 3 < K < np.inf):
            raise InputError(f"mu = {mu:g} Pa must be positive and K = {K:g} Pa above 2/3 of it")
        factor, ratio = mu / old_mu, K / mu
        d = ratio - old_K / old_mu
        meta_law |= {"mu": mu, "nu": (3 * ratio - 2) / (6 * ratio + 2)}
        if abs(d) > 1e-6 * ratio:
            blocks, learned = _with_ratio(blocks, learned, d)
    blocks = [
        replace(
            block,
            encoder=_scaled(block.encoder, factor),
            flexibility=_scaled(block.flexibility, factor),
            missing=_scaled(block.missing, factor),
        )
        for block in blocks
    ]
    series = np.array(prony, float).reshape(-1, 2)
    meta = model.meta | {"law": meta_law}
    return replace(model, blocks=tuple(blocks), prony=series, meta=meta), learned


def _scaled(array, factor):
    return (array / factor).astype(np.float32)


def _with_ratio(blocks, learned, d):
    """Blocks and learned arrays where K / mu is greater by d."""
    if "V0" not in learned:
        raise InputError(
            "this file does not say how its stiffness changes with K / mu; change mu and K by one"
            " factor, or train the network again"
        )
    changed, new = [], dict(learned)
    for b, block in enumerate(blocks):
        V = learned[f"V{b}"].astype(float)
        X = np.linalg.inv(np.eye(len(V)) + d * V)
        S, n = block.A.shape
        trace = np.zeros((9, S // 9, n))
        trace[::4] = block.A.reshape(9, S // 9, n)[::4].sum(axis=0)
        onto = block.M[:, :S].astype(float)
        rest = block.M[:, S:] - d * len(blocks) * onto @ trace.reshape(S, n)
        arrays = {"M": np.hstack([onto, rest]), "encoder": block.encoder}
        arrays["flexibility"] = block.flexibility
        changed.append(
            replace(block, **{name: (X @ a).astype(np.float32) for name, a in arrays.items()})
        )
        new[f"N{b}"] = (X @ learned[f"N{b}"]).astype(np.float32)
        new[f"V{b}"] = (X @ V).astype(np.float32)
    return changed, new
