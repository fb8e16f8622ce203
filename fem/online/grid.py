"""Between the nodes of a mesh and the node grid of the networks, and between SI and mm/mN.

`fem` computes in SI (m, N); datasets, networks and steppers speak mm and mN. These factors and this
change of axes stand here and nowhere else.
"""

import operator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fem.errors import InputError

MM = 1e3  # millimetres in a metre
MN = 1e3  # millinewtons in a newton


@dataclass(frozen=True, eq=False)
class NodeGrid:
    """The regular node grid of a mesh.

    shape: (nx, ny, nz) nodes; index: (N,) place of each mesh node in it, C order: node (i, j, k) is
    at (i * ny + j) * nz + k. Raises InputError for places outside the grid, or taken twice.
    """

    shape: tuple[int, ...]
    index: np.ndarray

    def __post_init__(self) -> None:
        try:
            shape, index = tuple(map(operator.index, self.shape)), np.array(self.index)
        except (TypeError, ValueError):
            raise InputError(f"a node grid of shape {self.shape!r} needs whole numbers") from None
        if len(shape) != 3 or min(shape) < 1:
            raise InputError(f"a node grid of shape {shape} needs three positive numbers of nodes")
        if index.ndim != 1 or index.dtype.kind not in "iu":
            raise InputError(
                f"the node grid's index is {index.dtype} of shape {index.shape};"
                " give one whole number a node"
            )
        outside = index[(index < 0) | (index >= np.prod(shape))]
        if outside.size:
            raise InputError(
                f"the node grid's index holds {outside[0]}, but a grid {shape} has the places"
                f" 0 to {np.prod(shape) - 1}"
            )
        if len(np.unique(index)) != len(index):
            place, count = np.unique(index, return_counts=True)
            raise InputError(
                f"the node grid's index holds {place[count > 1][0]} twice; give each node a place"
                " of its own"
            )
        index = index.astype(np.intp)
        index.flags.writeable = False
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "index", index)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, NodeGrid)
            and self.shape == other.shape
            and np.array_equal(self.index, other.index)
        )

    def __hash__(self) -> int:
        return hash((self.shape, self.index.tobytes()))

    @property
    def n_nodes(self) -> int:
        """Nodes of the mesh."""
        return len(self.index)

    @cached_property
    def mask(self) -> np.ndarray:
        """(nx, ny, nz) bool: the places that a node takes."""
        return self.to_grid(np.ones((self.n_nodes, 1), bool))[..., 0]

    def to_grid(self, values: np.ndarray) -> np.ndarray:
        """(..., N, C) nodal values as (..., nx, ny, nz, C), zero where there is no node."""
        if np.ndim(values) < 2 or values.shape[-2] != self.n_nodes:
            raise InputError(
                f"values of shape {np.shape(values)} do not fit {self.n_nodes} nodes;"
                " give (..., N, C)"
            )
        grid = np.zeros(
            (*values.shape[:-2], int(np.prod(self.shape)), values.shape[-1]), values.dtype
        )
        grid[..., self.index, :] = values
        return grid.reshape(*values.shape[:-2], *self.shape, values.shape[-1])

    def from_grid(self, grid: np.ndarray) -> np.ndarray:
        """(..., nx, ny, nz, C) values on the grid at the mesh's nodes: (..., N, C)."""
        if grid.shape[-4:-1] != tuple(self.shape):
            raise InputError(
                f"a field on the grid {grid.shape[-4:-1]} does not fit this mesh's grid"
                f" {self.shape}"
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
