"""Timings that can be trusted on a noisy machine: variants take turns, and quantiles are quoted."""

import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

import numpy as np

Name = TypeVar("Name", bound=Hashable)


def alternate(
    actions: dict[Name, Callable[[], Any]], rounds: int, warm_up: int = 1
) -> dict[Name, np.ndarray]:
    """Seconds per unit of each action, {name: array (rounds,)}: the actions take turns, so that
    ratios hold.

    actions: {name: callable}; a callable that does several units of work returns their number,
    otherwise None.
    warm_up: calls of each action before the clock runs.
    """
    for action in actions.values():
        for _ in range(warm_up):
            action()
    times = {name: np.empty(rounds) for name in actions}
    for i in range(rounds):
        for name, action in actions.items():
            start = time.perf_counter()
            units = action()
            times[name][i] = (time.perf_counter() - start) / (units or 1)
    return times


def quantiles(
    values: np.ndarray, which: Sequence[float] = (50, 90, 99), digits: int = 4
) -> dict[str, float]:
    """{"p50": ..., "p90": ..., "worst": ...} of an array."""
    result = {f"p{q}": round(float(np.percentile(values, q)), digits) for q in which}
    return result | {"worst": round(float(np.max(values)), digits)}


def paired_ratio(values: np.ndarray, base: np.ndarray) -> float:
    """Median of the ratios of values and base that were taken in the same rounds."""
    return float(np.median(values / base))
