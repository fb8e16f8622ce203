"""How sure the errors are: intervals over the test interactions by bootstrap, and the comparison
with and without the volume term.

Frames of one interaction are nearly equal, so whole interactions are drawn. The intervals are of
the mean over the seeds that were trained; how far the seeds differ is given beside it, since three
are too few to draw from.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import bootstrap

from unet_fem.study.measure.sums import Sums
from unet_fem.study.measure.sums import relative_l2 as relative_sums
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import Study

RESAMPLES = 4999
LEVEL = 0.95  # of all intervals
STRONG = 0.25  # share of the usual interactions that count as strong, by their largest total force


def errors(sums: Sums, subsets: dict[str, list[str]]) -> dict[str, dict]:
    """{subset: error} of each of `subsets` {name: interactions}, over those that `sums` has.

    An error is {"relative_l2", "low", "high"} over all frames together, "median" of the relative
    L2 of each interaction with "median_low" and "median_high", both intervals of 95 % by drawing
    interactions with replacement, and "count" of interactions; None where there are too few.
    """
    return {name: _error(sums, cases) for name, cases in subsets.items()}


def _error(sums, cases):
    pairs = np.array([sums[case] for case in cases if case in sums]).reshape(-1, 2)
    if not len(pairs):
        names = ("relative_l2", "low", "high", "median", "median_low", "median_high")
        return dict.fromkeys(names) | {"count": 0}
    error, truth = pairs.T
    median = _bootstrap(
        lambda e, t, axis=-1: np.median(np.sqrt(e / t), axis=axis), (error, truth), "median"
    )
    return interval(error[None], truth) | {
        "median": median["median"],
        "median_low": median["low"],
        "median_high": median["high"],
        "count": len(pairs),
    }


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
        "confidence_level": LEVEL,
        "batch": 500,
        "method": "percentile",
        "random_state": np.random.default_rng(1),
    }
    drawn = bootstrap(data, statistic, paired=True, vectorized=True, **settings)
    return found | {
        "low": float(drawn.confidence_interval.low),
        "high": float(drawn.confidence_interval.high),
    }


def subsets(accuracy: dict) -> dict[str, list[str]]:
    """{"usual", "strong", "hard": names of unseen interactions}: of the usual ones also the quarter
    with the largest forces."""
    usual, force = accuracy["subsets"]["usual"], accuracy["force"]
    strongest = sorted(usual, key=lambda case: -force[case])
    strong = strongest[: max(1, round(STRONG * len(usual)))]
    return accuracy["subsets"] | {"strong": [case for case in usual if case in strong]}


def sums(accuracy: dict, names: list[str], cases: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """(errors (len(names), I), truth (I,)) in mm2 of models of the accuracy stage on `cases`."""
    own = [[accuracy["models"][name]["sums"][case] for case in cases] for name in names]
    pairs = np.array(own).reshape(len(names), len(cases), 2)
    return pairs[..., 0], pairs[0, :, 1]


def intervals(accuracy: dict, names: list[str], base: list[str] | None = None) -> dict:
    """{"usual", "strong", "hard": interval} of the models `names`, seeds of one another;
    "usual_difference", ... to the models `base`."""
    found = {}
    for which, cases in subsets(accuracy).items():
        own, truth = sums(accuracy, names, cases)
        found[which] = interval(own, truth)
        if base is not None:
            other, _ = sums(accuracy, base, cases)
            found[f"{which}_difference"] = difference(own, other, truth)
    return found


def physics(study: Study, accuracy: dict) -> list[dict]:
    """[{"label", "runs", "threshold", ...}] for the arms of study.physics whose runs are there; the
    first is the one to compare with.

    All of `intervals`, differences for all but the first; seeds: {subset: [relative L2 of each
    run]}; train_gate_open,
    validation_gate_open, unseen_gate_open: shares of samples beyond the arm's threshold, in
    training as a mean over the epochs; violation_mean and violation_max on the unseen
    interactions; volume_scale: of the first run, see losses.volume_scale.
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
                    which: [relative_sums(model["sums"], cases) for model in models]
                    for which, cases in subsets(accuracy).items()
                },
                "train_gate_open": _mean(facts, "train_gate_open"),
                "validation_gate_open": _mean(facts, "validation_gate_open"),
                "unseen_gate_open": _mean(models, "gate_open"),
                "violation_mean": _mean(models, "violation_mean"),
                "violation_max": max(max(m["violation"].values()) for m in models),
                "volume_scale": facts[0]["volume_scale"],
            }
        )
        first = first or names
    return found


def _mean(entries, key):
    values = [entry[key] for entry in entries if entry[key] is not None]
    return float(np.mean(values)) if values else None
