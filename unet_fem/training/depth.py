"""Errors by the depth below the loaded surface."""

import numpy as np

from fem.data.dataset import Dataset
from unet_fem.metrics import relative_l2_of_sums


def node_distance(dataset: Dataset, a: np.ndarray, b: np.ndarray | float = 0.0) -> np.ndarray:
    """|a - b| at the free nodes, (S, n) mm."""
    return np.linalg.norm((a - b)[:, dataset.free], axis=-1)


def normalised_depth(dataset: Dataset) -> np.ndarray:
    """0 in the highest layer of the grid that holds material, 1 in the deepest, for every free node
    (n,)."""
    layers = np.flatnonzero(dataset.mask.any(axis=(0, 1)))
    return (layers[-1] - np.argwhere(dataset.free)[:, 2]) / (layers[-1] - layers[0])


def by_depth(dataset: Dataset, field: np.ndarray, truth: np.ndarray) -> dict[str, list]:
    """{"depth": 0 in the loaded layer to 1, "mean_mm", "relative_l2"}: errors of a field (S, nx,
    ny, nz, 3) mm over each layer's free nodes.

    relative_l2 is None in a layer where the truth does not move.
    """
    error, size = node_distance(dataset, field, truth), node_distance(dataset, truth)
    depth = normalised_depth(dataset).round(6)
    layers = np.unique(depth)
    rows = [depth == layer for layer in layers]
    squares = [
        [np.sum(values[:, row] ** 2, dtype=float) for values in (error, size)] for row in rows
    ]
    return {
        "depth": layers.tolist(),
        "mean_mm": [float(error[:, row].mean(dtype=float)) for row in rows],
        "relative_l2": [relative_l2_of_sums(*pair) for pair in squares],
    }
