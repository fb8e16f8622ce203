"""Fields at the nodes of a mesh as the networks see them: on its node grid, or on that of its
embedding.

What the grid itself does, and the units, are in fem.online.grid.
"""

import numpy as np

from fem.errors import InputError
from fem.mesh.embedding import Embedding
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import NodeGrid


def grid_of(mesh: HexMesh) -> NodeGrid:
    """The node grid of `mesh`. Raises InputError if it has none."""
    if mesh.grid is None:
        raise InputError(
            "this mesh lies on no regular node grid; embed it in one with"
            " fem.mesh.embedding.Embedding"
        )
    return mesh.grid


def force_on_grid(mesh: HexMesh, embedding: Embedding | None, force: np.ndarray) -> np.ndarray:
    """Nodal forces (..., N, 3) of `mesh` on the grid: (..., nx, ny, nz, 3)."""
    if embedding is None:
        return grid_of(mesh).to_grid(force)
    return grid_of(embedding.grid_mesh).to_grid(embedding.force_to_grid(force))


def displacement_on_grid(
    mesh: HexMesh, embedding: Embedding | None, displacement: np.ndarray
) -> np.ndarray:
    """Nodal displacement (..., N, 3) of `mesh` on the grid: (..., nx, ny, nz, 3)."""
    if embedding is None:
        return grid_of(mesh).to_grid(displacement)
    return grid_of(embedding.grid_mesh).to_grid(embedding.displacement_to_grid(displacement))


def displacement_from_grid(
    mesh: HexMesh, embedding: Embedding | None, field: np.ndarray
) -> np.ndarray:
    """Displacement on the grid (..., nx, ny, nz, 3) at the nodes of `mesh`: (..., N, 3)."""
    if embedding is None:
        return grid_of(mesh).from_grid(field)
    return embedding.to_mesh(grid_of(embedding.grid_mesh).from_grid(field))
