"""The faces around the volume that the loss watches; without Keras, so that it is vetted before."""

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.mesh.places import boundary_faces


def volume_surface(dataset: Dataset, volume_of: str = "all") -> tuple[np.ndarray, np.ndarray]:
    """(points (nx*ny*nz, 3) mm, faces (M, 4)) of losses.deformed_volume around all cells of a
    dataset's grid, or around the cell set that `volume_of` names.

    Raises InputError for a mesh without that set, or without places of its nodes on the grid.
    """
    if volume_of == "all":
        return dataset.surface
    mesh = dataset.fem_mesh
    chosen, index = mesh.cell_sets.get(volume_of), mesh.grid_index
    if chosen is None or not chosen.any() or index is None:
        have = ", ".join(mesh.cell_sets) or "none"
        raise InputError(
            f"loss.volume_of = '{volume_of}', but the mesh of {dataset.path} has the cell sets"
            f" {have}{' and does not lie on the node grid' * (index is None)}; set it to 'all'"
        )
    return dataset.surface[0], index[boundary_faces(mesh.cells[chosen])]
