"""Meshes of cubes, boxes, voxels and the tumour, and any mesh with its cells cut into eight."""

import math
from dataclasses import replace

import numpy as np

from fem.errors import InputError
from fem.memory import require_memory
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh, checked_mesh
from fem.mesh.places import outer_faces
from fem.online.grid import NodeGrid
from fem.ranges import checked, shown

TUMOUR_EDGE = (
    0.5087e-3  # m: 1314 cubes of this edge make 173.0 mm3, so that 7 % is the paper's 12.1 mm3
)
TUMOUR_SHAPE = (16, 16, 6)  # cells of the lattice: five full layers, and the bump on them
# Cells of the tumour itself, layer by layer from below: rows 4 to 10 along y, columns 0 to 15 along
# x. All others of the five full layers are tissue around it. These are facts read from the mesh
# file that the authors published beside the paper.
TUMOUR_ROWS = {
    2: """
        .......##.......
        ......####......
        .....######.....
        .....######.....
        .....######.....
        ......####......
        .......##.......""",
    3: """
        ......####......
        .....######.....
        .....######.....
        ....########....
        ....########....
        .....######.....
        ......####......""",
    5: """
        .......##.......
        .....######.....
        .....######.....
        .....######.....
        .....######.....
        .....######.....
        .......##.......""",
}
TUMOUR_ROWS[4] = TUMOUR_ROWS[3]
FIRST_ROW = 4  # along y, of TUMOUR_ROWS
CELL_BYTES = 4000  # of memory that a cell takes while a mesh is checked
UNIT = ((element.CORNERS + 1) / 2).astype(int)  # (8, 3) corners of a cell from 0 to 1
CUTS = np.indices((3, 3, 3)).reshape(3, -1).T - 1  # (27, 3) corners of its eight parts, -1 to 1
PARTS = np.ravel_multi_index(np.moveaxis(UNIT[:, None] + UNIT, -1, 0), (3, 3, 3))  # (8, 8) of CUTS
SIDES = np.array(
    [
        np.flatnonzero(CUTS @ normal == 1)
        for normal in np.rint(element.CORNERS[element.FACES].mean(axis=1)).astype(int)
    ]
)  # (6, 9) of CUTS, on each face


def from_voxels(keep: np.ndarray, edge: float, fixed: str) -> HexMesh:
    """Cubes of `edge` m where `keep` (ex, ey, ez) is true, with the nodes that they use.

    Its node sets `top` and `bottom` are the highest and lowest nodes; fixed: as in `box`.
    """
    keep = np.asarray(keep)
    if keep.ndim != 3 or keep.dtype.kind != "b" or not keep.any():
        raise InputError(f"voxels of {keep.dtype} {keep.shape}; give bool (ex, ey, ez), some true")
    edge = checked("edge", edge, 1e-9, 1e6, "m")
    shape = tuple(n + 1 for n in keep.shape)
    number = np.arange(np.prod(shape)).reshape(shape)
    cells = np.stack(
        [
            number[tuple(slice(o, o + n) for o, n in zip(offset, keep.shape, strict=True))][keep]
            for offset in UNIT
        ],
        axis=1,
    )
    index, inverse = np.unique(cells, return_inverse=True)
    places = np.stack(np.unravel_index(index, shape), axis=1)
    sides = {
        name: places[:, 2] == layer
        for name, layer in (("top", places[:, 2].max()), ("bottom", places[:, 2].min()))
    }
    mesh = HexMesh(
        places * float(edge),
        inverse.reshape(cells.shape),
        np.zeros(len(index), bool),
        NodeGrid(shape, index),
        node_sets=sides,
    )
    return mesh if fixed == "none" else mesh.with_sets(fixed=fixed)


def box(cells: tuple[int, int, int], edge: float, fixed: str = "all but top") -> HexMesh:
    """A block of cells = (ex, ey, ez) cubes of `edge` m.

    fixed: "all but top" (bottom and sides), "bottom", "none", or another selection of
    fem.mesh.select.
    """
    if len(cells) != 3:
        raise InputError(f"a box of {shown(cells)} cells; give their numbers along x, y and z")
    for n in cells:
        checked("cells", n, 1, 10**9, whole=True)
    require_memory(
        CELL_BYTES * math.prod(cells), f"a box of mesh.cells = {shown(cells)}", "take fewer"
    )
    return from_voxels(np.ones(tuple(cells), bool), edge, fixed)


