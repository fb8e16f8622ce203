"""The one protocol of everything that answers forces call by call: networks, regressions, FEM
loops."""

from numbers import Real
from typing import Any, Protocol, runtime_checkable

import numpy as np

from fem.errors import InputError

State = dict[str, np.ndarray]  # what `state` gives: arrays by name, fit for np.savez


@runtime_checkable
class Stepper(Protocol):
    """A body under forces that change from call to call."""

    @property
    def interval(self) -> float | None:
        """Seconds from one call of `step` to the next, or None where any dt may be given."""

    def reset(self) -> None:
        """Back to rest: no force in the past."""

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm under `force` in mN, dt seconds after the call before.

        force: (N, 3) at the mesh's nodes or (nx, ny, nz, 3) on its node grid; the displacement
        comes in the same layout. Raises InputError for another shape, values that are not finite,
        and a dt that the stepper does not take; the state is then as it was.
        """

    def state(self) -> State:
        """A copy of all that the next answer depends on besides the next force."""

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another stepper."""


def check_interval(interval: float | None, dt: float | None) -> None:
    """Raises InputError unless a stepper that is called every `interval` seconds may be given
    `dt`."""
    if dt is None:
        if interval is None:
            raise InputError(
                "this stepper takes any interval; give dt, the seconds since the call before"
            )
        return
    if not (isinstance(dt, Real) and 0 < dt < np.inf):
        raise InputError(f"dt = {dt!r} s must be positive and finite")
    if interval is not None and abs(dt - interval) > 1e-6 * interval:
        raise InputError(
            f"dt = {dt:g} s, but this stepper is made for {interval:g} s between calls;"
            " leave dt out"
        )


def as_field(force: Any) -> np.ndarray:
    """A force as an array. Raises InputError for what is none; its shape is the stepper's to
    judge."""
    try:
        return np.asarray(force)
    except ValueError:
        raise InputError("the force has rows of different lengths; give (N, 3) mN") from None


def check_state(state: Any, own: State, finite: bool = True) -> None:
    """Raises InputError unless `state` holds the names and shapes of a stepper's `own` state, in
    numbers that are finite, or none of them NaN."""
    try:
        found = {name: np.asarray(values) for name, values in dict(state).items()}
        fits = {name: array.shape for name, array in found.items()} == {
            name: np.shape(array) for name, array in own.items()
        }
        whole = all(array.dtype.kind in "fiub" for array in found.values()) and not any(
            np.isnan(array).any() or finite and not np.isfinite(array).all()
            for array in found.values()
        )
    except (TypeError, ValueError):
        fits = whole = False
    if not (fits and whole):
        raise InputError(
            "the state is of another stepper, or not finite; restore what state() of the same"
            " stepper gave"
        )


def check_nodal(force: np.ndarray, n_nodes: int) -> np.ndarray:
    """The force if it is finite and one a node, (N, 3) mN. Raises InputError otherwise."""
    if force.shape != (n_nodes, 3) or force.dtype.kind not in "fiu" or not np.isfinite(force).all():
        raise InputError(
            f"the force is {force.dtype} of shape {force.shape}; give finite mN of shape"
            f" {(n_nodes, 3)}, one force a node"
        )
    return force
