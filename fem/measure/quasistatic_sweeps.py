"""The rows of the map of limits that are the quasi-static solver's."""

from dataclasses import replace
from functools import partial

import numpy as np

from fem.errors import SolverStopped
from fem.material.neo_hooke import NeoHooke
from fem.measure.extreme_runs import (
    BLOCK,
    FORCE,
    PAPER,
    SMALL,
    TISSUE,
    difference,
    push,
    ramp,
)
from fem.measure.sweeps import FORCE as FORCES
from fem.measure.sweeps import MU, NU, Sweep, times
from fem.solver.internal_force import ELEMENTS
from fem.solver.quasistatic import QuasiStatic
from fem.solver.rest import equilibrium

LENGTHS = (1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6)  # s


def pushed(factor: float, material: NeoHooke = TISSUE, kind: str = "full") -> float:
    """A push of the elastic block with `factor` times the force against the block brought to rest
    by damping. A stop counts only where that stops too."""
    load = push(BLOCK, factor * FORCE)
    solver = QuasiStatic(BLOCK, material, kind, "float32")
    try:
        solver.advance(0.1, lambda t: ramp(0.1)(t) * load)
    except SolverStopped:
        try:
            equilibrium(BLOCK, material, load.T, 1e-5, kind)
        except SolverStopped as stop:
            raise stop from None
        return np.inf
    return difference(solver.u, equilibrium(BLOCK, material, load.T, 1e-5, kind).displacement.T)


def held(duration: float) -> float:
    """Error of the displacement of the paper's tissue after a small force was held for `duration`
    s, in one call, against the creep function that extreme_runs.hour has."""
    load = push(SMALL, 1e-6 * FORCE)
    elastic = equilibrium(SMALL, TISSUE, load.T, residual=1e-7).displacement.T
    solver = QuasiStatic(SMALL, PAPER)
    solver.advance(duration, lambda t: load)
    exact = 12.5 - 3.2365 * np.exp(-duration / 50.68) - 8.2635 * np.exp(-duration / 895.3)
    return abs(float(np.vdot(load, solver.u) / np.vdot(load, elastic)) / exact - 1)


def quasistatic_sweeps() -> list[Sweep]:
    """Stiffness, nu up to nearly incompressible, force, and the length of a call."""
    rest = "the block at rest after damping"
    return [
        Sweep(
            "quasi-static: mu, one push",
            MU,
            lambda f: pushed(1, replace(TISSUE, mu=f * TISSUE.mu)),
            rest,
            0.01,
            (0.01, 1),
            times,
        ),
        Sweep(
            "quasi-static: nu, mean_dilatation element",
            NU,
            lambda nu: pushed(1, replace(TISSUE, nu=nu), "mean_dilatation"),
            rest,
            0.01,
            (0.4999,),
        ),
        *(
            Sweep(
                f"quasi-static: force, {kind} element",
                FORCES,
                partial(pushed, kind=kind),
                rest,
                0.01,
                (1, 20) if kind == "full" else (),
                times,
            )
            for kind in ELEMENTS
        ),
        Sweep(
            "quasi-static: length of a call / s",
            LENGTHS,
            held,
            "closed form: creep function",
            0.01,
            (1e-4, 1e6),
            "{:g}".format,
        ),
    ]
