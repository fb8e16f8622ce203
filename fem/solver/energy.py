"""The energy balance of a run, kept by observers of its steps."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fem.errors import SolverStopped, Stop
from fem.solver.record import Step
from fem.solver.step_control import STANDSTILL

CHECK_EVERY = 128  # steps between balances
LIMIT = 0.10  # imbalance at which a run stops


class Balance(NamedTuple):
    """Where the work has gone at `time` (s), energies in J.

    viscous is the work of the viscous stresses: minus the elastic energy that relaxation has spared
    so far. imbalance is relative to the largest of external work and stored energy so far (at least
    1e-6 mu V, the energy of a strain of about 0.1 %, so that the first faint touch does not count).
    """

    time: float
    kinetic: float
    strain: float
    hourglass: float
    viscous: float
    damping: float
    external: float
    imbalance: float


COLUMNS = Balance._fields


def worst_imbalance(rows: Sequence[Balance]) -> float:
    """The largest imbalance of some balances, NaN if one is not a number."""
    return float(np.max([row.imbalance for row in rows], initial=0.0))


def kinetic_share(rows: Sequence[Balance]) -> float:
    """Mean kinetic energy over mean strain energy of some balances."""
    kinetic, strain = sum(row.kinetic for row in rows), sum(row.strain for row in rows)
    return float(kinetic / max(strain, 1e-300))


class EnergyLedger:
    """Observer of a solver's steps: external work against kinetic, strain, hourglass, viscous and
    damping energy, in J.

    `rows` holds one Balance about every 128 steps, `smallest_J` the smallest J of all steps. Raises
    SolverStopped(ENERGY_IMBALANCE) beyond 10 %, there or in the last step of an `advance`.
    """

    def __init__(self) -> None:
        self.rows: list[Balance] = []
        self.scale, self.smallest_J = 0.0, 1.0
        self.external = self.damping = 0.0
        self._ahead = self._loss = self._dt = 0.0
        self._next = 0

    def __call__(self, step: Step) -> None:
        """Count the work of the step."""
        # the mean of the loads at both ends of a step times its displacement: exact for a dead load
        self.external += self._ahead + 0.5 * self._dt * np.vdot(step.load, step.v_before)
        self._ahead = 0.5 * step.dt * np.vdot(step.load, step.v_after)
        if step.body.damping:
            loss = 2 * step.body.damping * step.kinetic_energy()
            self.damping += 0.5 * self._dt * (self._loss + loss)
            self._loss = loss
        self._dt = step.dt
        self.smallest_J = min(self.smallest_J, step.min_J)
        if step.viscous_current and step.steps >= self._next:
            self._next = step.steps + CHECK_EVERY
            row = self.balance(step)
            self.scale = self._scale(step, row.kinetic + row.strain)
            self.rows.append(row)
            self._judge(row)
        elif step.last:
            self._judge(self.balance(step))

    def balance(self, step: Step) -> Balance:
        """The balance of the step just observed; at any step."""
        kinetic, strain, hourglass, viscous = step.energies()
        stored = kinetic + strain + hourglass + viscous + self.damping
        imbalance = abs(self.external - stored) / self._scale(step, kinetic + strain)
        return Balance(
            step.time,
            kinetic,
            strain,
            hourglass,
            viscous,
            self.damping,
            self.external,
            imbalance,
        )

    def worst_imbalance(self) -> float:
        """The largest imbalance of all rows."""
        return worst_imbalance(self.rows)

    def _scale(self, step, stored):
        return max(self.scale, step.body.negligible_energy, abs(self.external), stored)

    def _judge(self, row):
        if not row.imbalance <= LIMIT:
            raise SolverStopped.because(
                Stop.ENERGY_IMBALANCE,
                f"energy is out of balance by {100 * row.imbalance:.0f} % at {row.time:.4g} s",
            )


class FrameBalances:
    """Observer that comes after an EnergyLedger: a balance for each of the frames at `times` (s).

    A balance is taken at the last step before each frame in which the viscous stress is brought up
    to date, since its work is known best there. prony: of the material.
    """

    def __init__(
        self, ledger: EnergyLedger, times: np.ndarray, prony: Sequence[tuple[float, float]]
    ) -> None:
        self.ledger, self.times = ledger, times
        self._standstill = STANDSTILL * min((tau for _, tau in prony), default=0.0)
        self._found: dict[int, Balance] = {}

    def __call__(self, step: Step) -> None:
        """Take the balance of the step if it is the last such before its frame."""
        frame = int(np.searchsorted(self.times, step.time))
        early = self.times[frame] - step.time if frame < len(self.times) else np.inf
        near = step.viscous_current and early <= 1.01 * max(step.dt, self._standstill)
        # a frame shorter than the standstill has no such step: better its last than none
        if not step.steps or near or step.last and frame not in self._found:
            self._found[frame] = self.ledger.balance(step)

    @property
    def rows(self) -> list[Balance]:
        """The balances, in the order of time."""
        return [self._found[frame] for frame in sorted(self._found)]

    def at_frames(self) -> np.ndarray:
        """(frames, 7), the columns of Balance after time, interpolated to the frames."""
        rows = np.array(self.rows)
        return np.stack(
            [np.interp(self.times, rows[:, 0], column) for column in rows[:, 1:].T], axis=1
        )
