"""Hexahedral meshes, and the map between their nodes and a regular node grid."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fem.errors import InputError
from fem.mesh import element


@dataclass(frozen=True)
class HexMesh:
    """Eight-node hexahedra.

    points: (N, 3) reference node positions, m
    cells: (E, 8) node numbers in VTK order
    fixed: (N,) bool, nodes held at zero displacement
    grid_shape: (nx, ny, nz) of the regular node grid that holds the nodes, or None
    grid_index: (N,) place of each node in that grid, C order, or None
    loaded: (N,) bool, nodes of the surface that contact may push on; None for every free face
    congruent: every cell is the same parallelepiped, so one gradient matrix serves all

    Raises InputError that names an inverted or degenerate cell.
    """

    points: np.ndarray
    cells: np.ndarray
    fixed: np.ndarray
    grid_shape: tuple | None = None
    grid_index: np.ndarray | None = None
    loaded: np.ndarray | None = None
    congruent: bool = field(init=False)

    def __post_init__(self):
        if not np.isfinite(self.points).all():
            raise InputError(
                f"node {int(np.argmin(np.isfinite(self.points).all(1)))} has a position that is not finite"
            )
        corners = self.points[self.cells]
        edges = corners - corners[:, :1]  # (E, 8, 3)
        self._check_orientation(np.abs(edges).max())
        same = np.abs(edges - edges[0]).max() < 1e-9 * np.abs(edges[0]).max()
        warp = np.abs(element.HOURGLASS @ edges[0]).max() < 1e-9 * np.abs(edges[0]).max()
        object.__setattr__(self, "congruent", bool(same and warp))

    def _check_orientation(self, size):
        detJ = np.linalg.det(
            element.jacobians(self.points, self.cells, np.vstack([element.CORNERS, element.CENTRE]))
        )
        bad = np.flatnonzero(detJ.min(axis=1) <= 1e-9 * size**3)
        if bad.size:
            e, corner = bad[0], int(detJ[bad[0]].argmin())
            place = f"at its corner {corner}" if corner < 8 else "at its centre"
            raise InputError(
                f"cell {e} (nodes {self.cells[e].tolist()}) is inverted or degenerate: Jacobian {detJ[e].min():.3g} {place}"
                f" ({bad.size} such cells); list its nodes in VTK order and repair its shape"
            )

    @property
    def n_nodes(self):
        return len(self.points)

    @property
    def n_cells(self):
        return len(self.cells)

    def volume(self, displacement=None):
        """Volume in m3, of the mesh displaced by `displacement` (N, 3) m if given; exact for
        trilinear cells."""
        points = self.points if displacement is None else self.points + displacement
        return float(np.linalg.det(element.jacobians(points, self.cells, element.GAUSS)).sum())

    @cached_property
    def boundary_faces(self):
        """(M, 4) node numbers of the faces that belong to one cell only, counter-clockwise seen
        from outside."""
        faces = self.cells[:, element.FACES].reshape(-1, 4)
        _, first, count = np.unique(
            np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
        )
        return faces[np.sort(first[count == 1])]

    @cached_property
    def free_faces(self):
        """(M, 4) where contact can act: the boundary faces of the loaded surface with a node that
        is not fixed."""
        faces = self.boundary_faces
        free = ~self.fixed[faces].all(axis=1)
        return faces[free if self.loaded is None else free & self.loaded[faces].all(axis=1)]

    def to_grid(self, values):
        """(..., N, C) nodal values on the regular node grid (..., nx, ny, nz, C), zero where there
        is no node."""
        self._need_grid()
        grid = np.zeros(
            (*values.shape[:-2], int(np.prod(self.grid_shape)), values.shape[-1]), values.dtype
        )
        grid[..., self.grid_index, :] = values
        return grid.reshape(*values.shape[:-2], *self.grid_shape, values.shape[-1])

    def from_grid(self, grid):
        """(..., nx, ny, nz, C) grid values at the nodes: (..., N, C)."""
        self._need_grid()
        if grid.shape[-4:-1] != tuple(self.grid_shape):
            raise InputError(
                f"a field on the grid {grid.shape[-4:-1]} does not fit this mesh's grid {self.grid_shape}"
            )
        return grid.reshape(*grid.shape[:-4], -1, grid.shape[-1])[..., self.grid_index, :]

    def _need_grid(self):
        if self.grid_shape is None:
            raise InputError(
                "this mesh has no regular node grid; embed it in one with fem.embedding.Embedding"
            )
