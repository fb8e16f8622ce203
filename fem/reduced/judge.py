"""How far a stepper is from the interactions of a dataset, and what its steps cost."""

import time
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from fem.data.dataset import Dataset
from fem.online.reduced import ReducedStepper


class Verdict(NamedTuple):
    """error: relative L2 over all frames and nodes, worst: of the worst interaction; evaluations a
    frame; p50, p99: CPU milliseconds a frame."""

    error: float
    worst: float
    evaluations: float
    p50: float
    p99: float


def judge(
    stepper: ReducedStepper,
    dataset: Dataset,
    which: Iterable[tuple[str, int]],
) -> Verdict:
    """The Verdict over some interactions (split, number) of a dataset."""
    dt = float(dataset.time[1] - dataset.time[0])
    errors, sizes, spent, evaluations = [], [], [], 0
    for split, number in which:
        one = dataset.sequence(split, number)
        stepper.reset()
        error = 0.0
        for force, truth in zip(one.force, one.displacement, strict=True):
            start = time.thread_time()
            answer = stepper.step(force, dt)
            spent.append(time.thread_time() - start)
            evaluations += stepper.evaluations
            error += _squares(answer - truth)
        errors.append(error)
        sizes.append(_squares(one.displacement))
    worst = max((e / s for e, s in zip(errors, sizes, strict=True) if s), default=0.0)
    p50, p99 = 1e3 * np.quantile(spent, [0.5, 0.99])
    total = sum(sizes)
    return Verdict(
        float(np.sqrt(sum(errors) / total)) if total else 0.0,
        float(np.sqrt(worst)),
        evaluations / len(spent),
        float(p50),
        float(p99),
    )


def _squares(values: Any) -> float:
    return float(np.sum(np.square(values, dtype=float)))
