"""Whether the answer of a run can be believed: equilibrium with the load, hourglass motion, and the
corners of the cells."""

import warnings
from typing import NamedTuple

import numpy as np

from fem.errors import SolverStopped, Stop
from fem.solver.record import Step

CHECK_EVERY = 128  # most steps between looks at the forces
SHAPE_EVERY = 256  # and at the shape of the cells
# the load may not have grown by more than this factor since the look before: in a faint first touch
# inertia is always as large as the load
GROWTH = 1.5


class Signs(NamedTuple):
    """What tells that an answer is wrong, largest or smallest of a run. docs/stability.md has the
    errors that belong to each.

    disequilibrium: largest inertial and damping force over largest load, as norms over the free
    nodes: near zero where the tissue follows the load, as mass scaling and damping presume
    hourglass_motion: largest energy that the reduced element's hourglass modes would have at a
    hourglass stiffness of mu, over largest strain energy; large where too little resists them
    hourglass_share: the energy that they do have, over the same; large where the hourglass
    stiffness carries the load
    corner_J: smallest volume ratio of a cell at one of its corners
    """

    disequilibrium: float = 0.0
    hourglass_motion: float = 0.0
    hourglass_share: float = 0.0
    corner_J: float = 1.0


class Limits(NamedTuple):
    """The Signs beyond which an answer is not to be believed, settled over the map of limits."""

    disequilibrium: float = 0.03
    hourglass_motion: float = 0.2
    hourglass_share: float = 0.05
    corner_J: float = 0.1


LIMITS = Limits()
HOURGLASS = {Stop.HOURGLASS_MOTION, Stop.HOURGLASS_ENERGY}


def doubts(signs: Signs, limits: Limits = LIMITS) -> list[Stop]:
    """Why the answer of a run is not to be believed; a NaN is not believed."""
    fit = {
        Stop.CRUSHED_CORNER: signs.corner_J >= limits.corner_J,
        Stop.DISEQUILIBRIUM: signs.disequilibrium <= limits.disequilibrium,
        Stop.HOURGLASS_MOTION: signs.hourglass_motion <= limits.hourglass_motion,
        Stop.HOURGLASS_ENERGY: signs.hourglass_share <= limits.hourglass_share,
    }
    return [stop for stop, fulfilled in fit.items() if not fulfilled]


def check_corners(corner_J: np.ndarray, time: float) -> None:
    """Raises SolverStopped if a cell (E,) is turned inside out at a corner at `time` s."""
    if not corner_J.min() > 0:
        raise SolverStopped.because(
            Stop.INVERTED_CELL,
            f"cell {corner_J.argmin()} is turned inside out at a corner at {time:.4g} s",
        )


class Gate:
    """Observer of a solver's steps that keeps the Signs of the run.

    It looks in the last step of each `advance`, besides at the forces once in 128 steps and at the
    cells once in 256.

    Warns of each sign once that is beyond its limit; of the disequilibrium where the mass is scaled
    alone, for with the true mass it is the motion itself. Raises SolverStopped(INVERTED_CELL) where
    a corner is turned inside out.

    warns: whether it does; who judges the signs at the end needs no warning
    """

    def __init__(self, warns: bool = True) -> None:
        self.warns = warns
        # the largest so far: N and, of the hourglass modes and of the stress, J
        self._largest = dict.fromkeys(("residual", "load", "motion", "energy", "strain"), 0.0)
        self.corner_J = 1.0
        self._load_before = np.inf
        self._next, self._next_shape = 0, SHAPE_EVERY
        self._said: set[Stop] = set()

    def __call__(self, step: Step) -> None:
        """Look at the step where it is due."""
        if not self.looks(step.steps, step.last):
            return
        due = step.steps >= self._next
        self._count_forces(step)
        if step.last or step.steps >= self._next_shape:
            self._count_shape(step)
        if due:  # few at the start, so that the shortest run is looked at more than once
            self._next = step.steps + min(CHECK_EVERY, max(1, step.steps))
            self._warn(step)
            self._load_before = self._largest["load"]

    def looks(self, steps: int, last: bool) -> bool:
        """Whether it looks at the step after `steps` others, the `last` of an `advance` or not."""
        return last or steps >= self._next

    @property
    def signs(self) -> Signs:
        """Of the run so far."""
        largest = self._largest
        load, strain = max(largest["load"], 1e-300), max(largest["strain"], 1e-300)
        return Signs(
            largest["residual"] / load,
            largest["motion"] / strain,
            largest["energy"] / strain,
            self.corner_J,
        )

    def _count_forces(self, step):
        free = np.flatnonzero(~step.body.held)
        residual = np.linalg.norm((step.load - step.internal).take(free, axis=1))
        self._raise(residual=residual, load=np.linalg.norm(step.load.take(free, axis=1)))

    def _count_shape(self, step):
        self._next_shape = step.steps + SHAPE_EVERY
        corners = step.body.corner_J(step.u)
        self.corner_J = float(np.minimum(self.corner_J, corners.min()))  # a NaN stays
        check_corners(corners, step.time)
        self._raise(**step.body.hourglass(step.u)._asdict())

    def _raise(self, **found):
        for name, value in found.items():
            self._largest[name] = float(np.maximum(self._largest[name], value))

    def _warn(self, step):
        load, body = self._largest["load"], step.body
        if not (self.warns and 0 < load <= GROWTH * self._load_before):
            return
        faint = self._largest["strain"] < body.negligible_energy
        silent = {*self._said, *([] if body.mass_scaled else [Stop.DISEQUILIBRIUM])}
        silent |= HOURGLASS if faint or HOURGLASS & self._said else set()
        for stop in doubts(self.signs):
            if stop not in silent:
                self._said.add(stop)
                warnings.warn(
                    f"{_told(stop, self.signs)} at {step.time:.4g} s; {stop.remedy}",
                    RuntimeWarning,
                    stacklevel=3,
                )


def _told(stop, signs):
    """What has been found, for a warning."""
    if stop is Stop.CRUSHED_CORNER:
        return f"a corner of a cell is crushed to J = {signs.corner_J:.2g}"
    if stop is Stop.DISEQUILIBRIUM:
        return f"inertia and damping of the scaled mass take {signs.disequilibrium:.0%} of the load"
    if stop is Stop.HOURGLASS_MOTION:
        return (
            f"hourglass motion would hold {signs.hourglass_motion:.0%} of the strain energy at a"
            f" stiffness of mu (above {LIMITS.hourglass_motion:.0%} the element is too soft)"
        )
    return (
        f"hourglass control holds {signs.hourglass_share:.0%} of the strain energy"
        f" (above {LIMITS.hourglass_share:.0%} the element is too stiff)"
    )
