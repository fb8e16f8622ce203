"""How long a step may be: the estimate of the critical step, and what shortens a step below it."""

from dataclasses import dataclass

import numpy as np

from fem.errors import SolverStopped, Stop
from fem.ranges import checked
from fem.solver.body import SMALLEST_J
from fem.solver.critical_step import critical_time_step, thickness
from fem.solver.gate import check_corners
from fem.solver.leapfrog import Leapfrog, State

STRIDE = 64  # most steps between updates of the viscous stress
# share of the shortest relaxation time for which the viscous stress may stand still
STANDSTILL = 0.004
FASTEST_CRUSH = 0.1  # share of the smallest J that one step may take away
# share of the thinnest cell by which a sudden load may move a node in its first step
FIRST_STEP = 0.05
MOST_STEPS = 1e8  # of one call of `advance`: hours on any mesh


@dataclass(slots=True)
class Pace:
    """What a step control knows of the motion.

    critical: the critical step, s; estimated_J, estimated_stiffening: of the state in which it was
    estimated
    cap: s, what a fast motion allows; last_J: smallest J of the step before
    """

    critical: float = 0.0
    estimated_J: float = 1.0
    estimated_stiffening: float = 1.0
    cap: float = np.inf
    last_J: float = 1.0


class StepControl:
    """Picks the steps of a Leapfrog: a share `safety` of the critical one, which is estimated again
    whenever the tissue has stiffened; less under a sudden load and while cells are compressed fast.

    Its methods take the Pace of the run and change nothing else. They raise SolverStopped where no
    step will do.
    """

    def __init__(self, leapfrog: Leapfrog, safety: float = 0.85) -> None:
        checked("solver.safety", safety, 1e-6, 10)
        self.leapfrog, self.safety = leapfrog, float(safety)
        self._thickness = thickness(leapfrog.mesh)
        self._shortest_relaxation = min((tau for _, tau in leapfrog.material.prony), default=None)

    def estimate(self, pace: Pace, state: State) -> None:
        """Estimate the critical step in `state`. Raises SolverStopped if a corner of a cell is
        turned inside out, or no step is stable."""
        leapfrog = self.leapfrog
        check_corners(leapfrog.corner_J(state.u), state.time)
        force = leapfrog.elastic_force
        pace.critical = critical_time_step(force, leapfrog.mass, leapfrog.held, state.u)
        force(state.u, check=True)
        pace.estimated_J, pace.estimated_stiffening = force.min_J, force.stiffening

    def begin(self, pace: Pace, acceleration: float) -> None:
        """Before a load that is `acceleration` m/s2 away from the last at most: start with a step
        in which no node moves farther than a small part of a cell."""
        if acceleration > 0:  # a NaN is found by the solver
            sudden = 0.5 * np.sqrt(2 * FIRST_STEP * self._thickness.min() / acceleration)
            pace.cap = min(pace.cap, sudden)

    def steps(self, pace: Pace, time: float, end: float) -> int:
        """How many equal steps to take from `time` to `end`, in s."""
        longest = self.safety * pace.critical
        pace.cap = min(2 * pace.cap, longest)  # what a fast motion has shortened grows again
        dt = min(longest, pace.cap)
        if (end - time) / dt < MOST_STEPS:
            return max(1, int(np.ceil((end - time) / dt * (1 - 1e-12))))
        if dt < longest:
            raise SolverStopped.because(
                Stop.NO_STABLE_STEP,
                f"only steps of {dt:.2g} s would follow the motion at {time:.4g} s",
            )
        raise SolverStopped.because(
            Stop.TOO_MANY_STEPS,
            f"{(end - time) / dt:.2g} steps of {dt:.2g} s are left,"
            f" and cell {self._thickness.argmin()} is the thinnest",
        )

    def check(self, pace: Pace, dt: float) -> None:
        """Raises SolverStopped for a step of dt seconds beyond the critical one."""
        if dt > pace.critical:
            raise SolverStopped.because(
                Stop.STEP_TOO_LARGE,
                f"the time step {dt:.3g} s exceeds the critical {pace.critical:.3g} s",
            )

    def stride(self, dt: float) -> int:
        """Steps of dt seconds for which the viscous stress may stand still: a small part of the
        shortest relaxation time."""
        if self._shortest_relaxation is None:
            return 1
        return min(STRIDE, max(1, int(STANDSTILL * self._shortest_relaxation / dt)))

    def hurry(self, pace: Pace, dt: float, J: float) -> bool:
        """Whether to look at the critical step at once after a step of dt seconds at the smallest
        J: a cell is crushed, near it, or on its way by the next step."""
        loss, pace.last_J = pace.last_J - J, J
        if loss > FASTEST_CRUSH * J:
            pace.cap = 0.5 * dt * FASTEST_CRUSH * max(J, SMALLEST_J) / loss
            return True
        return not J >= 0.9 * pace.estimated_J

    def is_stale(self, pace: Pace) -> bool:
        """Whether the tissue has changed too much since the critical step was estimated."""
        force = self.leapfrog.force
        # measured on loaded tissue: the critical step changes by at most 4 % between two estimates
        # made so, far inside the usual margin of 15 %; the last condition gives the longer step
        # back after a release
        return (
            force.min_J < 0.9 * pace.estimated_J
            or force.stiffening > 1.05 * pace.estimated_stiffening
            or force.min_J > 1.11 * pace.estimated_J
        )

    def refresh(self, pace: Pace, state: State) -> None:
        """Estimate the critical step again where it is stale."""
        if self.is_stale(pace):
            self.estimate(pace, state)
