"""The regular node grid of a mesh that has one in its connectivity, whatever its shape and
numbering."""

import itertools

import numpy as np

from fem.mesh.contact_faces import main_side
from fem.mesh.hexmesh import HexMesh
from fem.mesh.places import grid_places
from fem.online.grid import NodeGrid


def node_grid(mesh: HexMesh) -> NodeGrid | None:
    """The regular node grid that `mesh` lies on, found in its connectivity, or None.

    Places (i, j, k) are found by walking from cell to cell through their faces, so curved and
    distorted blocks count, also with holes and steps. The third axis points out of the surface that
    can be pushed on, the way most of it faces (see fem.mesh.contact_faces); the first runs along x
    as well as it can. Raises InputError if no side has more of that surface than another.
    """
    places = grid_places(mesh.cells)
    if places is None:
        return None
    outward = main_side(mesh, places)
    slope = np.linalg.lstsq(
        places - places.mean(axis=0), mesh.points - mesh.points.mean(axis=0), rcond=None
    )[0]  # (3, 3) dx/d(i, j, k)
    places = places @ turn(outward, slope).T
    places -= places.min(axis=0)
    shape = tuple(int(n) for n in places.max(axis=0) + 1)
    return NodeGrid(shape, np.ravel_multi_index(tuple(places.T), shape))


def turn(outward: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) by quarter turns, places @ turn.T, that takes the axis `outward` to +k
    and keeps i near x, and j near y.

    slope: (3, 3), rows d(x, y, z) along the old axes.
    """
    slope = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    turns = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3), int)
            matrix[range(3), order] = signs
            if round(np.linalg.det(matrix)) == 1 and np.array_equal(matrix @ outward, [0, 0, 1]):
                turns.append(matrix)
    return max(turns, key=lambda matrix: np.dot([2, 1], np.diag(matrix @ slope)[:2]))
