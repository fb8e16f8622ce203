"""What a guard goes by, from interactions that nothing was learned from."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy.optimize
import scipy.sparse

from fem.data.dataset import Sequence
from unet_fem.deployment.answers import muted
from unet_fem.runtime.constitutive import ConstitutiveSurrogate
from unet_fem.runtime.guard import ALARM
from unet_fem.runtime.modal import ModalSurrogate

COVERAGE = 0.92  # of frames, for nine of ten of other interactions: frames of one are alike
FAR = 0.99
LEAST = 0.05  # mm, |u| over all nodes, below which no share of it is asked for


class Coverage(NamedTuple):
    """Shares of frames: within the bound, flagged, and those that err by more than ALARM without
    being flagged."""

    covered: float
    flagged: float
    silent: float


def watched(
    surrogate: ConstitutiveSurrogate | ModalSurrogate, sequences: Iterable[Sequence]
) -> tuple[np.ndarray, np.ndarray]:
    """(features (S, 4), relative errors (S,)) of the frames of some interactions."""
    found = [(surrogate.guard.features, error) for error in _errors(surrogate, sequences)]
    features, errors = zip(*found, strict=True)
    return np.array(features), np.array(errors)


def coverage(surrogate: ConstitutiveSurrogate, sequences: Iterable[Sequence]) -> Coverage:
    """How the guard does on the frames of some interactions."""
    found = np.array(
        [(e, surrogate.bound, surrogate.flagged) for e in _errors(surrogate, sequences)]
    )
    errors, bounds, flagged = found.T
    silent = (errors > ALARM) & (flagged == 0)
    return Coverage(*(float(np.mean(some)) for some in (errors <= bounds, flagged, silent)))


def _errors(surrogate, sequences):
    """The relative error of one frame after the other, of those that are not next to nothing."""
    for one in sequences:
        surrogate.reset()
        steps = zip(np.diff(one.time), one.force[1:], one.displacement[1:], strict=True)
        for dt, force, truth in steps:
            with muted():
                found = surrogate.step(force, float(dt))
            size = float(np.linalg.norm(truth))
            if size > LEAST:
                yield float(np.linalg.norm(found - truth)) / size


def fitted_guard(features: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(5,) of unet_fem.runtime.guard.Guard: weights by conformalized quantile regression (Romano,
    Patterson and Candes, NeurIPS 2019), the linear quantile COVERAGE of the errors from every other
    frame, times the factor that covers as many of the rest; and the size that FAR of the frames do
    not exceed, beyond which there is too little to fit to.

    What the modes miss of the force counts in full, for no frame of the data can tell its weight.
    """
    learned, kept = slice(0, None, 2), slice(1, None, 2)
    weights = np.insert(_quantile(features[learned], errors[learned]), 1, 1.0)
    ratio = errors[kept] / np.maximum(features[kept] @ weights, 1e-12)
    n = len(ratio)
    level = min(np.ceil((n + 1) * COVERAGE) / n, 1.0)
    weights = weights * np.quantile(ratio, level, method="higher")
    return np.append(weights, np.quantile(features[:, 3], FAR))


def _quantile(features, errors):
    """Non-negative weights of all features but `missing`: the pinball loss, of errors relative to
    their size, is least."""
    columns, wanted = features[:, [0, 2, 3]], errors - features[:, 1]
    n = len(wanted)
    scale = 1 / (errors + np.median(errors))
    cost = np.concatenate([np.zeros(3), COVERAGE * scale, (1 - COVERAGE) * scale])
    unit = scipy.sparse.eye_array(n)
    rows = scipy.sparse.hstack([scipy.sparse.csr_array(columns), unit, -unit])
    return scipy.optimize.linprog(cost, A_eq=rows, b_eq=wanted, method="highs").x[:3]
