"""How far a stepper is from the interactions of a dataset, and what its steps cost."""

import time
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from fem.contact.push import Load
from fem.contact.surface import surface_of
from fem.data.dataset import Dataset
from fem.data.interaction import Frame, simulate_frames, stacked
from fem.solver.quasistatic import QuasiStatic


class Verdict(NamedTuple):
    """error: relative L2 over all frames and nodes, worst: of the worst interaction; evaluations a
    frame; p50, p99: CPU milliseconds a frame."""

    error: float
    worst: float
    evaluations: float
    p50: float
    p99: float


def judge(
    stepper: Any,
    dataset: Dataset,
    which: Iterable[tuple[str, int]],
    interval: float | None = None,
) -> Verdict:
    """The Verdict of a Stepper, which may count its `evaluations`, over some interactions (split,
    number) of a dataset, at its own frames; or at frames of `interval` s, against quasi-static
    simulations of the same contacts."""
    dt = interval or float(dataset.time[1] - dataset.time[0])
    errors, sizes, spent, evaluations = [], [], [], 0
    for split, number in which:
        one: Any = dataset.sequence(split, number)
        if interval:
            one = quasistatic(dataset, split, number, interval)
        stepper.reset()
        error = 0.0
        for force, truth in zip(one.force, one.displacement, strict=True):
            start = time.thread_time()
            answer = stepper.step(force, dt)
            spent.append(time.thread_time() - start)
            evaluations += getattr(stepper, "evaluations", 1)
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


def quasistatic(dataset: Dataset, split: str, number: int, interval: float) -> Frame:
    """An interaction's contacts simulated quasi-statically: a Frame of frames `interval` s apart,
    from the first to the last that the dataset has."""
    load = Load(surface_of(dataset.fem_mesh), dataset.contacts(split, number))
    solver = QuasiStatic(dataset.fem_mesh, dataset.material, precision="float32")
    count = round(float(dataset.time[-1]) / interval)
    return stacked(simulate_frames(solver, load, interval * np.arange(1, count + 1)))


def _squares(values: Any) -> float:
    return float(np.sum(np.square(values, dtype=float)))
