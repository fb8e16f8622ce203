"""A full-order solver beside the constitutive network, for the frames that nobody vouches for."""

import numpy as np

from fem.errors import InputError, SolverStopped
from fem.online.stepper import State, Stepper, as_field
from unet_fem.runtime.constitutive import ConstitutiveSurrogate


class Fallback:
    """A ConstitutiveSurrogate as a Stepper whose flagged frames a solver answers.

    solver: a Stepper of the same body that takes any dt, such as fem.QuasiStaticLoop. At the first
    frame that is flagged it goes through all forces since the reset, which takes as long as it
    takes, and it answers from there on, for the network's memory of such a frame is wrong. After a
    frame `corrected` tells whether the solver answered. Where it stops on the way the network goes
    on alone until the reset, and `flagged` tells; later it raises SolverStopped itself.
    """

    def __init__(self, surrogate: ConstitutiveSurrogate, solver: Stepper) -> None:
        self.surrogate, self.solver = surrogate, solver
        self.interval, self.grid = surrogate.interval, surrogate.grid
        surrogate.warns = False  # of answers that are not given
        self.reset()

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self.surrogate.reset()
        self._past: list[np.ndarray] = []  # forces since, see `packed`
        self.corrected, self.alone = False, False

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, dt seconds after the call before, under `force` in mN that
        grew linearly since; see fem.online.stepper.Stepper."""
        force, dt = as_field(force), self.interval if dt is None else dt
        if self.corrected:
            return self.solver.step(force, dt)
        answer = self.surrogate.step(force, dt)
        if self.alone:
            return answer
        self._past.append(packed(force, float(dt)))  # type: ignore[arg-type]
        if self.surrogate.flagged:
            self.solver.reset()
            try:
                for past in self._past:
                    solved = self.solver.step(*unpacked(past))
                answer, self.corrected = solved, True
            except SolverStopped:
                self.alone = True
            self._past.clear()
        return answer

    @property
    def flagged(self) -> bool:
        """Whether nobody vouches for the last frame."""
        return self.surrogate.flagged and not self.corrected

    def state(self) -> State:
        """All that the next answer depends on: the network, and the solver or the past forces."""
        found = {"corrected": np.array(self.corrected), "alone": np.array(self.alone)}
        found |= {f"network_{name}": values for name, values in self.surrogate.state().items()}
        if self.corrected:
            found |= {f"solver_{name}": values for name, values in self.solver.state().items()}
        return found | {f"past_{k}": past for k, past in enumerate(self._past)}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another stepper."""
        if not isinstance(state, dict) or not {"corrected", "alone"} <= state.keys():
            raise InputError(
                "the state is of another stepper; restore what state() of the same stepper gave"
            )
        self.surrogate.restore(_part(state, "network_"))
        self.corrected, self.alone = bool(state["corrected"]), bool(state["alone"])
        if self.corrected:
            self.solver.restore(_part(state, "solver_"))
        self._past = list(_part(state, "past_").values())


def packed(force: np.ndarray, dt: float) -> np.ndarray:
    """A force and its dt with nothing but what is not zero."""
    where = np.flatnonzero(force)
    return np.concatenate([[dt, force.ndim], force.shape, where, force.ravel()[where]])


def unpacked(past: np.ndarray) -> tuple[np.ndarray, float]:
    """(force, dt) that `packed` took."""
    axes = int(past[1])
    where, values = np.split(past[2 + axes :], 2)
    force = np.zeros(past[2 : 2 + axes].astype(int), np.float32)
    force.flat[where.astype(int)] = values
    return force, float(past[0])


def _part(state, prefix):
    """Of a state, under the names without the prefix."""
    return {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
