"""The part of a mesh's surface that contacts push on: the faces that look up, on whatever level.

On a mesh with a regular grid in its connectivity, however it is bent, a face looks up if it lies on
the side of its cell that most of the loaded surface lies on; faces on other sides are the walls of
steps, and take no contact. On a mesh without one every face of the loaded surface takes contact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fem.errors import InputError
from fem.mesh.places import grid_places

if TYPE_CHECKING:
    from fem.mesh.hexmesh import HexMesh

UP = np.array([0, 0, 1])


def contact_surface(mesh: HexMesh) -> tuple[np.ndarray, np.ndarray]:
    """(faces (M, 4), rim (n,)): the free faces that look up, and the nodes of their rim.

    The rim is the held nodes of the faces that look up, and the outline of these faces seen from
    above. So the edge of a step is no rim, for the surface goes on below it.
    """
    faces, column = mesh.free_faces, np.arange(mesh.n_nodes)
    places = _places(mesh)
    if places is not None and len(faces):
        up = main_side(mesh, places)
        faces = faces[(_outward(mesh, places) == up).all(axis=1)]
        along = places[:, up == 0] - places.min()
        column = along[:, 0] * (along.max() + 1) + along[:, 1]
    _, seen = np.unique(np.sort(column[faces], axis=1), axis=0, return_index=True)
    top = column[faces[seen]]
    sides = np.sort(np.stack([top, np.roll(top, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    side, count = np.unique(sides, axis=0, return_counts=True)
    nodes = np.unique(faces)
    rim = nodes[mesh.fixed[nodes] | np.isin(column[nodes], side[count == 1])]
    return faces, rim


def main_side(mesh: HexMesh, places: np.ndarray) -> np.ndarray:
    """The side of the cells, as a unit step (3,) of the nodes' `places` (N, 3), that contacts push
    on.

    On a mesh with a node grid it is the one that the grid's third axis points to, if the loaded
    surface has faces there; otherwise the one with the largest area, less that of the side across.
    Raises InputError if that is none.
    """
    outward = _outward(mesh, places)
    if mesh.grid is not None and (outward == UP).all(axis=1).any():
        return UP
    a, b, c, d = np.moveaxis(mesh.points[mesh.free_faces], 1, 0)
    area = np.linalg.norm(np.cross(c - a, d - b), axis=1)
    net = area @ outward
    main = int(np.abs(net).argmax())
    if np.abs(net[main]) <= 1e-6 * area.sum():
        raise InputError(
            "the surface that can be pushed on faces all sides alike, and the grid needs one for"
            " its last layer; give mesh.loaded, such as 'z max'"
        )
    return np.eye(3, dtype=int)[main] * int(np.sign(net[main]))


def _places(mesh):
    """Places (N, 3) of the nodes on the mesh's grid, or on the one in its connectivity, or None."""
    if mesh.grid is None:
        return grid_places(mesh.cells)
    return np.stack(np.unravel_index(mesh.grid.index, mesh.grid.shape), axis=1)


def _outward(mesh, places):
    """Unit steps (M, 3) of `places` out of the free faces."""
    first = places[mesh.cells[0]]
    handed = round(np.linalg.det(first[[1, 3, 4]] - first[0]))
    a, b, c, d = np.moveaxis(places[mesh.free_faces], 1, 0)
    return handed * np.cross(c - a, d - b) // 2
