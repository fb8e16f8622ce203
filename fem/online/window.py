"""A stepper around a function of the last few forces, or of what is made of them first."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from fem.errors import InputError
from fem.online.grid import NodeGrid
from fem.online.stepper import State, as_field, check_interval

LARGEST_FORCE = 1e12  # mN at a node: beyond it float32 overflows on the way


def _finite(values):
    values = np.asarray(values)
    return values.dtype.kind in "fiu" and bool(np.isfinite(values).all())


class Memory(Protocol):
    """What makes the field that is seen from the force, call by call, such as
    fem.online.creep.CreepFilter and fem.online.input_field.InputField."""

    def reset(self) -> None: ...

    def step(self, force: np.ndarray, dt: float) -> np.ndarray: ...

    def state(self) -> State: ...

    def restore(self, state: State) -> None: ...


class WindowStepper:
    """A Stepper that answers from the forces of the last calls and keeps that window itself.

    answer: window (1, [T,] nx, ny, nz, 3) float32 mN -> displacement (1, nx, ny, nz, 3) mm. grid:
    of the nodes. steps: frames T of the window, or None where `answer` has no time axis. interval:
    seconds between frames, None if unknown; any dt is then taken for one. memory: of
    (nx, ny, nz, 3), makes what the window holds in place of the forces; without a time axis any dt
    may then be given, and `interval` is that of a call without.
    """

    def __init__(
        self,
        answer: Callable[[np.ndarray], np.ndarray],
        grid: NodeGrid,
        steps: int | None,
        interval: float | None,
        memory: Memory | None = None,
    ) -> None:
        self.answer, self.grid, self.steps, self.interval = answer, grid, steps, interval
        self.memory = memory
        self.reset()

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self._forces = np.zeros((self.steps or 1, *self.grid.shape, 3), "float32")
        if self.memory:
            self.memory.reset()

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, under `force` in mN, one interval after the call before.

        force: (N, 3) or (nx, ny, nz, 3), and the displacement likewise. Raises InputError for
        another shape, values that are not finite, and a dt that is not taken; the window is then as
        it was.
        """
        elapsed = self._elapsed(dt)
        force = as_field(force)
        nodal = self.grid.is_nodal(force)
        if force.size and not np.abs(force).max() <= LARGEST_FORCE:
            raise InputError(f"the force is {np.abs(force).max():g} mN at a node; give it in mN")
        force = force.astype("float32")
        newest = self.grid.to_grid(force) if nodal else force
        if self.memory:
            newest = self.memory.step(newest, elapsed).astype("float32")
        forces = np.concatenate([self._forces[1:], newest[None]])
        displacement = np.asarray(self.answer(forces if self.steps is None else forces[None]))[0]
        self._forces = forces
        return self.grid.from_grid(displacement) if nodal else displacement

    def _elapsed(self, dt):
        """Seconds since the call before."""
        if self.memory is None:
            if dt is not None:
                check_interval(self.interval, dt)
            return self.interval
        if dt is None and self.interval is not None:
            return self.interval
        check_interval(self.interval if self.steps else None, dt)
        return dt

    def state(self) -> State:
        """{"forces": (T, nx, ny, nz, 3)}: what the window holds, the newest at the end, and beside
        it the state of the memory."""
        return {"forces": self._forces.copy()} | (self.memory.state() if self.memory else {})

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another stepper."""
        known = {"forces", *(self.memory.state() if self.memory else ())}
        if not isinstance(state, dict) or state.keys() - known:
            raise InputError("this is not the state of a stepper; restore what its state() gave")
        forces = state.get("forces")
        if forces is not None and not _finite(forces):
            raise InputError("the state's forces are not finite numbers; restore what state() gave")
        if forces is None or np.shape(forces) != self._forces.shape:
            found = "nothing" if forces is None else f"shape {np.shape(forces)}"
            raise InputError(
                f"the state holds {found} as forces and this stepper keeps {self._forces.shape};"
                " restore what state() of the same stepper gave"
            )
        if self.memory:
            self.memory.restore(state)
        self._forces = np.array(forces, "float32")
