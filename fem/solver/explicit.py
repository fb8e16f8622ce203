"""Explicit central-difference time integration (leapfrog) of a hexahedral mesh under nodal
loads."""

import numpy as np

from fem.errors import InputError, SolverStopped
from fem.material.base import poisson_ratio, shear_modulus
from fem.mesh import element
from fem.solver.critical_step import critical_time_step, lumped_mass, thickness
from fem.solver.internal_force import InternalForce

BLOCK = 16  # most steps between load samples and guards
STRIDE = 64  # most steps between updates of the viscous stress
# above it the full element is more than 8 % too stiff under a footprint of 4 cells' radius, see
# docs/stability.md
LOCKING_NU = 0.45
SMALLEST_J = 0.05  # below it a cell has lost its meaning, and p = K (J - 1) - mu / J runs away
STANDSTILL = (
    0.004  # share of the shortest relaxation time for which the viscous stress may stand still
)
FASTEST_CRUSH = 0.1  # share of the smallest J that one step may take away
FIRST_STEP = (
    0.05  # share of the thinnest cell by which a sudden load may move a node in its first step
)
LOAD_BEND = (
    0.005  # share of the largest load so far by which its ramp between two samples may miss it
)
MOST_STEPS = 1e8  # of one call of `advance`: hours on any mesh
NEGLIGIBLE = 1e-30  # m and m/s: subnormal numbers would slow a step sixteen-fold


