"""Ridge regression in closed form, without an intercept: no force, no displacement."""

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from fem.errors import InputError

RIDGES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # chosen from on the validation data


def fit(
    X: np.ndarray,
    Y: np.ndarray,
    ridges: float | Sequence[float],
    validation: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, float]:
    """(kernel (p, q), ridge): W = (X^T X + ridge s I)^-1 X^T Y = X^T (X X^T + ridge s I)^-1 Y, by
    whichever matrix is smaller.

    X: (S, p), Y: (S, q) float64. s: the largest eigenvalue of X^T X. ridges: fractions of s;
    several cost one eigendecomposition, and the best on validation = (X, Y) is kept. Raises
    InputError if several come without validation.
    """
    shares = np.atleast_1d(ridges).tolist()
    if len(shares) > 1 and validation is None:
        raise InputError(
            f"{len(shares)} values of ridge and nothing to choose by; give validation or one value"
        )
    dual = len(X) < X.shape[1]
    values, vectors = scipy.linalg.eigh(X @ X.T if dual else X.T @ X)
    basis = X.T @ vectors if dual else vectors  # (p, r)
    target = vectors.T @ (Y if dual else X.T @ Y)  # (r, q)
    keep = values > values[-1] * len(values) * np.finfo("float64").eps  # the rest is rounding
    values, basis, target = values[keep], basis[:, keep], target[keep]

    def coefficients(ridge):
        return target / (values + ridge * values[-1])[:, None]

    if validation is not None and len(shares) > 1:
        reduced, truth = validation[0] @ basis, validation[1]
        ridge = min(shares, key=lambda r: np.sum((reduced @ coefficients(r) - truth) ** 2))
    else:
        ridge = shares[0]
    return basis @ coefficients(ridge), ridge
