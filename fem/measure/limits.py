"""The map of limits: where the solver is accurate, where it stops, and what the gate rejects.

Every cell of the map is one run at an extreme setting. It ends as accurate, with its error against
a reference, as stopped, with the solver's reason, or, in the rows of slow pushes, as rejected by
the gate that fem.solver.gate describes. An error above the sweep's tolerance is WRONG, and so is a
run that does not come to an end. The settings are in fem.measure.sweeps and quasistatic_sweeps,
their runs in extreme_runs, the figure and the text in limits_report; tools/stability.py is the
command.
"""

import signal
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from fem.errors import InputError, SolverStopped
from fem.measure.extreme_runs import Rejected
from fem.measure.quasistatic_sweeps import quasistatic_sweeps
from fem.measure.sweeps import Sweep, sweeps

HANG = 300  # s after which a run counts as hanging
HAS_ALARM = hasattr(signal, "SIGALRM")  # not on Windows, where a run that hangs is not ended
STATUSES = "accurate", "stopped", "rejected", "WRONG"
# word of an InputError: short reason
REFUSALS = {
    "inverted": "inverted cell",
    "locks": "locking element",
    "add up to": "not a solid",
}


@dataclass(frozen=True)
class Cell:
    """status: one of STATUSES; error: relative, NaN if stopped; reason: why it stopped, or is
    rejected."""

    sweep: Sweep
    value: str
    status: str
    error: float
    reason: str
    seconds: float


def measure(quick: bool = False, only: str = "") -> Iterator[Cell]:
    """The cells of the map, one by one: of the sweeps whose name contains `only`, at a few of their
    values if `quick`. Raises InputError where that leaves none."""
    chosen = [
        (sweep, value)
        for sweep in rows()
        if only in sweep.name
        for value in (sweep.quick if quick else sweep.values)
    ]
    if not chosen:
        names = "; ".join(sweep.name for sweep in rows() if sweep.quick or not quick)
        raise InputError(f"no cell of the map has '{only}' in its name; take a word of: {names}")
    return (evaluate(sweep, value) for sweep, value in chosen)


def rows() -> list[Sweep]:
    """Those of the explicit solver and those of the quasi-static one."""
    return [*sweeps(), *quasistatic_sweeps()]


def counts(cells: Sequence[Cell]) -> dict[str, int]:
    """{status: number of cells}."""
    return {status: sum(cell.status == status for cell in cells) for status in STATUSES}


def evaluate(sweep: Sweep, value: object) -> Cell:
    """The Cell of one value of a sweep."""
    start, error, status, reason = time.perf_counter(), np.nan, "stopped", ""
    try:
        with _time_limit(HANG), np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the map tells what a run warns of
            error = float(sweep.run(value))
        status = "accurate" if error <= sweep.tolerance else "WRONG"
    except SolverStopped as stop:
        reason = str(stop.reason)
    except Rejected as rejected:
        error, status, reason = rejected.error, "rejected", str(rejected.reason)
    except InputError as refusal:
        reason = next(
            (short for word, short in REFUSALS.items() if word in str(refusal)), str(refusal)
        )
    except TimeoutError:
        status, reason = "WRONG", "hangs"
    return Cell(sweep, sweep.label(value), status, error, reason, time.perf_counter() - start)


@contextmanager
def _time_limit(seconds):
    """TimeoutError in the block after `seconds`, where the system has an alarm."""
    if not HAS_ALARM:
        yield
        return
    before = signal.signal(signal.SIGALRM, _hangs)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _hangs(*_):
    raise TimeoutError
