"""Between the nodes of a mesh and the node grid of the networks, and between SI and mm/mN.

`fem` computes in SI (m, N); datasets, networks and steppers speak mm and mN. These factors and this
change of axes stand here and nowhere else.
"""

from dataclasses import dataclass

import numpy as np

from fem.errors import InputError

MM = 1e3  # millimetres in a metre
MN = 1e3  # millinewtons in a newton


@dataclass(frozen=True, eq=False)
class NodeGrid:
    """The regular node grid of a mesh.

    shape: (nx, ny, nz) nodes; index: (N,) place of each mesh node in it, C order: node (i, j, k) is
    at (i * ny + j) * nz + k.
    """

    shape: tuple[int, int, int]
    index: np.ndarray

    @property
    def n_nodes(self) -> int:
        """Nodes of the mesh."""
        return len(self.index)

    def to_grid(self, values: np.ndarray) -> np.ndarray:
        """(..., N, C) nodal values as (..., nx, ny, nz, C), zero where there is no node."""
        grid = np.zeros(
            (*values.shape[:-2], int(np.prod(self.shape)), values.shape[-1]), values.dtype
        )
        grid[..., self.index, :] = values
        return grid.reshape(*values.shape[:-2], *self.shape, values.shape[-1])

    def from_grid(self, grid: np.ndarray) -> np.ndarray:
        """(..., nx, ny, nz, C) values on the grid at the mesh's nodes: (..., N, C)."""
        if grid.shape[-4:-1] != tuple(self.shape):
            raise InputError(
                f"a field on the grid {grid.shape[-4:-1]} does not fit this mesh's grid {self.shape}"
            )
        return grid.reshape(*grid.shape[:-4], -1, grid.shape[-1])[..., self.index, :]

    def is_nodal(self, field: np.ndarray) -> bool:
        """Whether a force or displacement is given node by node, (N, 3), and not on the grid, (nx,
        ny, nz, 3).

        Raises InputError for another shape, a type that is no real number, and values that are not
        finite.
        """
        field = np.asarray(field)
        nodal = field.shape == (self.n_nodes, 3)
        if not nodal and field.shape != (*self.shape, 3) or field.dtype.kind not in "fiu":
            raise InputError(
                f"the field is {field.dtype} of shape {field.shape};"
                f" give real numbers of shape {(self.n_nodes, 3)} or {(*self.shape, 3)}"
            )
        if not np.isfinite(field).all():
            place = tuple(int(n) for n in np.argwhere(~np.isfinite(field))[0])
            raise InputError(f"the field is {field[place]} at {place}; give finite values")
        return nodal
