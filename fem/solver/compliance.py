"""The displacement that unit forces on some nodes give by the stiffness at rest."""

import numpy as np

from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.solver.stiffness import Equations, Factors, Stiffness

LARGEST = 2**28  # bytes of a compliance; half as many in a file
BLOCK = 32  # forces that are solved for at once


def compliance(
    mesh: HexMesh,
    material: Hyperelastic,
    nodes: np.ndarray,
    element: str = "full",
    hourglass_stiffness: float = 0.2,
) -> np.ndarray:
    """(n, 3, N, 3) m/N: the displacement of all nodes under a unit force on each of `nodes` (n,)
    in each direction, of the elastic law at rest; fixed nodes stay.

    Raises InputError where it would not fit into memory.
    """
    size = 72 * len(nodes) * mesh.n_nodes
    if size > LARGEST:
        raise InputError(
            f"the elastic answer to forces on {len(nodes)} of {mesh.n_nodes} nodes takes"
            f" {size / 2**20:.0f} MiB; take a coarser mesh, or fewer loaded nodes"
        )
    equations = Equations(mesh)
    stiffness = Stiffness(mesh, material.elastic(), element, hourglass_stiffness, equations)
    factors = Factors(stiffness.matrix(np.zeros(equations.shape)), "float64")
    number = (
        equations.field(np.arange(1.0, equations.size + 1)).astype(int) - 1
    )  # -1 of fixed nodes
    loaded = number[:, nodes].T.ravel()
    result = np.zeros((len(loaded), 3, mesh.n_nodes))
    for start in range(0, len(loaded), BLOCK):
        some = loaded[start : start + BLOCK]
        unit = np.zeros((equations.size, len(some)))
        unit[some, range(len(some))] = some >= 0
        for row, moved in enumerate(factors.solve(unit).T, start):
            result[row] = equations.field(moved)
    return result.reshape(len(nodes), 3, 3, -1).swapaxes(2, 3)
