"""The regular node grid of a mesh that has one in its connectivity, whatever its shape and
numbering."""

import itertools

import numpy as np

from fem.errors import InputError
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import NodeGrid

OPPOSITE = np.array(
    [[4, 7, 6, 5], [0, 1, 2, 3], [3, 2, 6, 7], [0, 3, 7, 4], [1, 0, 4, 5], [2, 1, 5, 6]]
)  # (6, 4) across from FACES


def node_grid(mesh: HexMesh) -> NodeGrid | None:
    """The regular node grid that `mesh` lies on, found in its connectivity, or None.

    Places (i, j, k) are found by walking from cell to cell through their faces, so curved and
    distorted blocks count, also with holes and steps. The third axis points out of the loaded
    surface; the first runs along x as well as it can. Raises InputError if the loaded surface lies
    on several sides of the grid.
    """
    places = _walk(mesh.cells)
    if places is None:
        return None
    outward = _outward(places[mesh.free_faces])  # (M, 3)
    sides = np.unique(outward, axis=0)
    if len(sides) != 1:
        raise InputError(
            f"the surface that can be pushed on lies on {len(sides)} sides of the mesh's node"
            " grid, and the networks need it on one:"
            " give mesh.loaded, such as 'z max', or more mesh.fixed"
        )
    slope = np.linalg.lstsq(
        places - places.mean(axis=0), mesh.points - mesh.points.mean(axis=0), rcond=None
    )[0]  # (3, 3) dx/d(i, j, k)
    places = places @ turn(sides[0], slope).T
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


def _outward(corners):
    """Unit steps (M, 3) out of the faces with corner places (M, 4, 3), counter-clockwise from
    outside, in a right-handed grid."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    return np.cross(c - a, d - b) // 2


def _walk(cells):
    """Places (N, 3) of the nodes, right-handed, or None if the cells do not form one regular
    grid."""
    neighbour, face_of = _neighbours(cells)
    places = np.zeros((cells.max() + 1, 3), int)
    places[cells[0]] = (element.CORNERS + 1) / 2
    seen = np.zeros(len(cells), bool)
    front = np.array([0])
    seen[0] = True
    while front.size:
        reached = []
        for face in range(6):
            there = neighbour[front, face]
            here, there, entry = (
                front[there >= 0],
                there[there >= 0],
                face_of[front, face][there >= 0],
            )
            new = ~seen[there]
            here, there, entry = here[new], there[new], entry[new]
            step = (
                places[cells[here, element.FACES[face, 0]]] - places[cells[here, OPPOSITE[face, 0]]]
            )  # (n, 3)
            near = np.take_along_axis(cells[there], element.FACES[entry], axis=1)  # (n, 4)
            far = np.take_along_axis(cells[there], OPPOSITE[entry], axis=1)
            places[far] = places[near] + step[:, None]
            seen[there] = True
            reached.append(there)
        front = np.unique(np.concatenate(reached))
    # the walk takes the first way to a node; where two ways disagree, a cell around it is no unit
    # cube
    unit = places[cells]  # (E, 8, 3)
    axes = unit[:, [1, 3, 4]] - unit[:, :1]  # (E, 3, 3)
    cube = np.einsum("ar,erc->eac", (element.CORNERS + 1).astype(int) // 2, axes) + unit[:, :1]
    if (
        not seen.all()
        or not np.array_equal(unit, cube)
        or not np.array_equal(
            axes @ axes.swapaxes(1, 2), np.broadcast_to(np.eye(3, dtype=int), axes.shape)
        )
    ):
        return None
    return places if len(np.unique(places, axis=0)) == len(places) else None


def _neighbours(cells):
    """(E, 6) the cell behind each face, -1 for none, and (E, 6) the number of the face in that
    cell."""
    faces = np.sort(cells[:, element.FACES].reshape(-1, 4), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    one, other = order[:-1][same], order[1:][same]
    partner = np.full(len(faces), -1)
    partner[one], partner[other] = other, one
    cell, face = np.divmod(partner, 6)
    return np.where(partner < 0, -1, cell).reshape(-1, 6), face.reshape(-1, 6)
