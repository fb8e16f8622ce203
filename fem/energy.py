"""The energy balance of a run, kept by an observer of the time loop."""

import numpy as np

from fem.errors import SolverStopped

COLUMNS = ("time", "kinetic", "strain", "hourglass", "viscous", "damping", "external", "imbalance")
CHECK_EVERY = 8  # blocks between balances
LIMIT = 0.10  # imbalance at which a run stops


class EnergyLedger:
    """Observer for `Solver.advance`: external work against kinetic, strain, hourglass, viscous and damping energy, in J.

    viscous is the work of the viscous stresses: minus the elastic energy that relaxation has spared so far.
    imbalance is relative to the largest of external work and stored energy so far (at least 1e-6 mu V, the energy of a
    strain of about 0.1 %, so that the first faint touch does not count). `rows` holds one balance each
    128 steps, in the order of COLUMNS. Raises SolverStopped("energy imbalance") beyond 10 %.
    """

    def __init__(self):
        self.rows, self.scale, self.smallest_J = [], 0.0, 1.0
        self.external = self.damping = 0.0
        self._power = self._loss = 0.0
        self._blocks = 0

    def __call__(self, solver):
        mean = 0.5 * (solver.v_old + solver.v)  # velocity at `time`, second-order
        power = np.vdot(solver.load, mean)
        self.external += 0.5 * solver.dt * (self._power + power)
        self._power = power
        if solver.damping:
            loss = 2 * solver.damping * kinetic_energy(solver.mass, mean)
            self.damping += 0.5 * solver.dt * (self._loss + loss)
            self._loss = loss
        if solver.block_start:
            self.smallest_J = min(self.smallest_J, solver.force.min_J)
            if self._blocks % CHECK_EVERY == 0:
                self._balance(solver, mean)
            self._blocks += 1

    def _balance(self, solver, mean):
        strain, hourglass = solver.tangent.energies(solver.u)
        kinetic, viscous = kinetic_energy(solver.mass, mean), solver.force.viscous_work
        stored = kinetic + strain + hourglass + viscous + self.damping
        self.scale = max(self.scale, solver.negligible_energy, abs(self.external), kinetic + strain)
        imbalance = abs(self.external - stored) / self.scale
        self.rows.append((solver.time, kinetic, strain, hourglass, viscous, self.damping, self.external, imbalance))
        if not imbalance <= LIMIT:
            raise SolverStopped(
                "energy imbalance", f"energy is out of balance by {100 * imbalance:.0f} % at {solver.time:.4g} s; lower the step (solver.safety) or the load"
            )

    def worst_imbalance(self):
        return max((row[-1] for row in self.rows), default=0.0)

    def kinetic_share(self):
        """Mean kinetic energy over mean strain energy: below 0.05 the motion is slow enough for mass scaling."""
        rows = np.array(self.rows)
        return float(rows[:, 1].mean() / max(rows[:, 2].mean(), 1e-300))


def kinetic_energy(mass, v):
    return 0.5 * float(np.einsum("n,cn,cn->", mass, v, v))