class Solver:
    """The state of one explicit simulation: displacement u and velocity v (3, N) in m and m/s, time
    in s.

    mesh, material, element, precision, hourglass_stiffness: see
    fem.solver.internal_force.InternalForce
    damping: mass-proportional damping rate alpha, 1/s: force -alpha m v
    mass_scaling: factor on the density, one or one a cell (E,), for slow scenes; the stable step
    grows with its root
    safety: share of the critical time step that is used

    The step is estimated again whenever the tissue has stiffened, and is shortened while cells are
    compressed fast. A run that cannot go on raises SolverStopped, whose `reason` is "diverged",
    "crushed cell", "inverted cell", "no stable step", "step too large" or "too many steps".
    """

    def __init__(
        self,
        mesh,
        material,
        element="full",
        precision="float64",
        hourglass_stiffness=0.2,
        damping=0.0,
        mass_scaling=1.0,
        safety=0.85,
    ):
        for name, value, low in (
            ("damping", damping, 0),
            ("hourglass_stiffness", hourglass_stiffness, 0),
        ):
            if not low <= value < np.inf:
                raise InputError(f"solver.{name} = {value} must not be negative")
        if np.shape(mass_scaling) not in ((), (mesh.n_cells,)):
            raise InputError(
                f"solver.mass_scaling has shape {np.shape(mass_scaling)}; give one factor, or one for each of the {mesh.n_cells} cells"
            )
        if not (np.min(mass_scaling) >= 1 and np.max(mass_scaling) < np.inf):
            raise InputError(
                f"solver.mass_scaling = {np.min(mass_scaling)} must be at least 1 (1 is the true mass)"
            )
        if not 0 < safety:
            raise InputError(f"solver.safety = {safety} must be positive; 0.85 is usual")
        nu = np.max(poisson_ratio(material))
        if element == "full" and nu > LOCKING_NU:
            raise InputError(
                f"solver.element = 'full' locks at material.nu = {nu} (above {LOCKING_NU}); use element = 'mean_dilatation' or 'reduced'"
            )
        self.mesh, self.material, self.damping, self.safety = (
            mesh,
            material,
            float(damping),
            float(safety),
        )
        self.force = InternalForce(mesh, material, element, precision, hourglass_stiffness)
        self.mass = lumped_mass(mesh, material.density * np.asarray(mass_scaling, float))
        needs_own = precision != "float64" or material.prony
        self.tangent = (
            InternalForce(mesh, material.elastic(), element, "float64", hourglass_stiffness)
            if needs_own
            else self.force
        )
        self.negligible_energy = 1e-6 * np.mean(shear_modulus(material)) * mesh.volume()  # J
        self._inverse_mass = np.where(
            mesh.fixed, 0.0, 1.0 / self.mass
        )  # (N,) zero holds the fixed nodes
        self.u, self.v = np.zeros((3, mesh.n_nodes)), np.zeros((3, mesh.n_nodes))
        self.v_old, self.load = np.zeros_like(self.v), np.zeros_like(self.u)
        self.internal = np.zeros_like(self.u)
        self._drift = np.zeros_like(self.u)
        self.time, self.steps, self.dt = 0.0, 0, 0.0
        self.last_step, self.viscous_current = False, True
        self._thinnest, self._cap, self._last_J = thickness(mesh), np.inf, 1.0
        self._load_size, self._load_rate, self._load_steps = 0.0, 0.0, BLOCK
        self._shortest_relaxation = min((tau for _, tau in material.prony), default=None)
        self._until_relaxation, self._relaxed_at = 0, 0.0
        self.estimate_step()

    def estimate_step(self):
        """Set `critical_step` from the present state. Raises SolverStopped("inverted cell") if a
        corner is turned inside out."""
        corners = element.corner_jacobians(
            (self.mesh.points.T + self.u)[:, self.mesh.cells.T]
        )  # (8, E)
        if not corners.min() > 0:
            raise SolverStopped(
                "inverted cell",
                f"cell {corners.min(axis=0).argmin()} is turned inside out at a corner at {self.time:.4g} s; lower the force or widen its footprint",
            )
        self.critical_step = critical_time_step(self.tangent, self.mass, self.mesh.fixed, self.u)
        self.tangent(self.u, check=True)
        self._state_at_estimate = self.tangent.min_J, self.tangent.stiffening

    @property
    def max_step(self):
        """The largest step in s that is taken from this state."""
        return self.safety * self.critical_step

    def advance(self, duration, load, observers=(), steps=None):
        """Integrate `duration` seconds under the nodal force `load(t)` (3, N) in N.

        The load is sampled every 16 steps, more often where it bends, and runs linearly between:
        what starts and ends between two samples is not seen.

        steps: take exactly this many, for a fixed latency, and stop where duration / steps exceeds
        the critical step; otherwise as many as the stable step asks for, and more when the tissue
        stiffens on the way.
        observers: each is called as observer(solver) in every step, when u, the force and load at
        `time` and the velocities half a step before (v_old) and after (v) are known.
        """
        end = self.time + duration
        remaining = steps
        load_now = np.asarray(load(self.time), float)
        self._expect_jump(load_now)
        while remaining is None and end - self.time > 1e-9 * duration or remaining:
            left = remaining or self._steps_to(end)
            dt = (end - self.time) / left
            if dt > self.critical_step:
                raise SolverStopped(
                    "step too large",
                    f"the time step {dt:.3g} s exceeds the critical {self.critical_step:.3g} s; take more steps, lower solver.safety or raise mass_scaling",
                )
            count, load_next = self._sample(
                load, load_now, dt, min(BLOCK, left, 2 * self._load_steps)
            )
            with np.errstate(all="ignore"):  # an overflow is found, and named, by the guard
                done = self._block(dt, count, left, load_now, load_next, observers)
            load_now = load_next if done == count else self.load.copy()
            remaining = None if remaining is None else remaining - done
            self._guard()
        self.time = end

    def _steps_to(self, end):
        self._cap = min(
            2 * self._cap, self.max_step
        )  # what a fast motion has shortened grows again
        dt = min(self.max_step, self._cap)
        if not (end - self.time) / dt < MOST_STEPS:
            if dt < self.max_step:
                raise SolverStopped(
                    "no stable step",
                    f"only steps of {dt:.2g} s would follow the motion at {self.time:.4g} s; lower the load",
                )
            raise SolverStopped(
                "too many steps",
                f"{(end - self.time) / dt:.2g} steps of {dt:.2g} s are left; repair cell {self._thinnest.argmin()}, the thinnest, or raise mass_scaling",
            )
        return max(1, int(np.ceil((end - self.time) / dt * (1 - 1e-12))))

    def _sample(self, load, load_now, dt, count):
        """(steps, load at their end): up to `count`, fewer where the load bends away from its ramp
        so far."""
        while True:
            load_next = np.asarray(load(self.time + count * dt), float)
            self._load_size = max(self._load_size, np.abs(load_next).max())
            bend = (
                np.abs(load_next - load_now - count * dt * self._load_rate).max() / 8
            )  # of a parabola from its chord
            if count == 1 or not bend > LOAD_BEND * self._load_size:  # a NaN is left to the guard
                self._load_rate, self._load_steps = (load_next - load_now) / (count * dt), count
                return count, load_next
            count //= 2

    def _expect_jump(self, load):
        """Under a sudden load, start with a step in which no node moves farther than a small part
        of a cell."""
        acceleration = np.abs(
            (load - self.load) * self._inverse_mass
        ).max()  # a NaN is left to the guard
        if acceleration > 0:
            self._cap = min(
                self._cap, 0.5 * np.sqrt(2 * FIRST_STEP * self._thinnest.min() / acceleration)
            )

    def _block(self, dt, count, left, load_now, load_next, observers):
        """Up to `count` of the `left` steps, fewer if a cell is compressed fast: the number
        taken."""
        np.copyto(self.load, load_now)
        slope = (load_next - load_now) / count
        ramp = slope.any()
        for i in range(count):
            self.last_step = i + 1 == left
            self.viscous_current = self._until_relaxation == 0
            if self.viscous_current and self._shortest_relaxation:
                self._until_relaxation = self._viscous_stride(dt)
                self.force.relax(self.time - self._relaxed_at, (self._until_relaxation - 1) * dt)
                self._relaxed_at = self.time
            self.force(self.u, out=self.internal, check=i == 0)
            self._kick(dt)
            for observer in observers:
                observer(self)
            self.u += np.multiply(self.v, dt, out=self._drift)
            self.time += dt
            self.steps += 1
            self._until_relaxation = max(0, self._until_relaxation - 1)
            if ramp:
                self.load += slope
            if self._pressed(dt):
                return i + 1
        return count

    def _pressed(self, dt):
        """Whether the guard must look now: a cell is crushed, near it, or on its way by the next
        step."""
        J, loss = self.force.min_J, self._last_J - self.force.min_J
        self._last_J = J
        if loss > FASTEST_CRUSH * J:
            self._cap = 0.5 * dt * FASTEST_CRUSH * max(J, SMALLEST_J) / loss
            return True
        return not J >= 0.9 * self._state_at_estimate[0]

    def _viscous_stride(self, dt):
        """Steps for which the viscous stress may stand still: a small part of the shortest
        relaxation time."""
        return min(STRIDE, max(1, int(STANDSTILL * self._shortest_relaxation / dt)))

    def _kick(self, dt):
        """v at the next half step; the first kick is half a step long, and a change of step takes
        the mean of both."""
        kick = (self.dt + dt) / 2
        self.dt = dt
        self.v_old, self.v = self.v, self.v_old
        np.subtract(self.load, self.internal, out=self.v)
        self.v *= self._inverse_mass
        if self.damping:
            self.v *= kick / (1 + self.damping * kick / 2)
            self.v += (1 - self.damping * kick / 2) / (1 + self.damping * kick / 2) * self.v_old
        else:
            self.v *= kick
            self.v += self.v_old

    def _guard(self):
        """After each block: finite, not crushed, not past the stable step; flush what is too small
        to matter."""
        force = self.force
        if force.min_J <= SMALLEST_J:
            raise SolverStopped(
                "crushed cell",
                f"cell {force.worst_cell} is crushed to J = {force.min_J:.3g} before {self.time:.4g} s; lower the force or widen its footprint",
            )
        if not (
            np.isfinite(self.u).all() and np.isfinite(self.v).all() and np.isfinite(force.min_J)
        ):
            raise SolverStopped(
                "diverged",
                f"the displacement is no longer finite at {self.time:.4g} s: the load is too large or too sudden",
            )
        for field in (self.u, self.v):
            field[np.abs(field) < NEGLIGIBLE] = 0.0
        J, stiffening = self._state_at_estimate
        # measured on loaded tissue: the critical step changes by at most 4 % between two estimates
        # made so, far inside
        # the usual margin of 15 %; the last condition gives the longer step back after a release
        if force.min_J < 0.9 * J or force.stiffening > 1.05 * stiffening or force.min_J > 1.11 * J:
            self.estimate_step()
