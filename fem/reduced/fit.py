"""The dense layer M of a reduced model, fitted to the true histories of a dataset.

In equilibrium the elastic answer of a frame is what its points and the linear history add up to
(fem.online.reduced):

    g - b = M z,   z = [T ; b_in],   b = c a - a_Q

with T and b along the history of the true coordinates a. M is the ridge regression to that, towards
the M of the cubature:

    min |G - B - M Z|^2 + tr (M - M0) L (M - M0)^T,   L = ridge * mean Z^2, of T and b_in apart

With a mirror the even and the odd part are fits of their own, each to all snapshots and images.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import scipy.linalg

from fem.material.base import Hyperelastic
from fem.online.creep import exponential_weights
from fem.online.point_law import FULL, point_law
from fem.reduced.reduction import Reduction

BATCH = 32  # interactions whose histories are followed side by side


def inputs(
    A: Sequence[np.ndarray], law: Hyperelastic, starts: np.ndarray, a: np.ndarray, interval: float
) -> Iterator[tuple[list[np.ndarray], np.ndarray]]:
    """(z (B, 9 h + n) of each parity, b (B, R)) of every frame along coordinates a (frames, B, R),
    `interval` s apart; starts: of the parities in R."""
    (_, B, R), sides, h = a.shape, len(A), len(A[0]) // 9
    m, prony = sides * h, law.prony
    points = point_law(law.of_cells(np.repeat(np.arange(m), B), m), m * B)
    weights = [(g, *exponential_weights(interval, tau)) for g, tau in prony]
    c = 1 - sum(g * w * new for g, w, _, new in weights)
    # of the stresses, and of the coordinates: relaxed ones and the last
    q, S_old = np.zeros((len(prony), 6, m * B)), np.zeros((6, m * B))
    q_a, a_old = np.zeros((len(prony), B, R)), np.zeros((B, R))
    T = np.empty((3, 3, m * B), np.float32)
    for now in a:
        H = [
            (layer @ now[:, start : start + layer.shape[1]].T).reshape(3, 3, h, B)
            for layer, start in zip(A, starts[:-1], strict=True)
        ]
        both = np.concatenate([H[0] + H[1], H[0] - H[1]], axis=2) if sides == 2 else H[0]
        points.H[...] = both.reshape(3, 3, m * B)
        Q, a_Q = np.zeros((6, m * B)), np.zeros((B, R))
        for k, (g, w, old, _) in enumerate(weights):
            Q += g * ((1 - w) * q[k] + w * old * S_old)
            a_Q += g * ((1 - w) * q_a[k] + w * old * a_old)
        points(c, Q[FULL].astype(np.float32) if prony else None, T)
        S = points.second().astype(float)
        for k, (_, w, old, new) in enumerate(weights):
            q[k] += w * (old * S_old + new * S - q[k])
            q_a[k] += w * (old * a_old + new * now - q_a[k])
        S_old, a_old, b = S, now, c * now - a_Q
        left, right = T.reshape(3, 3, m, B)[:, :, :h], T.reshape(3, 3, m, B)[:, :, h:]
        folded = [left + right, left - right] if sides == 2 else [left]
        z = [
            np.hstack([part.reshape(9 * h, B).T, b[:, start : start + layer.shape[1]]])
            for part, layer, start in zip(folded, A, starts[:-1], strict=True)
        ]
        yield z, b


class Normal:
    """The normal equations of one parity's M, summed over frames."""

    def __init__(self, n_inputs: int, n_outputs: int) -> None:
        self.gram = np.zeros((n_inputs, n_inputs))
        self.right = np.zeros((n_inputs, n_outputs))

    def add(self, z: np.ndarray, target: np.ndarray) -> None:
        """Samples z (S, inputs) and what M z should be (S, outputs)."""
        z = z.astype(float)  # a small ridge needs the digits
        self.gram += z.T @ z
        self.right += z.T @ target

    def solve(self, start: np.ndarray, stresses: int, ridge: float) -> np.ndarray:
        """M (outputs, inputs), towards `start`; the first `stresses` inputs are of that kind."""
        left, squares = self.gram.copy(), np.diag(self.gram)
        kinds = squares[:stresses], squares[stresses:]
        means = np.concatenate([np.full(len(kind), kind.mean()) for kind in kinds])
        left[np.diag_indices_from(left)] += ridge * means
        right = self.right - self.gram @ start.T
        return start + scipy.linalg.solve(left, right, assume_a="pos").T


def normal_equations(
    reduction: Reduction, A: Sequence[np.ndarray], law: Hyperelastic
) -> list[Normal]:
    """The Normal of each parity, over all frames of the reduction's interactions."""
    starts, interval = reduction.starts, reduction.snapshots.interval
    sizes = np.diff(starts)
    normals = [Normal(sum(layer.shape), size) for layer, size in zip(A, sizes, strict=True)]
    for batch in _batches(reduction.members):
        a = np.stack([reduction.coordinates(i) for i in batch], axis=1)
        g = np.stack([reduction.elastic_answers(i) for i in batch], axis=1)
        rows: list[list[np.ndarray]] = [[] for _ in A]
        rest = []
        for f, (z, b) in enumerate(inputs(A, law, starts, a, interval)):
            rest.append(g[f] - b)
            for kept, one in zip(rows, z, strict=True):
                kept.append(one)
        target = np.concatenate(rest)
        for normal, kept, start, size in zip(normals, rows, starts[:-1], sizes, strict=True):
            normal.add(np.concatenate(kept), target[:, start : start + size])
    return normals


def _batches(members: Iterable[int]) -> list[list[int]]:
    members = list(members)
    return [members[i : i + BATCH] for i in range(0, len(members), BATCH)]
