"""The stiffness of a mesh at rest, and the displacement that unit forces on some nodes give by
it."""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.solver.internal_force import InternalForce

STRAIN = 1e-4  # of the differences: their error is its square, and rounding over it
LARGEST = 2**30  # bytes of a compliance
BLOCK = 32  # forces that are solved for at once


def stiffness_at_rest(
    mesh: HexMesh,
    material: Hyperelastic,
    element: str = "full",
    hourglass_stiffness: float = 0.2,
) -> scipy.sparse.csc_matrix:
    """K, (3 N, 3 N) N/m, of the elastic law at rest, component by component: row c N + n.

    By central differences of the internal force: nodes that share no neighbour are moved at once,
    so that the work is some hundred evaluations for any mesh, element and law. K is symmetric to
    their error, 1e-8, and made so.
    """
    force = InternalForce(mesh, material.elastic(), element, "float64", hourglass_stiffness)
    n = mesh.n_nodes
    corner = np.repeat(np.arange(mesh.n_cells), 8)
    of_cells = scipy.sparse.csr_matrix(
        (np.ones(corner.size), (mesh.cells.ravel(), corner)), (n, mesh.n_cells)
    )
    near = (of_cells @ of_cells.T).tocsr()  # nodes that share a cell
    step = STRAIN * float(np.min(np.ptp(mesh.points[mesh.cells], axis=1)))  # m
    rows, columns, values = [], [], []
    for group in _apart((near @ near).tocsr()):
        moved = near[:, group].tocoo()
        at, by = moved.row, group[moved.col]  # each node beside at most one of the group
        for c in range(3):
            u = np.zeros((3, n))
            u[c, group] = step
            slope = (force(u) - force(-u)) / (2 * step)
            for row in range(3):
                rows.append(row * n + at)
                columns.append(c * n + by)
                values.append(slope[row, at])
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    K = scipy.sparse.csc_matrix(entries, (3 * n, 3 * n))
    return (K + K.T) / 2


def _apart(near):
    """Groups of nodes of which no two are `near` each other: every node takes the first group that
    none of those near it has."""
    colour = np.full(near.shape[0], -1)
    for node in range(near.shape[0]):
        taken = set(colour[near.indices[near.indptr[node] : near.indptr[node + 1]]])
        colour[node] = next(c for c in range(len(taken) + 1) if c not in taken)
    return [np.flatnonzero(colour == c) for c in range(colour.max() + 1)]


def compliance(
    mesh: HexMesh,
    material: Hyperelastic,
    nodes: np.ndarray,
    element: str = "full",
    hourglass_stiffness: float = 0.2,
) -> np.ndarray:
    """(n, 3, N, 3) m/N: the displacement of all nodes under a unit force on each of `nodes` (n,)
    in each direction, by the stiffness at rest; fixed nodes stay.

    Raises InputError where it would not fit into memory.
    """
    n = mesh.n_nodes
    if (size := 72 * len(nodes) * n) > LARGEST:
        raise InputError(
            f"the elastic answer to forces on {len(nodes)} of {n} nodes takes"
            f" {size / 2**30:.1f} GiB; take a coarser mesh, or fewer loaded nodes"
        )
    free = np.flatnonzero(np.tile(~mesh.fixed, 3))
    K = stiffness_at_rest(mesh, material, element, hourglass_stiffness)[free][:, free].tocsc()
    factors = scipy.sparse.linalg.splu(
        K, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    place = np.full(3 * n, -1)
    place[free] = np.arange(free.size)
    loaded = place[(np.asarray(nodes)[:, None] + n * np.arange(3)).ravel()]  # -1 of fixed nodes
    result = np.zeros((len(loaded), 3 * n))
    for start in range(0, len(loaded), BLOCK):
        unit = np.zeros((free.size, BLOCK))
        for column, row in enumerate(loaded[start : start + BLOCK]):
            unit[row, column] = row >= 0
        moved = factors.solve(unit).T[: len(loaded) - start]
        result[start : start + len(moved), free] = moved
    return result.reshape(len(nodes), 3, 3, n).swapaxes(2, 3)
