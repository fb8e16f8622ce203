"""A load that is sampled now and then, and runs linearly between two samples."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fem.errors import InputError
from fem.ranges import checked, shown

# share of the largest load so far by which its ramp between two samples may miss it
LOAD_BEND = 0.005

NodalLoad = Callable[[float], np.ndarray]  # t in s -> nodal forces (3, N) in N


@dataclass(slots=True)
class LoadRamp:
    """What is known of a load from its samples.

    rate: of the last ramp, (3, N) N/s; steps: that it took; size: largest component so far, N
    """

    rate: np.ndarray
    steps: int
    size: float = 0.0

    def sample(
        self, load: NodalLoad, now: np.ndarray, time: float, dt: float, most: int
    ) -> tuple[int, np.ndarray]:
        """(steps, load at their end): up to `most` steps of dt seconds from `time`, fewer where the
        load bends away from its ramp so far. now: the load at `time`."""
        count = most
        while True:
            then = np.asarray(load(time + count * dt), float)
            if then.shape != now.shape:
                raise InputError(f"the load was {now.shape} and is {then.shape} at {time:g} s")
            self.size = max(self.size, np.abs(then).max())
            # of a parabola from its chord
            bend = np.abs(then - now - count * dt * self.rate).max() / 8
            # a NaN is left to the solver
            if count == 1 or not bend > LOAD_BEND * self.size:
                self.rate, self.steps = (then - now) / (count * dt), count
                return count, then
            count //= 2


def checked_duration(duration: float) -> None:
    """Raises InputError for a duration in s that is negative or not finite."""
    checked("duration", duration, 0, 1e12, "s")


def sampled_load(load: NodalLoad, time: float, shape: tuple[int, ...]) -> np.ndarray:
    """The load at `time`. Raises InputError for another shape, and for values whose square is not
    finite."""
    found = first_load(load, time, shape)
    if not np.isfinite(np.vdot(found, found)):
        raise InputError(f"the load at {time:g} s is not finite, or too large; give N")
    return found


def first_load(load: NodalLoad, time: float, shape: tuple[int, ...]) -> np.ndarray:
    """The load at `time`. Raises InputError for another shape."""
    if not callable(load):
        raise InputError(f"the load is {shown(load)}; give a function of the time in s")
    found = np.asarray(load(time))
    if found.dtype.kind not in "fiu":
        raise InputError(f"the load is {shown(found)}; give real numbers, in N")
    found = found.astype(float)
    if found.shape != shape:
        raise InputError(
            f"the load has shape {found.shape}; give nodal forces of shape {shape}, in N"
        )
    return found
