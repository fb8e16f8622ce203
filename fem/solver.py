"""Explicit central-difference time integration (leapfrog) of a hexahedral mesh under nodal loads."""

from typing import NamedTuple

import numpy as np
import scipy.sparse.linalg

from fem import element
from fem.errors import InputError, SolverStopped
from fem.kernel import InternalForce

BLOCK = 16  # steps between load samples and guards
STRIDE = 64  # most steps between updates of the viscous stress
SMALLEST_J = 0.05  # below it a cell has lost its meaning, and p = K (J - 1) - mu / J runs away
STANDSTILL = 0.004  # share of the shortest relaxation time for which the viscous stress may stand still
RAMP_STEPS = 160  # over which `equilibrium` raises the load
NEGLIGIBLE = 1e-30  # m and m/s: subnormal numbers would slow a step sixteen-fold


def lumped_mass(mesh, density):
    """Row-sum lumped nodal mass (N,) in kg."""
    detJ = np.linalg.det(element.jacobians(mesh.points, mesh.cells, element.GAUSS))  # (E, Q)
    shape = np.prod(1 + element.GAUSS[:, None] * element.CORNERS, axis=2) / 8  # (Q, 8)
    return np.bincount(mesh.cells.ravel(), (density * detJ @ shape).ravel(), mesh.n_nodes)


def critical_time_step(force, mass, fixed, u=None, tolerance=1e-3):
    """2 / omega_max of the tangent stiffness at displacement u (3, N), in s, for a linear undamped leapfrog.

    The largest eigenvalue of M^-1 K comes from Lanczos iteration (power iteration that keeps its past vectors), with K v
    by central differences of `force`, an InternalForce in float64 without Prony terms. Lanczos approaches the eigenvalue
    from below, so the step is too large by at most about `tolerance`.
    """
    u = np.zeros((3, len(mass))) if u is None else u
    free = np.flatnonzero(~np.tile(fixed, 3))
    if not free.size:
        raise InputError("every node of the mesh is fixed: nothing can move; free a surface")
    root = 1 / np.sqrt(np.tile(mass, 3)[free])
    scale = 1e-6 * np.ptp(force.mesh.points[force.mesh.cells[0]], axis=0).min()
    v = np.zeros(u.size)

    def matvec(x):
        v[free] = root * x.ravel()
        size = scale / max(np.abs(v).max(), 1e-300)
        step = (size * v).reshape(u.shape)
        return (force(u + step) - force(u - step)).ravel()[free] * root / (2 * size)

    start = np.random.default_rng(0).normal(size=free.size)
    with np.errstate(all="ignore"):
        if free.size < 3:
            largest = np.linalg.norm(matvec(start)) / np.linalg.norm(start)
        else:
            operator = scipy.sparse.linalg.LinearOperator((free.size, free.size), matvec)
            try:
                largest = scipy.sparse.linalg.eigsh(operator, 1, which="LA", v0=start, tol=tolerance, return_eigenvectors=False)[0]
            except scipy.sparse.linalg.ArpackError as error:
                raise SolverStopped("no stable step", f"the stable step cannot be estimated ({error}); the state is beyond saving") from None
    if not (np.isfinite(largest) and largest > 0):
        raise SolverStopped("no stable step", f"the stiffness has no positive frequency (largest eigenvalue {largest:.3g}); lower the load")
    return 2 / np.sqrt(largest)


