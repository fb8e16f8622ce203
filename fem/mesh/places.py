"""Places of a mesh's nodes on the regular grid in its connectivity, and the faces around its
cells."""

import numpy as np

from fem.errors import InputError
from fem.mesh import element

OPPOSITE = np.array(
    [[4, 7, 6, 5], [0, 1, 2, 3], [3, 2, 6, 7], [0, 3, 7, 4], [1, 0, 4, 5], [2, 1, 5, 6]]
)  # (6, 4) across from FACES


def outer_faces(cells: np.ndarray) -> np.ndarray:
    """(M,) the faces of `cells` (E, 8) that belong to one cell only, as 6 * cell + face of
    fem.mesh.element.FACES. Raises InputError for a face of more than two cells."""
    faces = np.sort(cells[:, element.FACES].reshape(-1, 4), axis=1)
    _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
    if count.max() > 2:
        nodes = faces[first[count.argmax()]].tolist()
        raise InputError(
            f"{count.max()} cells share the face of nodes {nodes}, and tissue has room for two;"
            " remove those that overlap"
        )
    return np.sort(first[count == 1])


def boundary_faces(cells: np.ndarray) -> np.ndarray:
    """(M, 4) node numbers of the faces of `cells` (E, 8) that belong to one cell only,
    counter-clockwise seen from outside. Raises InputError as `outer_faces` does."""
    return cells[:, element.FACES].reshape(-1, 4)[outer_faces(cells)]


def grid_places(cells: np.ndarray) -> np.ndarray | None:
    """Places (N, 3) of the nodes of `cells` (E, 8), right-handed, found by walking from cell to
    cell through their faces; None if the cells do not form one regular grid."""
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
