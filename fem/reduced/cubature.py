"""Which points carry the internal force of all: non-negative weights by a greedy least squares
(Hernandez, Caicedo, Ferrer 2017), on what the stiffness at rest leaves over.

    sum_p w_p K_r^-1 A_p^T N_p(a),   N = P_e(F) - C : H

N alone, for the linear part is exact; with K_r^-1, so that a millimetre of error counts the same in
every mode; in random combinations of the modes, a few for each snapshot.
"""

import numpy as np
import scipy.linalg

from fem.material.base import Hyperelastic
from fem.online.point_law import point_law
from fem.reduced.points import PA, gradients, points_law, volumes
from fem.reduced.reduction import Reduction
from fem.reduced.symmetry import Sides

ROWS = 12  # combinations of the modes for each snapshot
CANDIDATES = 12_000  # points, or pairs of them, among which is chosen; drawn where there are more
BLOCK = 8  # points that are added at a time
ENOUGH = 1e-6  # relative residual at which no more are added


def cubature(
    reduction: Reduction, seen: list[int], count: int, snapshots: int, rng: np.random.Generator
) -> tuple[Sides, np.ndarray, float]:
    """(points, weights mN mm/Pa of the left ones, relative residual): at most `count` points in
    all.

    seen: how many modes of each parity the points see; snapshots: frames to choose them by.
    """
    pairs = reduction.body.pairs
    numbers = np.arange(len(pairs.left))
    if len(numbers) > CANDIDATES:
        numbers = np.sort(rng.choice(len(numbers), CANDIDATES, replace=False))
    candidates = Sides(pairs.left[numbers], pairs.right[numbers], pairs.axis)
    states = _states(reduction, snapshots, rng)
    columns, target = nonlinear_forces(reduction, seen, candidates, states, rng)
    which, weights, residual = choose(columns, target, count // pairs.parities)
    points = Sides(candidates.left[which], candidates.right[which], pairs.axis)
    return points, weights * volumes(reduction.body.mesh)[points.left] * PA, residual


def _states(reduction, count, rng):
    """(s, R) coordinates of some frames."""
    frames = len(reduction.coordinates(reduction.members[0])) - 1
    places = np.sort(rng.choice(n := len(reduction.members) * frames, min(count, n), False))
    states = []
    for i in np.unique(places // frames):
        states.append(
            reduction.coordinates(reduction.members[i])[1 + places[places // frames == i] % frames]
        )
    return np.concatenate(states)


def nonlinear_forces(
    reduction: Reduction,
    seen: list[int],
    candidates: Sides,
    states: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """(columns (rows, h), target (rows,)): what each candidate and its image add to the nonlinear
    forces of `states` (s, R), and what all points add."""
    mesh, material = reduction.body.mesh, reduction.body.material
    fields = np.concatenate(reduction.fields)
    starts = reduction.starts[:-1]
    inner = np.concatenate([start + np.arange(n) for start, n in zip(starts, seen, strict=True)])
    mix = rng.standard_normal((len(states), ROWS, len(fields))).astype(np.float32)
    for start, flexibility in zip(starts, reduction.flexibility, strict=True):
        part = slice(start, start + len(flexibility))
        mix[..., part] = mix[..., part] @ flexibility.astype(np.float32)
    states = np.ascontiguousarray(states[:, inner], np.float32)
    columns = np.zeros((len(states), ROWS, len(candidates.left)), np.float32)
    target = np.zeros((len(states), ROWS))
    place = np.full((2, 8 * mesh.n_cells), -1)
    place[0, candidates.left] = np.arange(len(candidates.left))
    if candidates.axis is not None:
        place[1, candidates.right] = np.arange(len(candidates.left))
        place[1, candidates.left[candidates.left == candidates.right]] = -1
    for where, H, volume in gradients(mesh, fields):
        P = H.shape[-1]
        law = point_law(points_law(material, mesh, np.arange(where.start, where.stop)), P)
        C = unit_tangent(law.law, P)
        H = H.reshape(len(fields), 9 * P)
        weight, N = (volume * law.mu).astype(np.float32), np.empty((3, 3, P), np.float32)
        wanted = [(side, np.flatnonzero(side[where] >= 0)) for side in place]
        for s, state in enumerate(states):
            law.H[...] = (state @ H[inner]).reshape(3, 3, P)
            law(1.0, None, N)
            N -= np.einsum("iJkLp,kLp->iJp", C, law.H)
            N *= weight
            tests = (mix[s] @ H).reshape(ROWS, 9, P)
            added = np.einsum("rxp,xp->rp", tests, N.reshape(9, P))
            target[s] += added.sum(axis=1)
            for side, here in wanted:
                columns[s][:, side[where][here]] += added[:, here]
    return columns.reshape(-1, columns.shape[-1]), target.ravel()


def unit_tangent(law: Hyperelastic, m: int) -> np.ndarray:
    """dP/dF at rest at m points, (3, 3, 3, 3, m) float32, in units of their shear modulus."""
    C = law.tangent(np.tile(np.eye(3)[:, :, None], (1, 1, m)))
    return (C / C[0, 1, 0, 1]).astype(np.float32)


def choose(
    columns: np.ndarray, target: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """(which, weights > 0, relative residual) of at most `count` columns (rows, h) whose weighted
    sum is nearest to `target` (rows,)."""
    norms = np.sqrt(np.einsum("ij,ij->j", columns, columns)) + 1e-30
    columns = columns / norms  # of one size, for the sake of the normal equations
    active: list[int] = []
    weights, rest = np.zeros(0), target
    for _ in range(4 * count):
        if np.linalg.norm(rest) < ENOUGH * np.linalg.norm(target):
            break
        score = rest.astype(np.float32) @ columns
        score[active] = -np.inf
        best = np.argsort(score)[::-1][: min(BLOCK, count - len(active))]
        best = best[score[best] > 0]
        if not len(best):
            break
        weights = np.append(weights, np.zeros(len(best)))
        active, weights = _positive(columns, target, [*active, *best.tolist()], weights)
        rest = target - columns[:, active] @ weights
    return (
        np.array(active),
        weights / norms[active],
        float(np.linalg.norm(rest) / np.linalg.norm(target)),
    )


def _positive(columns, target, active, weights):
    """Least squares over the active columns, less those that turn negative (Lawson, Hanson)."""
    part = columns[:, active].astype(float)
    gram, right = part.T @ part, part.T @ target
    gram[np.diag_indices_from(gram)] *= 1 + 1e-9
    kept = np.arange(len(active))
    while True:
        new = scipy.linalg.solve(gram[np.ix_(kept, kept)], right[kept], assume_a="pos")
        if (new > 0).all():
            return [active[j] for j in kept], new
        falling = new <= 0
        share = np.min(weights[falling] / (weights[falling] - new[falling]))
        weights = weights + share * (new - weights)
        stays = ~(falling & (weights <= 1e-12 * weights.max()))
        kept, weights = kept[stays], weights[stays]
