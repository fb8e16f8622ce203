"""Meshes of cubes: boxes, voxels and the tumour."""

import numpy as np

from fem.errors import InputError
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh

TUMOUR_EDGE = (
    0.5087e-3  # m: 1314 cubes of this edge make 173.0 mm3, so that 7 % is the paper's 12.1 mm3
)


def from_voxels(keep, edge, fixed):
    """Cubes of `edge` m where `keep` (ex, ey, ez) is true, with the nodes that they use; `fixed` as
    in `box`."""
    shape = tuple(n + 1 for n in keep.shape)
    number = np.arange(np.prod(shape)).reshape(shape)
    offsets = ((element.CORNERS + 1) / 2).astype(int)  # (8, 3)
    cells = np.stack(
        [
            number[tuple(slice(o, o + n) for o, n in zip(offset, keep.shape))][keep]
            for offset in offsets
        ],
        axis=1,
    )
    grid_index, inverse = np.unique(cells, return_inverse=True)
    points = np.stack(np.unravel_index(grid_index, shape), axis=1) * float(edge)
    cells = inverse.reshape(cells.shape)
    held = np.zeros(len(points), bool)
    mesh = HexMesh(points, cells, held, shape, grid_index)
    if fixed != "none":
        faces = mesh.boundary_faces
        z = points[faces, 2]
        moving = (
            (z == points[:, 2].max()).all(axis=1)
            if fixed == "all but top"
            else (z != points[:, 2].min()).any(axis=1)
        )
        held[faces[~moving]] = True
    return mesh


def box(cells, edge, fixed="all but top"):
    """A block of cells = (ex, ey, ez) cubes of `edge` m.

    fixed: "all but top" (bottom and sides), "bottom" or "none".
    """
    if min(cells) < 1 or edge <= 0:
        raise InputError(
            f"a box of {tuple(cells)} cells of edge {edge} m is empty; both must be positive"
        )
    if fixed not in ("all but top", "bottom", "none"):
        raise InputError(f"fixed = '{fixed}' is not one of 'all but top', 'bottom', 'none'")
    return from_voxels(np.ones(tuple(cells), bool), edge, fixed)


def tumour(edge=TUMOUR_EDGE):
    """The paper's tumour: 1782 nodes and 1314 cubes on a 17 x 17 x 8 node grid, top free, all else
    fixed.

    A truncated ellipsoid reproduces both counts of arXiv 2301.04614; the shape itself is not
    published.
    """
    x, y, z = np.meshgrid(*(np.arange(n) + 0.5 for n in (16, 16, 7)), indexing="ij")
    keep = ((x - 8.1) ** 2 + (y - 8.0) ** 2) / 8.0**2 + ((z - 5.5) / 7.0) ** 2 <= 1.10181442
    return from_voxels(keep, edge, "all but top")
