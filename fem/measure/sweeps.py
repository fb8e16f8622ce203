"""The rows of the map of limits: one setting each, from one end to the other, and how its runs are
judged."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from fem.measure import extreme_runs as runs
from fem.measure.extreme_runs import STRETCH, TISSUE
from fem.mesh.shapes import box
from fem.solver.internal_force import ELEMENTS

RATIOS = (0.5, 0.7, 0.85, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1)
MU = (0.01, 0.1, 1, 10, 100, 1000)
NU = (0.0, 0.3, 0.42, 0.45, 0.49, 0.499, 0.4999)
FORCE = (0.1, 0.5, 1, 2, 5, 10, 20)
TAU = (1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 1e2, 1e4, 1e6)
HOURS = tuple((kind, precision) for kind in ELEMENTS for precision in ("float64", "float32"))
LAYERS = (0.1, 0.01, 1e-3, 1e-4, 0.0)
SCALINGS = (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536)
HOURGLASS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
CRUSH = (4, 5, 6, 6.5, 7, 7.5, 8)
CORNERS = (0.1, 1e-2, 1e-4, 1e-6, 0.0, -0.1)


@dataclass(frozen=True)
class Sweep:
    """A row of the map: `run(value)` returns the relative error, and may raise SolverStopped or
    InputError.

    quick: the values that --quick takes; label: text of a value.
    """

    name: str
    values: tuple
    run: Callable[..., float]
    reference: str
    tolerance: float
    quick: tuple = ()
    label: Callable[..., str] = str


def times(value: float) -> str:
    """Label of a factor."""
    return f"x{value:g}"


def sweeps() -> list[Sweep]:
    """The rows of the map."""
    exact, step, creep = (
        "closed form u = a z",
        "step of 0.08 of the critical, float64",
        "closed form: creep function",
    )
    block = box((4, 4, 3), runs.EDGE, "bottom")
    return [
        Sweep(
            "step / critical step, gentle push",
            RATIOS,
            lambda r: runs.pushed(0.1, safety=r),
            step,
            0.02,
            (0.85, 1.0, 1.02),
        ),
        Sweep(
            "step / critical step, tissue stiffens",
            RATIOS,
            lambda r: runs.pushed(5, safety=r),
            step,
            0.03,
            (0.85, 1.1),
        ),
        Sweep(
            "fixed number of steps, tissue stiffens",
            RATIOS,
            runs.fixed_steps,
            step,
            0.03,
            (0.5, 1.0),
        ),
        Sweep(
            "mu, one force, warped mesh",
            MU,
            lambda f: runs.uniform(
                runs.warped(block), replace(TISSUE, mu=f * TISSUE.mu), STRETCH / 40 / f
            ),
            exact,
            1e-4,
            (0.01, 1000),
            times,
        ),
        Sweep(
            "mu, one push of a footprint",
            MU,
            lambda f: runs.pushed(1, replace(TISSUE, mu=f * TISSUE.mu), damping=50.0, refined=0.28),
            "a third of the step, float64",
            0.02,
            (0.01, 1),
            times,
        ),
        *(
            Sweep(
                f"nu, {kind} element",
                NU,
                lambda nu, kind=kind: abs(runs.stiffness_error(nu, kind)),
                "cells of half the size, mean dilatation",
                0.08,
            )
            for kind in ELEMENTS
        ),
        *(
            Sweep(
                f"force, {kind} element",
                FORCE,
                partial(runs.pushed, damping=50.0, element=kind, refined=0.28),
                "a third of the step, float64",
                0.02,
                (1, 20),
                times,
            )
            for kind in ELEMENTS
        ),
        *(
            Sweep(
                f"sudden force, {kind} element",
                (1, 2, 5, 10, 20),
                partial(runs.pushed, scale=runs.sudden, duration=0.03, element=kind),
                step,
                0.1,
                (1, 20),
                times,
            )
            for kind in ELEMENTS
        ),
        Sweep(
            "relaxation time / s, held for 0.5 s",
            TAU,
            lambda tau: runs.creep(((0.5, tau),), 0.5, runs.one_term(0.5, tau, 0.5)),
            creep,
            0.01,
            (1e-6, 0.1, 1e6),
            "{:g}".format,
        ),
        Sweep(
            "sum of g, held for 4000 relaxation times",
            (0.5, 0.9, 0.99, 0.999, 1.0),
            lambda g: runs.creep(((g, 1e-3),), 4.0, runs.one_term(min(g, 0.9999), 1e-3, 4.0)),
            creep,
            0.02,
            (1.0,),
        ),
        Sweep(
            "density contrast",
            (1, 10, 100),
            lambda f: runs.pushed(2, mass_scaling=runs.densities(f)),
            step,
            0.02,
            (100,),
            times,
        ),
        Sweep(
            "element-size contrast",
            (1, 10, 100),
            lambda f: runs.on_all_elements(runs.graded(f)),
            exact,
            1e-4,
            (10,),
            times,
        ),
        Sweep(
            "sliver: thickness / edge",
            LAYERS,
            lambda t: runs.on_all_elements(runs.bad_cell("sliver", t)),
            exact,
            1e-4,
            (0.1, 0.0),
            "{:g}".format,
        ),
        Sweep(
            "Jacobian of one corner / cube's",
            CORNERS,
            lambda d: runs.on_all_elements(runs.bad_cell("corner", d)),
            exact,
            1e-4,
            (1e-4, -0.1),
            "{:g}".format,
        ),
        *(
            Sweep(
                f"mass scaling, slow push x{factor:g}, damping {damping:g} / s",
                SCALINGS,
                partial(runs.scaled_mass, factor, damping),
                "the true mass",
                0.04,
                (16, 16384) if factor == 1 else (),
                times,
            )
            for factor, damping in ((1, 20.0), (4, 20.0), (1, 0.0))
        ),
        *(
            Sweep(
                f"hourglass stiffness / mu, {label} push",
                HOURGLASS,
                partial(runs.hourglass, label),
                "cells of half the size, mean dilatation",
                0.1,
                (0.0, 0.2) if label == "narrow" else (),
            )
            for label in runs.PUSHES
        ),
        Sweep(
            "crushed corners, slow push",
            CRUSH,
            runs.crushed,
            "a third of the step, float64",
            0.02,
            (7,),
            times,
        ),
        Sweep(
            "float32 against float64",
            tuple(runs.SINGLE),
            runs.single_precision,
            "float64, the same steps",
            1e-5,
            ("strain 1e-9", "push x1"),
        ),
        Sweep(
            "one hour of a held force",
            HOURS,
            runs.hour,
            creep,
            0.01,
            (),
            lambda choice: " ".join(choice).replace("_dilatation", "").replace("float", "f"),
        ),
    ]
