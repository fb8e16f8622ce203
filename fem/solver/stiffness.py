"""The stiffness of a mesh, consistent with its internal force, and its factors."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.solver.internal_force import InternalForce

STEP = 6e-6  # of a central difference, in edges of a cell: the cube root of float64's rounding
LEAF = 12  # nodes that are not dissected any further


class Equations:
    """The equations of a mesh's free displacements, numbered so that factors stay sparse.

    nodes: the free nodes in that order; size: of a vector, three of each
    """

    def __init__(self, mesh: HexMesh) -> None:
        self.nodes, self.shape = dissection(mesh), (3, mesh.n_nodes)
        self.size = 3 * len(self.nodes)

    def vector(self, field: np.ndarray) -> np.ndarray:
        """(size,) of a nodal field (3, N)."""
        return field.take(self.nodes, axis=1).T.ravel()

    def field(self, vector: np.ndarray) -> np.ndarray:
        """(3, N) of a vector, zero at held nodes."""
        field = np.zeros(self.shape)
        field[:, self.nodes] = vector.reshape(-1, 3).T
        return field

    def of_cells(self, mesh: HexMesh) -> np.ndarray:
        """(24, E) the equations of each cell's displacements, (3, 8) in turn; -1 of held nodes."""
        number = np.full(self.shape, -1)
        number[:, self.nodes] = np.arange(self.size).reshape(-1, 3).T
        return number[:, mesh.cells].transpose(0, 2, 1).reshape(24, mesh.n_cells)


class Stiffness:
    """df/du of an internal force on the free nodes, by central differences cell by cell.

    In the torn mesh, in which no two cells share a node, one call gives the forces of all cells,
    and 24 pairs of calls their stiffness: of any law and element, hourglass control and mean
    dilatation included. See fem.solver.internal_force.InternalForce for the options.

    force: of the torn mesh; its stress history is that of the stiffness
    """

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        element: str,
        hourglass_stiffness: float,
        equations: Equations,
    ) -> None:
        corners = mesh.points[mesh.cells]  # (E, 8, 3)
        torn = HexMesh(
            corners.reshape(-1, 3),
            np.arange(mesh.cells.size).reshape(-1, 8),
            np.zeros(mesh.cells.size, bool),
        )
        self.cells, self.size = mesh.cells, equations.size
        self.force = InternalForce(torn, material, element, "float64", hourglass_stiffness)
        self.step = STEP * np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).min()
        of_cells = equations.of_cells(mesh)
        rows, columns = np.broadcast_arrays(of_cells[:, None], of_cells[None])
        self._inside = (rows >= 0) & (columns >= 0)  # (24, 24, E)
        self._places = rows[self._inside], columns[self._inside]

    def follow(
        self, force: InternalForce, elapsed: float, bends: Sequence[np.ndarray | None]
    ) -> None:
        """Be the stiffness at the end of the step that `force`, of the whole mesh, expects; see
        InternalForce.expect."""
        self.force.restore(force.state())
        self.force.expect(elapsed, [None if u is None else self._torn(u) for u in bends])

    def _torn(self, u):
        """The displacement (3, N) on the torn mesh."""
        return np.ascontiguousarray(u[:, self.cells].reshape(3, -1))

    def matrix(self, u: np.ndarray) -> scipy.sparse.csc_matrix:
        """The stiffness (size, size) in N/m at the displacement u (3, N) m."""
        torn = self._torn(u)
        entries = np.empty((24, 24, len(self.cells)))
        for c, a in np.ndindex(3, 8):
            middle = torn[c, a::8].copy()
            torn[c, a::8] = middle + self.step
            column = self.force(torn)
            torn[c, a::8] = middle - self.step
            column -= self.force(torn)
            torn[c, a::8] = middle
            entries[:, 8 * c + a] = column.reshape(3, -1, 8).swapaxes(1, 2).reshape(24, -1)
        entries /= 2 * self.step
        return scipy.sparse.coo_matrix(
            (entries[self._inside], self._places), (self.size, self.size)
        ).tocsc()


class Factors:
    """The factors of a stiffness, ready to solve with. Raises RuntimeError where it is singular.

    precision: "float32" is enough where a residual corrects what is solved, and a third faster
    """

    def __init__(self, matrix: scipy.sparse.csc_matrix, precision: str = "float32") -> None:
        # the equations are in a good order already, and pivots stay on the diagonal
        self._lu = scipy.sparse.linalg.splu(
            matrix.astype(precision),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        self._precision = precision

    def solve(self, force: np.ndarray) -> np.ndarray:
        """The free displacements (size,) in m under the force (size,) in N, float64."""
        return self._lu.solve(force.astype(self._precision)).astype(float)


class Rest(NamedTuple):
    """The equations of a mesh, and the factors of its stiffness at rest without relaxation."""

    equations: Equations
    factors: Factors


@functools.lru_cache(maxsize=4)
def at_rest(
    mesh: HexMesh, material: Hyperelastic, element: str, hourglass_stiffness: float
) -> Rest:
    """The Rest of a mesh, made once in a process. Raises InputError for a body that can move
    without force."""
    equations = Equations(mesh)
    stiffness = Stiffness(mesh, material.elastic(), element, hourglass_stiffness, equations)
    matrix = stiffness.matrix(np.zeros(equations.shape))
    try:
        factors = Factors(matrix)
        again = factors.solve(matrix @ np.ones(equations.size))
    except RuntimeError:
        again = np.zeros(1)
    if not np.abs(again - 1).max() < 1e-3:
        raise InputError(
            "the mesh can move without force, so that no displacement belongs to a load; hold more"
            " of its nodes, or give solver.hourglass_stiffness above 0"
        )
    return Rest(equations, factors)


def dissection(mesh: HexMesh) -> np.ndarray:
    """The free nodes in the order of a nested dissection (George 1973): the halves of the body on
    either side of a layer of nodes, and the layer last, so that eliminating a half fills nothing
    in the other."""
    free = np.flatnonzero(~mesh.fixed)
    pairs = mesh.cells[:, :, None], mesh.cells[:, None, :]
    rows, columns = (part.ravel() for part in np.broadcast_arrays(*pairs))
    near = scipy.sparse.csr_matrix(
        (np.ones(rows.size, np.int8), (rows, columns)), (mesh.n_nodes,) * 2, dtype=bool
    )
    return np.concatenate(_dissected(free, mesh.points, near) or [free])


def _dissected(nodes, points, near):
    """`nodes` as a list of arrays: halves dissected in turn, then what parts them."""
    if len(nodes) <= LEAF:
        return [nodes]
    axis = np.ptp(points[nodes], axis=0).argmax()
    x = points[nodes, axis]
    below = x < np.median(x)
    if not below.any():
        return [nodes]
    parting = below & np.isin(nodes, near[nodes[~below]].indices)
    low, high = nodes[below & ~parting], nodes[~below]
    return [*_dissected(low, points, near), *_dissected(high, points, near), nodes[parting]]
