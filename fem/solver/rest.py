"""The state of rest under dead loads, by dynamic relaxation."""

from typing import NamedTuple

import numpy as np

from fem.errors import InputError, SolverStopped, Stop
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.ranges import checked, shown
from fem.solver.critical_step import thickness
from fem.solver.explicit import BLOCK, Solver

# steps over which `equilibrium` raises the load; the longer where the shorter crushes a cell
RAMPS = (160, 640, 2560)


class Equilibrium(NamedTuple):
    """displacement (N, 3) m; residual: |internal - external| / |external| over the free nodes;
    steps taken."""

    displacement: np.ndarray
    residual: float
    steps: int


def equilibrium(
    mesh: HexMesh,
    material: Hyperelastic,
    load: np.ndarray,
    residual: float = 1e-6,
    element: str = "full",
    max_steps: int = 50_000,
    allow_locking: bool = False,
) -> Equilibrium:
    """The state of rest under dead nodal loads (N, 3) in N, by dynamic relaxation: an Equilibrium.

    With Prony terms it is the fully relaxed state, in which the stress is g0 times the elastic one;
    give the material without them for the instantaneous answer. The load climbs over the first
    steps, more slowly if that crushes a cell on the way, and the damping follows the lowest
    frequency that the motion shows (Underwood 1983), so that this mode is damped critically.

    Raises InputError for a load of the wrong shape or not finite, SolverStopped(NOT_AT_REST) when
    `residual` is not reached in `max_steps`, and whatever Solver.advance raises. element and
    allow_locking: see fem.solver.explicit.Solver.
    """
    checked("residual", residual, 1e-14, 1)
    checked("max_steps", max_steps, 1, 10**9, whole=True)
    try:
        load = np.array(load, float)
    except (TypeError, ValueError):
        raise InputError(f"the load is {shown(load)}; give one force a node, in N") from None
    if load.shape != mesh.points.shape or not np.isfinite(load).all():
        raise InputError(
            f"the load must be finite and of shape {mesh.points.shape}, one force a node;"
            f" got shape {load.shape}"
        )
    load = np.where(mesh.fixed[:, None], 0.0, load).T
    relaxed = _relaxed(material)
    if not load.any():
        Solver(mesh, relaxed, element, allow_locking=allow_locking)  # refuses what has no meaning
        return Equilibrium(np.zeros(mesh.points.shape), 0.0, 0)
    thick = thickness(mesh)
    # rest does not depend on mass: give all cells one stable step
    heavier = np.square(thick.max() / thick)
    for ramp in RAMPS:
        solver = Solver(mesh, relaxed, element, mass_scaling=heavier, allow_locking=allow_locking)
        solver.gate = None  # the residual says how near rest is
        try:
            return _relax(solver, load, residual, ramp, max_steps)
        except SolverStopped as stop:
            if stop.reason is Stop.NOT_AT_REST or ramp == RAMPS[-1]:
                raise
    raise AssertionError("unreachable: the last ramp returns or raises")


def _relaxed(material):
    """The elastic material that is left when all viscous stress has gone."""
    return material.elastic().scaled(1 - sum(g for g, _ in material.prony))


def _relax(solver, load, residual, ramp, max_steps):
    """The Equilibrium of `solver` under `load` (3, N), which climbs over `ramp` steps."""
    leapfrog = solver.leapfrog
    leapfrog.damping = 0.1 / solver.max_step
    free, size = ~solver.mesh.fixed, np.linalg.norm(load)
    old_u, old_internal = solver.u.copy(), np.zeros_like(load)
    error = np.inf
    while solver.steps < max_steps:
        factor = min(1.0, (solver.steps + BLOCK) / ramp)
        part = factor * load
        solver.advance(BLOCK * solver.max_step, lambda t, part=part: part)
        internal = leapfrog.force(solver.u)
        du, df = solver.u - old_u, internal - old_internal
        old_u[:], old_internal[:] = solver.u, internal
        motion = np.einsum("cn,cn,n->", du, du, leapfrog.mass)
        if motion > 0:
            leapfrog.damping = 2 * np.sqrt(max(0.0, np.vdot(du, df) / motion))
        error = np.linalg.norm((internal - load)[:, free]) / size
        if factor == 1 and error <= residual:
            return Equilibrium(solver.u.T.copy(), float(error), solver.steps)
    raise SolverStopped.because(
        Stop.NOT_AT_REST,
        f"residual {error:.2g} after {max_steps} steps, {residual:.2g} was asked for",
    )
