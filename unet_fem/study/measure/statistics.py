"""How sure the errors are: intervals over the test interactions by bootstrap, and the comparison
with and without the volume term.

Frames of one interaction are nearly equal, so whole interactions are drawn. The intervals are of
the mean over the seeds that were trained; how far the seeds differ is given beside it, since three
are too few to draw from.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import bootstrap

from unet_fem.study.runs import KERAS
from unet_fem.study.settings import Study

RESAMPLES = 9999
STRONG = 0.25  # share of the test interactions that count as strong, by their largest total force


def relative_l2(
    errors: Sequence[np.ndarray] | np.ndarray, truth: np.ndarray, axis: int = -1
) -> np.ndarray:
    """Mean over the seeds of sqrt(sum error / sum truth): errors a list of (..., I) mm2, one a
    seed; truth (..., I) mm2."""
    total = np.sum(truth, axis=axis)
    return np.mean([np.sqrt(np.sum(error, axis=axis) / total) for error in errors], axis=0)


def interval(errors: np.ndarray, truth: np.ndarray) -> dict:
    """{"relative_l2", "low", "high"}: over interactions, with the 95 % interval of drawing them
    with replacement.

    errors: (seeds, I) mm2, truth: (I,) mm2. low and high are None for fewer than two interactions.
    """
    return _bootstrap(
        lambda *sums, axis=-1: relative_l2(sums[:-1], sums[-1], axis),
        (*errors, truth),
        "relative_l2",
    )


def difference(errors: np.ndarray, base: np.ndarray, truth: np.ndarray) -> dict:
    """{"difference", "low", "high", "change"}: relative L2 less that of another model with `base`
    (seeds, I) mm2 on the same interactions.

    change: the difference as a share of the other model's error.
    """
    count = len(errors)

    def statistic(*sums, axis=-1):
        return relative_l2(sums[:count], sums[-1], axis) - relative_l2(
            sums[count:-1], sums[-1], axis
        )

    found = _bootstrap(statistic, (*errors, *base, truth), "difference")
    return found | {"change": found["difference"] / float(relative_l2(base, truth))}


def _bootstrap(statistic: Callable, data: tuple, name: str) -> dict:
    found = {name: float(statistic(*data)), "low": None, "high": None}
    if len(data[-1]) < 2:
        return found
    # percentiles, since the bias-corrected interval is undefined where two models answer alike
    settings = {
        "n_resamples": RESAMPLES,
        "batch": 500,
        "method": "percentile",
        "random_state": np.random.default_rng(1),
    }
    drawn = bootstrap(data, statistic, paired=True, vectorized=True, **settings)
    return found | {
        "low": float(drawn.confidence_interval.low),
        "high": float(drawn.confidence_interval.high),
    }


def subsets(accuracy: dict) -> dict[str, np.ndarray]:
    """{"test", "strong", "hard": rows of the test interactions}: all, the quarter with the largest
    forces, those beyond training."""
    numbers, force = np.array(accuracy["numbers"]), np.array(accuracy["force"])
    strong = np.sort(np.argsort(-force, kind="stable")[: max(1, round(STRONG * len(force)))])
    return {
        "test": np.arange(len(numbers)),
        "strong": strong,
        "hard": np.flatnonzero(np.isin(numbers, accuracy["hard"])),
    }


def sums(accuracy: dict, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """(errors (len(names), I), truth (I,)) in mm2 of models of the accuracy stage."""
    pairs = np.array([accuracy["models"][name]["sums"] for name in names])  # (M, I, 2)
    return pairs[..., 0], pairs[0, :, 1]


def intervals(accuracy: dict, names: list[str], base: list[str] | None = None) -> dict:
    """{"test", "strong", "hard": interval} of the models `names`, seeds of one another;
    "test_difference", ... to the models `base`."""
    errors, truth = sums(accuracy, names)
    rows = subsets(accuracy)
    found = {which: interval(errors[:, some], truth[some]) for which, some in rows.items()}
    if base is not None:
        other, _ = sums(accuracy, base)
        found |= {
            f"{which}_difference": difference(errors[:, some], other[:, some], truth[some])
            for which, some in rows.items()
        }
    return found


def physics(study: Study, accuracy: dict) -> list[dict]:
    """[{"label", "runs", "threshold", ...}] for the arms of study.physics whose runs are there; the
    first is the one to compare with.

    All of `intervals`, differences for all but the first; seeds: {subset: [relative L2 of each
    run]}; train_gate_open,
    validation_gate_open, test_gate_open: shares of samples beyond the arm's threshold, in training
    as a mean over the epochs; violation_mean and violation_max on the test interactions;
    fem_gate_open: share of the test interactions whose own FEM volume is beyond it.
    """
    found, first = [], None
    for arm in study.physics:
        runs = [run for run in arm.runs if run in accuracy["runs"]]
        if not runs:
            continue
        names = [f"{run}: {KERAS}" for run in runs]
        facts, models = (
            [accuracy["runs"][run] for run in runs],
            [accuracy["models"][name] for name in names],
        )
        threshold = facts[0]["threshold"]
        found.append(
            intervals(accuracy, names, first)
            | {
                "label": arm.label,
                "runs": runs,
                "threshold": threshold,
                "seeds": {
                    which: [_error(model, rows) for model in models]
                    for which, rows in subsets(accuracy).items()
                },
                "train_gate_open": _mean(facts, "train_gate_open"),
                "validation_gate_open": _mean(facts, "validation_gate_open"),
                "test_gate_open": _mean(models, "gate_open"),
                "violation_mean": _mean(models, "violation_mean"),
                "violation_max": max(max(model["violation"]) for model in models),
                "fem_gate_open": float(np.mean(np.array(accuracy["fem_violation"]) > threshold)),
            }
        )
        first = first or names
    return found


def _error(model, rows):
    error, truth = np.array(model["sums"])[rows].sum(axis=0)
    return float(np.sqrt(error / truth))


def _mean(entries, key):
    values = [entry[key] for entry in entries if entry[key] is not None]
    return float(np.mean(values)) if values else None
