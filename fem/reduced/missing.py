"""What the modes cannot carry of a force: the linear answer of the full mesh less that of the
modes.

    D = K^-1 P - Phi E,   |D f|^2 = |W f|^2

for forces f at the loadable nodes (P), E the encoder. W are the strongest components of D, which
have all of it but a small share.
"""

import numpy as np

from fem.online.grid import MM, MN
from fem.reduced.reduction import Body, Reduction
from fem.solver.stiffness import at_rest

LEFT = 1e-2  # what W leaves out of D, relative L2
MOST = 128  # rows of W


def missing_answers(reduction: Reduction) -> list[np.ndarray]:
    """W (k, 3 h_force) mm/mN of each parity."""
    body = reduction.body
    equations, factors = at_rest(body.mesh, body.material.elastic(), "full", 0.2)
    per_force = MM / MN  # m/N is mm/mN
    found = []
    for parity, (encoder, decoder) in enumerate(
        zip(reduction.encoder, reduction.decoder, strict=True)
    ):
        columns = []
        for force in _unit_forces(body, parity):
            answer = per_force * equations.field(factors.solve(equations.vector(force))).T
            columns.append(body.free.fold(answer)[parity])
        # the decoder gives left values; an orthonormal coordinate is more by the pair's share
        share = np.tile(body.free.share, 3)[:, None]
        D = np.array(columns).T - (decoder / share) @ encoder
        _, s, V = np.linalg.svd(D, full_matrices=False)
        left = np.sqrt(np.cumsum((s**2)[::-1])[::-1] / np.sum(s**2))
        k = min(MOST, int(np.sum(left > LEFT)))
        found.append(s[:k, None] * V[:k])
    return found


def _unit_forces(body: Body, parity: int):
    """The fields (3, N) of one parity that fold into unit forces."""
    sides, n = body.loadable, body.mesh.n_nodes
    for component in range(3):
        for left, right in zip(sides.left, sides.right, strict=True):
            force = np.zeros((3, n))
            sign = -1 if (component == sides.axis) != bool(parity) else 1
            if sides.axis is None:
                force[component, left] = 1.0
            elif left != right:
                force[component, left], force[component, right] = 0.5, 0.5 * sign
            elif sign == 1:  # else it moves within the plane, and is of the other parity
                force[component, left] = 0.5
            yield force
