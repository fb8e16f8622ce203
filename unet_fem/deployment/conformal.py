"""The weights of a guard, from interactions that nothing was learned from."""

from collections.abc import Iterable

import numpy as np
import scipy.optimize

from fem.data.dataset import Sequence
from unet_fem.deployment.answers import muted
from unet_fem.runtime.constitutive import ConstitutiveSurrogate

COVERAGE = 0.9
LEAST = 0.05  # mm, |u| over all nodes, below which no share of it is asked for


def watched(
    surrogate: ConstitutiveSurrogate, sequences: Iterable[Sequence]
) -> tuple[np.ndarray, np.ndarray]:
    """(features (S, 4), relative errors (S,)) of the frames of some interactions."""
    features, errors = [], []
    for one in sequences:
        surrogate.reset()
        for dt, force, truth in zip(
            np.diff(one.time), one.force[1:], one.displacement[1:], strict=True
        ):
            with muted():
                found = surrogate.step(force, float(dt))
            size = float(np.linalg.norm(truth))
            if size > LEAST:
                features.append(surrogate.guard.features)
                errors.append(float(np.linalg.norm(found - truth)) / size)
    return np.array(features), np.array(errors)


def guard_weights(features: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(4,) of unet_fem.runtime.guard.Guard, by split conformal prediction: an estimate from every
    other frame, and the factor that covers COVERAGE of the rest.

    What the modes miss of the force counts in full, for no frame of the data can tell its weight;
    the others are the non-negative least squares of the errors.
    """
    learned, kept = slice(0, None, 2), slice(1, None, 2)
    rest = np.maximum(errors - features[:, 1], 0)
    columns, scale = features[:, [0, 2, 3]], 1 / (errors + np.median(errors))
    share, _ = scipy.optimize.nnls(
        columns[learned] * scale[learned, None], rest[learned] * scale[learned]
    )
    estimate = np.array([share[0], 1.0, share[1], share[2]])
    ratio = errors[kept] / np.maximum(features[kept] @ estimate, 1e-12)
    n = len(ratio)
    level = min(np.ceil((n + 1) * COVERAGE) / n, 1.0)
    return estimate * np.quantile(ratio, level, method="higher")
