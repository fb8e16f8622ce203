"""The energy balance of a run, kept by an observer of the time loop."""

import warnings

import numpy as np

from fem.errors import SolverStopped

COLUMNS = ("time", "kinetic", "strain", "hourglass", "viscous", "damping", "external", "imbalance")
CHECK_EVERY = 128  # steps between balances
HOURGLASS_SHARE = 0.05  # of strain energy, beyond which the ledger warns, once
LIMIT = 0.10  # imbalance at which a run stops


class EnergyLedger:
    """Observer for `Solver.advance`: external work against kinetic, strain, hourglass, viscous and
    damping energy, in J.

    viscous is the work of the viscous stresses: minus the elastic energy that relaxation has spared
    so far. imbalance is relative to the largest of external work and stored energy so far (at least
    1e-6 mu V, the energy of a strain of about 0.1 %, so that the first faint touch does not count).
    `rows` holds one balance about every 128 steps, in the order of COLUMNS. Warns once when
    hourglass energy exceeds 5 % of strain energy. Raises SolverStopped("energy imbalance") beyond
    10 %, there or in the last step of an `advance`.
    """

    def __init__(self):
        self.rows, self.scale, self.smallest_J = [], 0.0, 1.0
        self.external = self.damping = 0.0
        self._ahead = self._loss = self._dt = 0.0
        self._next, self._warned = 0, False

    def __call__(self, solver):
        # velocity at `time`, second-order; the first kick is half a step long, and v_old is then
        # that velocity itself
        mean = 0.5 * (solver.v_old + solver.v) if solver.steps else solver.v_old
        # the mean of the loads at both ends of a step times its displacement: exact for a dead load
        self.external += self._ahead + 0.5 * self._dt * np.vdot(solver.load, solver.v_old)
        self._ahead = 0.5 * solver.dt * np.vdot(solver.load, solver.v)
        if solver.damping:
            loss = 2 * solver.damping * kinetic_energy(solver.mass, mean)
            self.damping += 0.5 * self._dt * (self._loss + loss)
            self._loss = loss
        self._dt = solver.dt
        self.smallest_J = min(self.smallest_J, solver.force.min_J)
        if solver.viscous_current and solver.steps >= self._next:
            self._next = solver.steps + CHECK_EVERY
            self._balance(solver)
        elif solver.last_step:
            self._judge(self.balance(solver))

    def balance(self, solver):
        """The balance of the step just observed, in the order of COLUMNS; at any step."""
        mean = 0.5 * (solver.v_old + solver.v) if solver.steps else solver.v_old
        strain, hourglass = solver.tangent.energies(solver.u)
        kinetic, viscous = kinetic_energy(solver.mass, mean), solver.force.viscous_energy(solver.u)
        stored = kinetic + strain + hourglass + viscous + self.damping
        scale = max(self.scale, solver.negligible_energy, abs(self.external), kinetic + strain)
        return (
            solver.time,
            kinetic,
            strain,
            hourglass,
            viscous,
            self.damping,
            self.external,
            abs(self.external - stored) / scale,
        )

    def _balance(self, solver):
        row = self.balance(solver)
        _, kinetic, strain, hourglass, *_ = row
        self.scale = max(self.scale, solver.negligible_energy, abs(self.external), kinetic + strain)
        self.rows.append(row)
        self._judge(row)
        if (
            hourglass > HOURGLASS_SHARE * strain
            and hourglass > 0.01 * self.scale
            and not self._warned
        ):
            self._warned = True
            warnings.warn(
                f"hourglass energy is {100 * hourglass / strain:.0f} % of strain energy at {solver.time:.4g} s (5 % is usual): "
                "the reduced element bends too coarsely here; refine the mesh or take element = 'full' or 'mean_dilatation'",
                RuntimeWarning,
                stacklevel=2,
            )

    def _judge(self, row):
        time, *_, imbalance = row
        if not imbalance <= LIMIT:
            raise SolverStopped(
                "energy imbalance",
                f"energy is out of balance by {100 * imbalance:.0f} % at {time:.4g} s; lower the step (solver.safety) or the load",
            )

    def worst_imbalance(self):
        return worst_imbalance(self.rows)


def worst_imbalance(rows):
    """The largest imbalance of some balances, NaN if one is not a number."""
    return float(np.max([row[-1] for row in rows], initial=0.0))


def kinetic_share(rows):
    """Mean kinetic energy over mean strain energy of some balances: below 0.05 the motion is slow
    enough for mass scaling."""
    return float(np.sum([row[1] for row in rows]) / max(np.sum([row[2] for row in rows]), 1e-300))


def hourglass_share(rows):
    """Largest hourglass energy over largest strain energy of some balances."""
    return float(max(row[3] for row in rows) / max(max(row[2] for row in rows), 1e-300))


def kinetic_energy(mass, v):
    return 0.5 * float(np.einsum("n,cn,cn->", mass, v, v))