def tumour(edge: float = TUMOUR_EDGE) -> HexMesh:
    """The paper's mesh: 1782 nodes and 1314 cubes of `edge` m, a block of tissue with the tumour in
    it, which ends in a bump on its top; bottom and walls held, on a 17 x 17 x 8 node grid.

    Its cell sets are `tissue` (1166 cells, numbered first) and `tumour` (148), each with x fastest
    and z slowest; its node sets `bottom`, `walls` (with the rim of the fifth layer) and `top`, the
    bump's. Source: the mesh that the authors of arXiv 2301.04614 published beside it.
    """
    nx, ny, full = *TUMOUR_SHAPE[:2], TUMOUR_SHAPE[2] - 1
    lump = np.zeros(TUMOUR_SHAPE, bool)
    for layer, text in TUMOUR_ROWS.items():
        rows = np.array([list(row) for row in text.split()]) == "#"  # (y, x)
        lump[:, FIRST_ROW : FIRST_ROW + len(rows), layer] = rows.T
    keep = lump.copy()
    keep[..., :full] = True
    mesh = from_voxels(keep, edge, "none")
    cell = np.argwhere(keep)
    order = np.lexsort((*cell.T, lump[keep]))
    i, j, k = places = np.rint(mesh.points / edge).astype(int).T
    walls = (k <= full) & ((i == 0) | (i == nx) | (j == 0) | (j == ny))
    shape = (nx + 1, ny + 1, full + 3)
    # the grid's last layer is void, as in the U-Net of the paper's authors, which pads at the high
    # end of each axis; see docs/meshes.md
    return replace(
        mesh,
        cells=mesh.cells[order],
        fixed=walls | (k == 0),
        grid=NodeGrid(shape, np.ravel_multi_index(tuple(places), shape)),
        node_sets={**mesh.node_sets, "walls": walls},
        cell_sets={"tissue": ~lump[keep][order], "tumour": lump[keep][order]},
    )


def refined(mesh: HexMesh) -> HexMesh:
    """`mesh` with every cell cut into eight; on its node grid the old nodes are every second one.

    A new node belongs to a node set if all the old ones around it do; it is held, or loaded, if it
    lies on an old boundary face whose nodes all are. Raises InputError for what is no mesh.
    """
    checked_mesh(mesh)
    weights = np.prod(1 + CUTS[:, None] * element.CORNERS, axis=2) / 8  # (27, 8)
    around = np.where(weights > 0, mesh.cells[:, None], -1)  # (E, 27, 8) old nodes around the new
    _, first, new = np.unique(
        np.sort(around, axis=2).reshape(-1, 8), axis=0, return_index=True, return_inverse=True
    )
    new = new.reshape(-1, len(CUTS))  # (E, 27)
    old = around.reshape(-1, 8)[first]  # (n, 8)
    cell, cut = np.divmod(first, len(CUTS))
    outer = np.unravel_index(outer_faces(mesh.cells), (mesh.n_cells, 6))

    def interpolated(values):  # (N, 3) to (n, 3)
        return np.einsum("na,nai->ni", weights[cut], values[mesh.cells[cell]])

    def in_set(chosen):
        return (chosen[old] | (old < 0)).all(axis=1)

    def on_surface(chosen):
        faces = chosen[mesh.cells[:, element.FACES][outer]].all(axis=1)
        found = in_set(chosen) & ((old >= 0).sum(axis=1) == 1)  # the old nodes
        found[new[outer[0][faces, None], SIDES[outer[1][faces]]]] = True
        return found

    grid = None
    if mesh.grid is not None:
        places = np.stack(np.unravel_index(mesh.grid.index, mesh.grid.shape), axis=1)
        shape = tuple(2 * n - 1 for n in mesh.grid.shape)
        at = np.rint(2 * interpolated(places)).astype(int)
        grid = NodeGrid(shape, np.ravel_multi_index(tuple(at.T), shape))
    return HexMesh(
        interpolated(mesh.points),
        new[:, PARTS].reshape(-1, 8),
        on_surface(mesh.fixed),
        grid,
        None if mesh.loaded is None else on_surface(mesh.loaded),
        {name: in_set(chosen) for name, chosen in mesh.node_sets.items()},
        {name: np.repeat(chosen, 8) for name, chosen in mesh.cell_sets.items()},
    )
