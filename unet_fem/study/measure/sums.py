"""Errors of fields over whole interactions, by the sums of squares of each."""

from collections.abc import Iterable, Mapping

import numpy as np

from fem.data.dataset import Dataset

Sums = dict[int, list[float]]  # {number of an interaction: [error, truth] in mm2}


def sums_of_squares(displacement: np.ndarray, truth: np.ndarray, dataset: Dataset) -> list[float]:
    """[error, truth]: sums over frames and free nodes of squared distances in mm2, fields (frames,
    nx, ny, nz, 3) mm."""
    truth = truth[:, dataset.free].astype(float)
    return [
        float(np.sum(np.square(displacement[:, dataset.free] - truth))),
        float(np.sum(np.square(truth))),
    ]


def relative_l2(sums: Sums, numbers: Iterable[int]) -> float | None:
    """sqrt(sum error / sum truth) over the interactions `numbers` that `sums` has; None if it has
    none."""
    pairs = np.array([sums[number] for number in numbers if number in sums])
    return float(np.sqrt(pairs[:, 0].sum() / pairs[:, 1].sum())) if len(pairs) else None


def distance(
    fields: Mapping[int, np.ndarray | None],
    truth: Mapping[int, np.ndarray | None],
    dataset: Dataset,
) -> dict:
    """{"numbers", "relative_l2"}: of the {number: field} to the truth, over the interactions that
    did not stop in either."""
    sums = {
        number: sums_of_squares(own, field, dataset)
        for number, field in truth.items()
        if field is not None and (own := fields[number]) is not None
    }
    return {"numbers": list(sums), "relative_l2": relative_l2(sums, list(sums))}
