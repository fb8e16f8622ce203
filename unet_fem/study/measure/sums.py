"""Errors of fields over whole interactions, by the sums of squares of each."""

from collections.abc import Iterable, Mapping

import numpy as np

from fem.data.dataset import Dataset
from unet_fem.study.dataset import Case, name_of

Sums = dict[str, list[float]]  # {name of an interaction: [error, truth] in mm2}


def sums_of_squares(displacement: np.ndarray, truth: np.ndarray, dataset: Dataset) -> list[float]:
    """[error, truth]: sums over frames and free nodes of squared distances in mm2, fields (frames,
    nx, ny, nz, 3) mm."""
    truth = truth[:, dataset.free].astype(float)
    return [
        float(np.sum(np.square(displacement[:, dataset.free] - truth))),
        float(np.sum(np.square(truth))),
    ]


def relative_l2(sums: Sums, names: Iterable[str]) -> float | None:
    """sqrt(sum error / sum truth) over the interactions `names` that `sums` has; None if it has
    none."""
    pairs = np.array([sums[name] for name in names if name in sums])
    return float(np.sqrt(pairs[:, 0].sum() / pairs[:, 1].sum())) if len(pairs) else None


def distance(
    fields: Mapping[Case, np.ndarray | None],
    truth: Mapping[Case, np.ndarray | None],
    dataset: Dataset,
) -> dict:
    """{"cases": names, "relative_l2"}: of the {case: field} to the truth, over the interactions
    that did not stop in either."""
    sums = {
        name_of(case): sums_of_squares(own, field, dataset)
        for case, field in truth.items()
        if field is not None and (own := fields[case]) is not None
    }
    return {"cases": list(sums), "relative_l2": relative_l2(sums, sums)}
