"""What an observer is told of each step of a solver, whatever solver that is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np


class Energies(NamedTuple):
    """Energies in J: kinetic, strain without relaxation, of the hourglass control, and the work of
    the viscous stresses, which is minus what relaxation has spared so far."""

    kinetic: float
    strain: float
    hourglass: float
    viscous: float


class Hourglass(NamedTuple):
    """Energies in J: of the hourglass modes at a stiffness of mu, and at their own, and strain."""

    motion: float
    energy: float
    strain: float


class Body(Protocol):
    """What knows the energies and the cells of a body in motion."""

    damping: float  # 1/s, proportional to mass
    mass_scaled: bool  # whether its mass is more than the true one
    negligible_energy: float  # J, of a strain of about 0.1 %
    held: np.ndarray  # (N,) bool

    def kinetic_energy(self, velocity: np.ndarray) -> float:
        """J, of the velocity (3, N) in m/s."""

    def energies(self, u: np.ndarray, velocity: np.ndarray) -> Energies:
        """Of the displacement u (3, N) in m and the velocity (3, N) in m/s."""

    def hourglass(self, u: np.ndarray) -> Hourglass:
        """Of the displacement u (3, N) in m; zeros where there are no hourglass modes."""

    def corner_J(self, u: np.ndarray) -> np.ndarray:
        """(E,) smallest volume ratio at a corner of each cell, of the displacement u (3, N) m."""


@dataclass(slots=True)
class Step:
    """One step from `time`: all that is known there.

    time, dt: s; steps: how many came before
    u: displacement at `time`, (3, N) m
    v_before, v_after: velocity over the step that ends at `time` and over this one, (3, N) m/s
    load, internal: external and internal nodal forces at `time`, (3, N) N
    min_J: smallest J of all points at `time`
    viscous_current: whether the viscous stress was brought up to date at `time`
    last: whether it is the last step of an `advance`; a quasi-static solver ends one with a step of
    no length, so that the state in which it ends is known too
    body: knows the energies

    The arrays are the solver's own, and the next step overwrites them: copy what is to be kept, and
    change nothing.
    """

    time: float
    dt: float
    steps: int
    u: np.ndarray
    v_before: np.ndarray
    v_after: np.ndarray
    load: np.ndarray
    internal: np.ndarray
    min_J: float
    viscous_current: bool
    last: bool
    body: Body

    def velocity(self) -> np.ndarray:
        """Velocity at `time`, (3, N) m/s, of second order.

        The first step starts from that velocity itself: half a step before it is not known.
        """
        return 0.5 * (self.v_before + self.v_after) if self.steps else self.v_before

    def kinetic_energy(self) -> float:
        """J at `time`."""
        return self.body.kinetic_energy(self.velocity())

    def energies(self) -> Energies:
        """The Energies at `time`."""
        return self.body.energies(self.u, self.velocity())


Observer = Callable[[Step], None]
