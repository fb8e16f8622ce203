"""Displacement on a section of the deformed tissue."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from fem.data.dataset import Dataset
from unet_fem.training.depth import node_distance
from unet_fem.training.samples import Samples
from unet_fem.training.style import styled, subplots


@styled()
def displacement_fields(
    dataset: Dataset, samples: Samples, model: tuple[str, np.ndarray]
) -> Figure:
    """FEM, prediction and difference on the section of the deformed tissue through the most
    displaced node."""
    name, field = model
    sample, j = most_displaced(dataset, samples)
    truth, found = samples.displacement[sample], field[sample]
    figure, axes = subplots(1, 3, (11, 2.6), sharey=True, sharex=True)
    limit = np.linalg.norm(truth[:, j], axis=-1).max()
    parts = ("FEM", truth, truth), (name, found, found), ("difference", truth, found - truth)
    for axis, (title, shape, values) in zip(axes, parts, strict=True):
        cells = draw_section(axis, dataset, j, shape, values, limit)
        axis.set(
            title=f"{title} (max {np.linalg.norm(values[:, j], axis=-1).max():.2f} mm)",
            xlabel="across (mm)",
        )
    axes[0].set_ylabel("up (mm)")
    figure.colorbar(cells, ax=axes, label="displacement (mm)", shrink=0.8)
    figure.suptitle(
        f"Test interaction {samples.interaction[sample]}, the largest displacement of all:"
        f" section {j + 1} of {dataset.grid[1]}; the difference is drawn on the FEM's shape"
    )
    return figure


def most_displaced(dataset: Dataset, samples: Samples) -> tuple[int, int]:
    """(sample, j) of the FEM's largest displacement: the section of the grid through that node, or
    the nearest that has cells."""
    distance = node_distance(dataset, samples.displacement)
    sample, node = np.unravel_index(distance.argmax(), distance.shape)
    # those with cells: an embedded mesh moves nodes beside it too
    layers = np.unique(np.unravel_index(dataset.cells, dataset.grid)[1])
    return int(sample), int(layers[np.abs(layers - np.argwhere(dataset.free)[node][1]).argmin()])


def draw_section(
    axis: Axes,
    dataset: Dataset,
    j: int,
    shape: np.ndarray,
    values: np.ndarray,
    limit: float,
) -> PolyCollection:
    """Section j of the tissue displaced by `shape`, coloured from 0 to `limit` by the size of
    `values`, both (nx, ny, nz, 3) mm.

    Returns the PolyCollection, which `move_section` changes.
    """
    cells = PolyCollection([], cmap="viridis", edgecolors="k", linewidths=0.2)
    move_section(cells, dataset, j, shape, values)
    cells.set_clim(0, limit)
    axis.add_collection(cells)
    axis.set_aspect("equal")
    axis.set_axisbelow(True)
    axis.autoscale_view()
    return cells


def move_section(
    cells: PolyCollection, dataset: Dataset, j: int, shape: np.ndarray, values: np.ndarray
) -> None:
    """Move and colour the cells that `draw_section` gave."""
    moved = (dataset.points + shape)[:, j].reshape(-1, 3) @ section_plane(dataset)  # (nx*nz, 2) mm
    quads = section_quads(dataset, j)
    cells.set_verts(moved[quads])
    cells.set_array(np.linalg.norm(values[:, j], axis=-1).ravel()[quads].mean(axis=1))


def section_plane(dataset: Dataset) -> np.ndarray:
    """(3, 2) unit vectors across and up: along the grid's first and third axes as they run on the
    whole (x and z for the tumour)."""

    def mean_step(axis):
        points, mask = np.moveaxis(dataset.points, axis, 0), np.moveaxis(dataset.mask, axis, 0)
        return (points[1:] - points[:-1])[mask[1:] & mask[:-1]].mean(axis=0)

    across, up = mean_step(0), mean_step(2)
    up = up - across * (across @ up) / (across @ across)
    return np.stack([across / np.linalg.norm(across), up / np.linalg.norm(up)], axis=1)


def section_quads(dataset: Dataset, j: int) -> np.ndarray:
    """(M, 4) corners, as indices into the (nx, nz) nodes of layer j, of the cell faces that lie in
    that layer."""
    nx, ny, nz = dataset.grid
    i, jj, k = np.unravel_index(dataset.cells, dataset.grid)  # (E, 8)
    flat = np.where(jj == j, i * nz + k, -1)
    faces = np.array([row[row >= 0] for row in flat if (row >= 0).sum() == 4])
    faces = np.unique(np.sort(faces, axis=1), axis=0)  # a layer inside has every face twice
    return faces[:, [0, 2, 3, 1]]  # sorted by x, then z: walk around
