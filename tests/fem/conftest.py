"""A reduced model that leaves nothing out: every free node's every direction is a mode, and every
integration point is looked at."""

from dataclasses import dataclass

import numpy as np
import pytest

import fem
from fem.reduced.assemble import Assembly
from fem.reduced.points import PA, volumes
from fem.reduced.reduction import Body, Reduction
from fem.reduced.snapshots import Decomposition

TISSUE = fem.NeoHooke(400.0, 0.42, 1000.0, ((0.12, 330.0), (0.8, 11.0)))


@dataclass
class Everything:
    """Snapshots whose basis is all there is."""

    bases: list
    interval: float = 0.25

    def decomposition(self, members):
        sizes = [Q.shape[1] for Q in self.bases]
        return Decomposition([np.ones(k) for k in sizes], [np.eye(k) for k in sizes])


def whole(mesh, material):
    """The ReducedModel of all modes and points of a mesh."""
    body = Body(mesh, material)
    size = 3 * len(body.free.left)
    alone = np.tile(body.free.left == body.free.right, 3) & (body.axis is not None)
    flipped = np.arange(size) // len(body.free.left) == body.axis
    # nodes on the plane of symmetry move in it (even) or across it (odd)
    bases = [np.eye(size)[:, ~(alone & flipped)], np.eye(size)[:, ~alone | flipped]]
    reduction = Reduction(body, Everything(bases[: body.free.parities]), [], size)
    weights = volumes(mesh)[body.pairs.left] * PA
    seen = np.diff(reduction.starts).tolist()
    return Assembly(reduction, seen, body.pairs, weights).model(None)


@pytest.fixture(scope="session")
def block():
    """A box of 4 x 3 x 2 cells held at the bottom."""
    return fem.box((4, 3, 2), edge=1e-3).with_sets(fixed="z min", loaded="z max")


@pytest.fixture(scope="session")
def tissue():
    """The paper's."""
    return TISSUE


@pytest.fixture(scope="session")
def whole_model(block):
    """The ReducedModel of all modes and points of the block."""
    return whole(block, TISSUE)


@pytest.fixture(scope="session")
def reduce_wholly():
    """reduce_wholly(mesh, material): the ReducedModel of all modes and points."""
    return whole