class Solver:
    """The state of one explicit simulation: displacement u and velocity v (3, N) in m and m/s, time in s.

    mesh, material, element, precision, hourglass_stiffness: see fem.kernel.InternalForce
    damping: mass-proportional damping rate alpha, 1/s: force -alpha m v
    mass_scaling: factor on the density, for slow scenes; the stable step grows with its root
    safety: share of the critical time step that is used

    The step is estimated again whenever the tissue has stiffened. A run that cannot go on raises SolverStopped, whose
    `reason` is "diverged", "crushed cell" or "no stable step".
    """

    def __init__(self, mesh, material, element="full", precision="float64", hourglass_stiffness=0.05, damping=0.0,
                 mass_scaling=1.0, safety=0.85):
        for name, value, low in (("damping", damping, 0), ("hourglass_stiffness", hourglass_stiffness, 0)):
            if not low <= value < np.inf:
                raise InputError(f"solver.{name} = {value} must not be negative")
        if not 1 <= mass_scaling < np.inf:
            raise InputError(f"solver.mass_scaling = {mass_scaling} must be at least 1 (1 is the true mass)")
        if not 0 < safety:
            raise InputError(f"solver.safety = {safety} must be positive; 0.85 is usual")
        self.mesh, self.material, self.damping, self.safety = mesh, material, float(damping), float(safety)
        self.force = InternalForce(mesh, material, element, precision, hourglass_stiffness)
        self.mass = lumped_mass(mesh, material.density * mass_scaling)
        elastic = type(material)(material.mu, material.nu, material.density)
        needs_own = precision != "float64" or material.prony
        self.tangent = InternalForce(mesh, elastic, element, "float64", hourglass_stiffness) if needs_own else self.force
        self.negligible_energy = 1e-6 * material.mu * mesh.volume()  # J
        self._inverse_mass = np.where(mesh.fixed, 0.0, 1.0 / self.mass)  # (N,) zero holds the fixed nodes
        self.u, self.v = np.zeros((3, mesh.n_nodes)), np.zeros((3, mesh.n_nodes))
        self.v_old, self.load = np.zeros_like(self.v), np.zeros_like(self.u)
        self.internal = np.zeros_like(self.u)
        self._drift = np.zeros_like(self.u)
        self.time, self.steps, self.dt = 0.0, 0, 0.0
        self.block_start = self.viscous_current = True
        self._shortest_relaxation = min((tau for _, tau in material.prony), default=None)
        self._until_relaxation, self._relaxed_at = 0, 0.0
        self.estimate_step()

    def estimate_step(self):
        """Set `critical_step` from the present state."""
        self.critical_step = critical_time_step(self.tangent, self.mass, self.mesh.fixed, self.u)
        self.tangent(self.u, check=True)
        self._state_at_estimate = self.tangent.min_J, self.tangent.stiffening

    @property
    def max_step(self):
        """The largest step in s that is taken from this state."""
        return self.safety * self.critical_step

    def advance(self, duration, load, observers=(), steps=None):
        """Integrate `duration` seconds; `load(t)` gives the nodal force (3, N) in N and is sampled every 16 steps.

        steps: take exactly this many, for a fixed latency (the caller then answers for duration / steps being stable);
        otherwise as many as the stable step asks for, and more when the tissue stiffens on the way.
        observers: each is called as observer(solver) in every step, when u, the force and load at `time` and the
        velocities half a step before (v_old) and after (v) are known.
        """
        end = self.time + duration
        remaining = steps
        load_now = np.asarray(load(self.time), float)
        while remaining is None and end - self.time > 1e-9 * duration or remaining:
            left = remaining or max(1, int(np.ceil((end - self.time) / self.max_step * (1 - 1e-12))))
            dt = (end - self.time) / left
            count = min(BLOCK, left)
            load_next = np.asarray(load(self.time + count * dt), float)
            with np.errstate(all="ignore"):  # an overflow is found, and named, by the guard
                self._block(dt, count, load_now, load_next, observers)
            load_now = load_next
            remaining = None if remaining is None else remaining - count
            self._guard()
        self.time = end

    def _block(self, dt, count, load_now, load_next, observers):
        np.copyto(self.load, load_now)
        slope = (load_next - load_now) / count
        ramp = slope.any()
        for i in range(count):
            self.block_start = i == 0
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

    def _viscous_stride(self, dt):
        """Steps for which the viscous stress may stand still: a small part of the shortest relaxation time."""
        return min(STRIDE, max(1, int(STANDSTILL * self._shortest_relaxation / dt)))

    def _kick(self, dt):
        """v at the next half step; the first kick is half a step long, and a change of step takes the mean of both."""
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
        """After each block: finite, not crushed, not past the stable step; flush what is too small to matter."""
        force = self.force
        if force.min_J <= SMALLEST_J:
            raise SolverStopped(
                "crushed cell",
                f"cell {force.worst_cell} is crushed to J = {force.min_J:.3g} before {self.time:.4g} s; lower the force or widen its footprint",
            )
        if not (np.isfinite(self.u).all() and np.isfinite(self.v).all() and np.isfinite(force.min_J)):
            raise SolverStopped(
                "diverged", f"the displacement is no longer finite at {self.time:.4g} s: the load is too large or too sudden"
            )
        for field in (self.u, self.v):
            field[np.abs(field) < NEGLIGIBLE] = 0.0
        J, stiffening = self._state_at_estimate
        # measured on loaded tissue: the critical step changes by at most 4 % between two estimates made so, far inside
        # the usual margin of 15 %; the last condition gives the longer step back after a release
        if force.min_J < 0.9 * J or force.stiffening > 1.05 * stiffening or force.min_J > 1.25 * J:
            self.estimate_step()



