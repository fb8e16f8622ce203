"""The state of rest under dead loads, by dynamic relaxation."""

from typing import NamedTuple

import numpy as np

from fem.errors import InputError, SolverStopped
from fem.solver.critical_step import thickness
from fem.solver.explicit import BLOCK, Solver

RAMPS = (
    160,
    640,
    2560,
)  # steps over which `equilibrium` raises the load; the longer where the shorter crushes a cell


class Equilibrium(NamedTuple):
    """displacement (N, 3) m; residual: |internal - external| / |external| over the free nodes;
    steps taken."""

    displacement: np.ndarray
    residual: float
    steps: int


def equilibrium(mesh, material, load, residual=1e-6, element="full", max_steps=50_000):
    """The state of rest under dead nodal loads (N, 3) in N, by dynamic relaxation: an Equilibrium.

    With Prony terms it is the fully relaxed state, in which the stress is g0 times the elastic one;
    give the material without them for the instantaneous answer. The load climbs over the first
    steps, more slowly if that crushes a cell on the way, and the damping follows the lowest
    frequency that the motion shows (Underwood 1983), so that this mode is damped critically.

    Raises InputError for a load of the wrong shape or not finite, SolverStopped("not at rest") when
    `residual` is not reached in `max_steps`, and whatever Solver.advance raises.
    """
    load = np.array(load, float)
    if load.shape != mesh.points.shape or not np.isfinite(load).all():
        raise InputError(
            f"the load must be finite and of shape {mesh.points.shape}, one force a node; got shape {load.shape}"
        )
    load = np.where(mesh.fixed[:, None], 0.0, load).T
    if not load.any():
        return Equilibrium(np.zeros(mesh.points.shape), 0.0, 0)
    share = 1 - sum(g for g, _ in material.prony)
    elastic = material.elastic().scaled(share)
    heavier = np.square(
        thickness(mesh).max() / thickness(mesh)
    )  # rest does not depend on mass: give all cells one stable step
    for ramp in RAMPS:
        try:
            return _relax(
                Solver(mesh, elastic, element, mass_scaling=heavier),
                load,
                residual,
                ramp,
                max_steps,
            )
        except SolverStopped as stop:
            if stop.reason == "not at rest" or ramp == RAMPS[-1]:
                raise


def _relax(solver, load, residual, ramp, max_steps):
    """The Equilibrium of `solver` under `load` (3, N), which climbs over `ramp` steps."""
    solver.damping = 0.1 / solver.max_step
    free, size = ~solver.mesh.fixed, np.linalg.norm(load)
    old_u, old_internal = solver.u.copy(), solver.internal.copy()
    while solver.steps < max_steps:
        factor = min(1.0, (solver.steps + BLOCK) / ramp)
        solver.advance(BLOCK * solver.max_step, lambda t: factor * load)
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
        "not at rest",
        f"residual {error:.2g} after {max_steps} steps, {residual:.2g} was asked for; fix the mesh, lower the load or raise max_steps",
    )
