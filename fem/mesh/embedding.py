"""A mesh without a node grid of its own, embedded in one: a regular grid over its bounding box
carries the fields.

A is the trilinear interpolation from the grid to the mesh's nodes. Displacement goes to the grid as
the field g that meets it best, and smoothly where the mesh leaves the grid free; forces go by the
transpose, so that total force and virtual work are kept exactly:

    u -> g = argmin |A g - u|^2 + s |D g|^2      g -> A g      f -> A^T f,   (A^T f) . g = f . (A g)

with D the second differences along the grid's lines: what the mesh does not determine goes on
linearly.
"""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fem.errors import InputError
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.mesh.node_grid import turn
from fem.online.grid import NodeGrid

# s above; less would meet the mesh better and run wild beside it (measured on configs/lobe.toml)
SMOOTHING = 1e-3
SMALLEST_GRID = (4, 4, 3)  # nodes; what the CNN-LSTM needs
UNIT = ((element.CORNERS + 1) / 2).astype(int)  # (8, 3) corners of a grid cell, in VTK order


class Embedding:
    """The node grid `shape` around the HexMesh `mesh`, its third axis along the mean outward normal
    of the loaded surface.

    shape: (nx, ny, nz) nodes, along the grid's axes; None makes grid cells about as large as the
    mesh's
    grid_mesh: HexMesh (m) of the grid nodes that carry material. Its cells are the fullest ones
    that together have the
        mesh's volume; its nodes are those of every cell that holds some material. Fixed are those
        that only fixed nodes of the mesh depend on.

    Raises InputError for a grid of fewer than 2 nodes along an axis.
    """

    def __init__(self, mesh: HexMesh, shape: tuple[int, int, int] | None = None) -> None:
        self.mesh = mesh
        self.turn = turn(_main_axis(mesh), np.eye(3))
        points = mesh.points @ self.turn.T  # (N, 3) along the grid's axes
        low, extent = points.min(axis=0), np.ptp(points, axis=0)
        if shape is None:
            edge = (mesh.volume() / mesh.n_cells) ** (1 / 3)
            shape = np.maximum(np.rint(extent / edge).astype(int) + 1, SMALLEST_GRID)
        self.shape = tuple(int(n) for n in shape)
        if min(self.shape) < 2:
            raise InputError(
                f"mesh.grid = {list(self.shape)} must have at least 2 nodes along each axis; 17,"
                " 17, 8 is the paper's"
            )
        spacing = extent / (np.array(self.shape) - 1)
        places = (points - low) / spacing  # (N, 3) in cells of the grid
        weights = _interpolation(places, self.shape)
        self._corners = places[mesh.cells]  # (E, 8, 3)
        filled = self.filled()
        by_fill = np.argsort(-filled, kind="stable")
        cells = _cells(self.shape)  # (C, 8) every cell of the grid
        count = max(1, round(filled.sum()))
        index = np.union1d(
            cells[filled > 0], np.unique(weights.indices)
        )  # (n,) grid nodes that carry material
        self.to_mesh_matrix = weights[:, index]  # A
        grid_points = np.stack(np.unravel_index(index, self.shape), axis=1) * spacing + low
        reach = (self.to_mesh_matrix != 0).T
        fixed = (reach @ mesh.fixed.astype(int) > 0) & (reach @ (~mesh.fixed).astype(int) == 0)
        kept = np.searchsorted(index, cells[np.sort(by_fill[:count])])
        self.grid_mesh = HexMesh(grid_points @ self.turn, kept, fixed, NodeGrid(self.shape, index))
        self._free = ~fixed
        self._rows = self.to_mesh_matrix[:, self._free]
        D = _second_differences(self.shape)[:, index]
        whole = (
            np.asarray((D != 0).sum(axis=1)).ravel() == 3
        )  # lines of three nodes that all carry material
        D = D[whole][:, self._free]
        # the last term keeps a node that nothing determines at rest
        normal = (
            self._rows.T @ self._rows
            + SMOOTHING * (D.T @ D)
            + 1e-10 * scipy.sparse.identity(self._rows.shape[1])
        )
        self._solve = scipy.sparse.linalg.factorized(normal.tocsc())

    def filled(self, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Share (C,) of each grid cell's volume that the mesh, or some `cells` of it, fills."""
        return _filled(self._corners[cells], self.shape)

    def displacement_to_grid(self, u: np.ndarray) -> np.ndarray:
        """Values (..., N, 3) at the mesh's nodes as values (..., n, 3) at the nodes of grid_mesh,
        zero where it is fixed."""
        columns = np.moveaxis(u, -2, 0).reshape(u.shape[-2], -1)  # (N, ...*3)
        grid = np.zeros((len(self._free), columns.shape[1]))
        grid[self._free] = self._solve(self._rows.T @ columns.astype(float))
        return self._back(grid, u)

    def force_to_grid(self, f: np.ndarray) -> np.ndarray:
        """Nodal forces (..., N, 3) of the mesh as nodal forces (..., n, 3) of grid_mesh: A^T f."""
        return self._back(self.to_mesh_matrix.T @ np.moveaxis(f, -2, 0).reshape(f.shape[-2], -1), f)

    def to_mesh(self, grid: np.ndarray) -> np.ndarray:
        """Values (..., n, 3) at the nodes of grid_mesh at the mesh's nodes: (..., N, 3)."""
        return self._back(
            self.to_mesh_matrix @ np.moveaxis(grid, -2, 0).reshape(grid.shape[-2], -1), grid
        )

    @staticmethod
    def _back(columns, like):
        return np.moveaxis(columns.reshape(-1, *like.shape[:-2], like.shape[-1]), 0, -2).astype(
            like.dtype
        )


def _main_axis(mesh):
    """The axis, +-x, y or z as three integers, that the loaded surface mostly faces."""
    a, b, c, d = np.moveaxis(mesh.points[mesh.free_faces], 1, 0)
    area = np.cross(c - a, d - b).sum(axis=0)
    axis = np.zeros(3, int)
    axis[np.abs(area).argmax()] = np.sign(area[np.abs(area).argmax()])
    if not axis.any():
        raise InputError(
            "the surface that can be pushed on faces all sides alike, and the grid needs one for"
            " its last layer; give mesh.loaded"
        )
    return axis


def _interpolation(places, shape):
    """Trilinear weights (N, nodes of the grid), sparse, at places (N, 3) in cells of the grid."""
    corner = np.clip(np.floor(places + 1e-9).astype(int), 0, np.array(shape) - 2)
    t = np.clip(places - corner, 0, 1)[:, None]  # (N, 1, 3)
    t = np.where(np.abs(t) < 1e-9, 0, t)
    weights = np.prod(np.where(UNIT, t, 1 - t), axis=2)  # (N, 8)
    nodes = np.ravel_multi_index(np.moveaxis(corner[:, None] + UNIT, -1, 0), shape)
    rows = np.repeat(np.arange(len(places)), 8)
    matrix = scipy.sparse.csr_matrix(
        (weights.ravel(), (rows, nodes.ravel())), (len(places), int(np.prod(shape)))
    )
    matrix.eliminate_zeros()
    return matrix


def _cells(shape):
    """(C, 8) grid nodes of every cell of the grid."""
    corner = np.indices([n - 1 for n in shape]).reshape(3, -1).T
    return np.ravel_multi_index(np.moveaxis(corner[:, None] + UNIT, -1, 0), shape)


def _filled(corners, shape):
    """Share (C,) of each grid cell that hexahedra with corner places (E, 8, 3) fill, by sampling
    them."""
    n = int(
        np.clip(np.ceil(4 * np.ptp(corners, axis=1).max()), 3, 12)
    )  # samples along an edge, about four a grid cell
    line = (np.arange(n) + 0.5) / n * 2 - 1
    where = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    filled = np.zeros(np.prod(np.array(shape) - 1))
    for point in where:
        shape_values = np.prod(1 + point * element.CORNERS, axis=1) / 8  # (8,)
        gradient = element.shape_gradients(point[None])[0]  # (3, 8)
        volume = np.linalg.det(np.einsum("ra,eai->eri", gradient, corners)) * (2 / n) ** 3
        cell = np.clip(np.floor(shape_values @ corners).astype(int), 0, np.array(shape) - 2)
        filled += np.bincount(
            np.ravel_multi_index(cell.T, np.array(shape) - 1), volume, filled.size
        )
    return filled


def _second_differences(shape):
    """(rows, nodes of the grid): g[i - 1] - 2 g[i] + g[i + 1] along every axis."""
    parts = []
    for axis, n in enumerate(shape):
        factors = [scipy.sparse.identity(m) for m in shape]
        factors[axis] = (
            scipy.sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], (n - 2, n))
            if n > 2
            else scipy.sparse.csr_matrix((0, n))
        )
        parts.append(scipy.sparse.kron(scipy.sparse.kron(*factors[:2]), factors[2]))
    return scipy.sparse.vstack(parts).tocsr()