class Equilibrium(NamedTuple):
    """displacement (N, 3) m; residual: |internal - external| / |external| over the free nodes; steps taken."""

    displacement: np.ndarray
    residual: float
    steps: int


def equilibrium(mesh, material, load, residual=1e-6, element="full", max_steps=50_000):
    """The state of rest under dead nodal loads (N, 3) in N, by dynamic relaxation: an Equilibrium.

    With Prony terms it is the fully relaxed state, in which the stress is g0 times the elastic one; give the material
    without them for the instantaneous answer. The load climbs over the first steps, and the damping follows the
    lowest frequency that the motion shows (Underwood 1983), so that this mode is damped critically.

    Raises InputError for a load of the wrong shape or not finite, SolverStopped("not at rest") when `residual` is
    not reached in `max_steps`, and whatever Solver.advance raises.
    """
    load = np.array(load, float)
    if load.shape != mesh.points.shape or not np.isfinite(load).all():
        raise InputError(f"the load must be finite and of shape {mesh.points.shape}, one force a node; got shape {load.shape}")
    load = np.where(mesh.fixed[:, None], 0.0, load).T
    size = np.linalg.norm(load)
    if not size:
        return Equilibrium(np.zeros(mesh.points.shape), 0.0, 0)
    share = 1 - sum(g for g, _ in material.prony)
    solver = Solver(mesh, type(material)(material.mu * share, material.nu, material.density), element)
    solver.damping = 0.1 / solver.max_step
    free = ~mesh.fixed
    old_u, old_internal = solver.u.copy(), solver.internal.copy()
    while solver.steps < max_steps:
        factor = min(1.0, (solver.steps + BLOCK) / RAMP_STEPS)
        solver.advance(BLOCK * solver.max_step, lambda t: factor * load, steps=BLOCK)
        internal = solver.force(solver.u)
        du, df = solver.u - old_u, internal - old_internal
        old_u[:], old_internal[:] = solver.u, internal
        motion = np.einsum("cn,cn,n->", du, du, solver.mass)
        if motion > 0:
            solver.damping = 2 * np.sqrt(max(0.0, np.vdot(du, df) / motion))
        error = np.linalg.norm((internal - load)[:, free]) / size
        if factor == 1 and error <= residual:
            return Equilibrium(solver.u.T.copy(), float(error), solver.steps)
    raise SolverStopped(
        "not at rest", f"residual {error:.2g} after {max_steps} steps, {residual:.2g} was asked for; fix the mesh, lower the load or raise max_steps"
    )
