"""Explicit time integration of a hexahedral mesh under nodal loads: a step control picks the
steps, a leapfrog takes them, and observers watch."""

from collections.abc import Callable, Sequence
from dataclasses import fields

import numpy as np

from fem.errors import InputError, SolverStopped, Stop
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.ranges import checked
from fem.solver.gate import Gate
from fem.solver.internal_force import InternalForce
from fem.solver.leapfrog import Leapfrog
from fem.solver.load_ramp import LoadRamp, NodalLoad, checked_duration, first_load
from fem.solver.record import Observer, Step
from fem.solver.step_control import MOST_STEPS, Pace, StepControl

BLOCK = 16  # most steps between load samples and guards


class Solver:
    """One explicit simulation.

    mesh, material, element, precision, hourglass_stiffness: see
    fem.solver.internal_force.InternalForce
    damping: mass-proportional damping rate alpha, 1/s: force -alpha m v
    mass_scaling: factor on the density, one or one a cell (E,), for slow scenes; the stable step
    grows with its root
    safety: share of the critical time step that is used
    control: makes the step control from the leapfrog and the safety
    allow_locking: take the full element for nearly incompressible tissue too, to see it lock

    `gate` looks on where an `advance` picks its steps itself, and warns of an answer that is not to
    be believed, see fem.solver.gate; a loop of fixed steps is judged by its error.

    `state` holds displacement and velocity, `pace` the critical step, `leapfrog` the mesh, the
    masses and the internal force; `snapshot` and `restore` keep a run and go on from it. The step
    is estimated again whenever the tissue has stiffened, and is shortened while cells are
    compressed fast. A run that cannot go on raises SolverStopped, whose `reason` is the
    fem.errors.Stop DIVERGED, CRUSHED_CELL, INVERTED_CELL, NO_STABLE_STEP, STEP_TOO_LARGE or
    TOO_MANY_STEPS.
    """

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        element: str = "full",
        precision: str = "float64",
        hourglass_stiffness: float = 0.2,
        damping: float = 0.0,
        mass_scaling: float | np.ndarray = 1.0,
        safety: float = 0.85,
        control: Callable[[Leapfrog, float], StepControl] = StepControl,
        allow_locking: bool = False,
    ) -> None:
        self.leapfrog = Leapfrog(
            mesh,
            material,
            element,
            precision,
            hourglass_stiffness,
            damping,
            mass_scaling,
            allow_locking,
        )
        self.control = control(self.leapfrog, safety)
        self.gate: Gate | None = Gate()
        self.state, self.pace = self.leapfrog.rest(), Pace()
        self.ramp = LoadRamp(np.zeros((3, mesh.n_nodes)), BLOCK)
        self.estimate_step()

    def estimate_step(self) -> None:
        """Estimate the critical step in the present state; `advance` does so where it is needed.
        Raises SolverStopped if a corner of a cell is turned inside out, or no step is stable."""
        self.control.estimate(self.pace, self.state)

    @property
    def mesh(self) -> HexMesh:
        """The mesh at rest."""
        return self.leapfrog.mesh

    @property
    def force(self) -> InternalForce:
        """The internal force with its stress history."""
        return self.leapfrog.force

    @property
    def mass(self) -> np.ndarray:
        """Nodal masses (N,) in kg."""
        return self.leapfrog.mass

    @property
    def u(self) -> np.ndarray:
        """Displacement (3, N) in m at `time`; the next `advance` overwrites it."""
        return self.state.u

    @property
    def v(self) -> np.ndarray:
        """Velocity (3, N) in m/s half a step before `time`; the next `advance` overwrites it."""
        return self.state.v

    @property
    def time(self) -> float:
        """Seconds simulated so far."""
        return self.state.time

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return self.state.steps

    @property
    def critical_step(self) -> float:
        """The critical time step in s, as last estimated."""
        return self.pace.critical

    @property
    def max_step(self) -> float:
        """The largest step in s that is taken from this state."""
        return self.control.safety * self.pace.critical

    def advance(
        self,
        duration: float,
        load: NodalLoad,
        observers: Sequence[Observer] = (),
        steps: int | None = None,
    ) -> None:
        """Integrate `duration` seconds under the nodal force `load(t)` (3, N) in N.

        The load is sampled every 16 steps, more often where it bends, and runs linearly between:
        what starts and ends between two samples is not seen.

        steps: take exactly this many, for a fixed latency, and stop where duration / steps exceeds
        the critical step; otherwise as many as the stable step asks for, and more when the tissue
        stiffens on the way.
        observers: each is called with the fem.solver.record.Step of every step.

        Raises InputError for a duration that is negative or not finite, a number of steps below 1
        and a load of another shape, all before anything has changed.
        """
        remaining = _checked_steps(duration, steps)
        load_now = first_load(load, self.time, self.state.u.shape)
        gate = self.gate if remaining is None else None
        control, pace = self.control, self.pace
        end = self.time + duration
        jump = (load_now - self.state.load) * self.leapfrog.inverse_mass
        control.begin(pace, np.abs(jump).max())
        while remaining is None and end - self.time > 1e-9 * duration or remaining:
            left = remaining or control.steps(pace, self.time, end)
            dt = (end - self.time) / left
            control.check(pace, dt)
            count, load_next = self.ramp.sample(
                load, load_now, self.time, dt, min(BLOCK, left, 2 * self.ramp.steps)
            )
            with np.errstate(all="ignore"):  # an overflow is found, and named, after the block
                done, stop = self._block(dt, count, left, load_now, load_next, observers, gate)
            load_now = load_next if done == count else self.state.load.copy()
            remaining = None if remaining is None else remaining - done
            stop = stop or self.leapfrog.settle(self.state)
            if stop:
                raise SolverStopped.because(stop, self._told(stop))
            control.refresh(pace, self.state)
        self.state.time = end

    def _block(self, dt, count, left, load_now, load_next, observers, gate):
        """Up to `count` of the `left` steps, fewer if a cell is compressed fast or the run must
        stop: (steps taken, why it must stop or None)."""
        leapfrog, control, pace = self.leapfrog, self.control, self.pace
        load = self.state.load
        np.copyto(load, load_now)
        slope = (load_next - load_now) / count
        ramp, stride = slope.any(), control.stride(dt)
        for i in range(count):
            old = self.state
            self.state, stop = leapfrog.step(old, dt, stride, check=i == 0)
            J = leapfrog.force.min_J
            looking = observers
            if gate and gate.looks(old.steps, i + 1 == left):
                looking = [*observers, gate]
            if looking:
                step = Step(
                    old.time,
                    dt,
                    old.steps,
                    old.u,
                    old.v,
                    self.state.v,
                    load,
                    leapfrog.internal,
                    J,
                    old.standing == 0,
                    i + 1 == left,
                    leapfrog,
                )
                for observer in looking:
                    observer(step)
            if ramp:
                load += slope
            if control.hurry(pace, dt, J) or stop:
                return i + 1, stop
        return count, None

    def _told(self, stop):
        """What has happened, for the message of a stop."""
        force = self.leapfrog.force
        if stop is Stop.CRUSHED_CELL:
            return (
                f"cell {force.worst_cell} is crushed to J = {force.min_J:.3g}"
                f" before {self.time:.4g} s"
            )
        return f"the displacement is no longer finite at {self.time:.4g} s"

    def snapshot(self) -> dict[str, np.ndarray]:
        """A copy of all that the run depends on from here, as arrays by name."""
        return {
            f"{part}.{field.name}": np.array(getattr(getattr(self, part), field.name))
            for part in _PARTS
            for field in fields(getattr(self, part))
        } | {f"force.{name}": array for name, array in self.leapfrog.force.state().items()}

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Go on from what `snapshot` gave. Raises InputError for that of another solver."""
        here = self.snapshot()
        if not isinstance(snapshot, dict) or not all(
            np.asarray(array).dtype.kind in "fiub" and not np.isnan(array).any()
            for array in snapshot.values()
        ):
            raise InputError("the snapshot is not what snapshot() gave: numbers by name, none NaN")
        if {name: np.shape(array) for name, array in snapshot.items()} != {
            name: array.shape for name, array in here.items()
        }:
            raise InputError(
                "the snapshot is of another solver; restore one of the same mesh and material"
            )
        for part in _PARTS:
            target = getattr(self, part)
            for field in fields(target):
                value = np.array(snapshot[f"{part}.{field.name}"])
                setattr(target, field.name, value if value.ndim else value.item())
        self.leapfrog.force.restore(
            {
                name.removeprefix("force."): array
                for name, array in snapshot.items()
                if name.startswith("force.")
            }
        )


_PARTS = "state", "pace", "ramp"


def _checked_steps(duration, steps):
    """`steps` as an int or None. Raises InputError for a number or a duration without meaning."""
    checked_duration(duration)
    if steps is None:
        return None
    checked("steps", steps, 1, int(MOST_STEPS), whole=True)
    if duration == 0:
        raise InputError(f"duration = {duration} s leaves no time for {steps} steps")
    return steps
