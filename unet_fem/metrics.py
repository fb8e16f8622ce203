"""The one relative L2 error, in NumPy alone."""

import numpy as np

from fem.errors import InputError


def relative_l2(prediction: np.ndarray, truth: np.ndarray) -> float | None:
    """sqrt(sum |prediction - truth|^2 / sum |truth|^2) over all entries; None where the truth is
    zero throughout. Raises InputError for two shapes."""
    if np.shape(prediction) != np.shape(truth):
        raise InputError(
            f"a prediction of shape {np.shape(prediction)} is none of a truth of {np.shape(truth)}"
        )
    return relative_l2_of_sums(squares(prediction - truth), squares(truth))


def squares(values: np.ndarray) -> float:
    """The sum of the squares of `values`, in float64."""
    return float(np.sum(np.square(values, dtype=float)))


def relative_l2_of_sums(error: float, truth: float) -> float | None:
    """The same from the sum of squared errors and the sum of squares of the truth."""
    return float(np.sqrt(error / truth)) if truth > 0 else None
