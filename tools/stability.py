"""Map where the solver is accurate and where it stops, and write docs/stability.md and
docs/stability.png.

    python tools/stability.py [--quick] [--only WORD] [--out docs]

Every cell of the map is one run at an extreme setting. It ends as accurate, with its error against
a reference, or as stopped, with the solver's reason. An error above the sweep's tolerance is WRONG,
and so is a run that does not come to an end; the command then exits with 1. The runs are in
stability_runs.py, the figure and the text in stability_report.py.
"""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")  # before NumPy is imported

import argparse  # noqa: E402
import signal  # noqa: E402
import sys  # noqa: E402
import time  # noqa: E402
from dataclasses import dataclass, replace  # noqa: E402
from functools import partial  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402
import stability_report  # noqa: E402, beside this file
import stability_runs as runs  # noqa: E402, beside this file
from stability_runs import STRETCH, TISSUE  # noqa: E402

from fem.commands import command_line  # noqa: E402
from fem.errors import InputError, SolverStopped  # noqa: E402
from fem.mesh.shapes import box  # noqa: E402
from fem.solver.internal_force import ELEMENTS  # noqa: E402

HANG = 300  # s after which a run counts as hanging
REFUSALS = {
    "inverted": "inverted cell",
    "locks": "locking element",
    "add up to": "not a solid",
}  # word of an InputError: short reason


@dataclass(frozen=True)
class Sweep:
    """A row of the map: `run(value)` returns the relative error, and may raise SolverStopped or
    InputError.

    quick: the values that --quick takes; label: text of a value.
    """

    name: str
    values: tuple
    run: object
    reference: str
    tolerance: float
    quick: tuple = ()
    label: object = str


@dataclass(frozen=True)
class Cell:
    """status: "accurate", "stopped" or "WRONG"; error: relative, NaN if stopped; reason: why it
    stopped."""

    sweep: Sweep
    value: str
    status: str
    error: float
    reason: str
    seconds: float


def evaluate(sweep, value):
    """The Cell of one value of a sweep."""
    start, error, status, reason = time.perf_counter(), np.nan, "stopped", ""
    signal.signal(signal.SIGALRM, _hangs)
    signal.alarm(HANG)
    try:
        with np.errstate(all="ignore"):
            error = float(sweep.run(value))
        status = "accurate" if error <= sweep.tolerance else "WRONG"
    except SolverStopped as stop:
        reason = stop.reason
    except InputError as refusal:
        reason = next(
            (short for word, short in REFUSALS.items() if word in str(refusal)), str(refusal)
        )
    except TimeoutError:
        status, reason = "WRONG", "hangs"
    finally:
        signal.alarm(0)
    return Cell(sweep, sweep.label(value), status, error, reason, time.perf_counter() - start)


def _hangs(*_):
    raise TimeoutError


RATIOS = (0.5, 0.7, 0.85, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1)
MU = (0.01, 0.1, 1, 10, 100, 1000)
NU = (0.0, 0.3, 0.42, 0.45, 0.49, 0.499, 0.4999)
FORCE = (0.1, 0.5, 1, 2, 5, 10, 20)
TAU = (1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 1e2, 1e4, 1e6)
HOURS = tuple((kind, precision) for kind in ELEMENTS for precision in ("float64", "float32"))
LAYERS = (0.1, 0.01, 1e-3, 1e-4, 0.0)
CORNERS = (0.1, 1e-2, 1e-4, 1e-6, 0.0, -0.1)


def times(value):
    return f"x{value:g}"


def sweeps():
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


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="a few cells of most sweeps, in a quarter of a minute"
    )
    parser.add_argument(
        "--only", default="", help="sweeps whose name contains this word, printed and not written"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("docs"), help="folder of stability.md and stability.png"
    )
    options = parser.parse_args(arguments)
    start, cells = time.perf_counter(), []
    for sweep in sweeps():
        for value in (
            (sweep.quick if options.quick else sweep.values) if options.only in sweep.name else ()
        ):
            cell = evaluate(sweep, value)
            cells.append(cell)
            outcome = "" if np.isnan(cell.error) else f"{cell.error:.1e}"
            print(
                f"{sweep.name:42} {cell.value:>12}  {cell.status:8} {outcome}{cell.reason}  ({cell.seconds:.1f} s)",
                flush=True,
            )
    counts = {
        status: sum(cell.status == status for cell in cells)
        for status in ("accurate", "stopped", "WRONG")
    }
    print(
        f"{len(cells)} cells in {time.perf_counter() - start:.0f} s: "
        + ", ".join(f"{n} {status}" for status, n in counts.items())
    )
    if not options.only:
        stability_report.write(
            options.out, cells, counts, [] if options.quick else runs.locking(NU)
        )
        print(f"wrote {options.out / 'stability.md'} and {options.out / 'stability.png'}")
    sys.exit(counts["WRONG"] > 0)


if __name__ == "__main__":
    main()
