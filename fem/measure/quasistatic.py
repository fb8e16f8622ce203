"""The quasi-static solver beside the explicit one: how much faster it is, how far apart they are,
and how fast a push may rise.

    python tools/benchmark_fem.py --quasistatic

Runs of one interaction take turns in one process, and ratios are of their CPU times.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fem.contact.push import Load, Push
from fem.contact.surface import surface_of
from fem.data.draws import drawn_contacts
from fem.data.scene import Scene, SolverChoice, load_scene
from fem.measure.machine import processor, versions
from fem.measure.speed import VISCOUS, Figures
from fem.mesh.shapes import tumour
from fem.solver.explicit import Solver
from fem.solver.load_ramp import NodalLoad
from fem.solver.quasistatic import QuasiStatic

CONFIGS = Path("configs")
RISES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # s
SCALED = 16.0  # mass scaling of the explicit solver that data are made with
DAMPING = 20.0  # 1/s, of the explicit solver, as in the shipped scenes
LONG = 2.5  # s, a long frame
Run = tuple[np.ndarray, float]  # displacements (times, 3, N) m, and CPU seconds


def run(solver: Solver | QuasiStatic, load: NodalLoad, times: np.ndarray) -> Run:
    """The displacements at `times`, and the CPU time that they took."""
    solver.gate = None
    start, found = time.process_time(), []
    for end in times:
        solver.advance(end - solver.time, load)
        found.append(solver.u.copy())
    return np.array(found), time.process_time() - start


def distance(u: np.ndarray, v: np.ndarray) -> float:
    """Relative L2 distance of u from v, in %."""
    return 100 * float(np.linalg.norm(u - v) / np.linalg.norm(v))


def scenes(scene: Scene) -> dict[str, Scene]:
    """The scene by each of the solvers."""
    element = scene.solver.element
    explicit = SolverChoice(element, damping=DAMPING)
    return {
        "true mass": scene.with_solver(explicit),
        "mass scaling 16": scene.with_solver(replace(explicit, mass_scaling=SCALED)),
        "quasi-static": scene.with_solver(SolverChoice(element, kind="quasistatic")),
    }


def pair(scene: Scene, split: str, number: int, frame: float, exact: bool) -> Figures:
    """One interaction by each solver, with frames of `frame` s; exact: at the true mass too."""
    mesh = scene.mesh.build()
    surface = surface_of(mesh)
    load = Load(surface, drawn_contacts(scene, surface, split, number, 0))
    times = np.arange(1, round(scene.frames.duration / frame) + 1) * frame
    kinds = scenes(scene)
    if not exact:
        del kinds["true mass"]
    kinds["quasi-static"].build_solver(mesh)  # the stiffness at rest is made once in a process
    found = {name: run(kind.build_solver(mesh), load, times) for name, kind in kinds.items()}
    u, seconds = found.pop("quasi-static")
    return {
        "interaction": f"{split} {number}",
        "seconds": round(seconds, 3),
        **{f"faster than {name}": round(other / seconds, 1) for name, (_, other) in found.items()},
        **{f"% from {name}": round(distance(u, v), 3) for name, (v, _) in found.items()},
    }


def rise_table(rises: Sequence[float]) -> list[Figures]:
    """Error of leaving inertia out of a push on the top that rises in `rises` s and is then held as
    long again, against the explicit solver at the true mass."""
    mesh = tumour()
    rows = []
    for rise in rises:
        load = Load(surface_of(mesh), [Push("top", 1e-3, 2.6e-3, ramp=rise)])
        times = np.arange(1, 41) / 20 * rise
        u, _ = run(QuasiStatic(mesh, VISCOUS, precision="float32"), load, times)
        row: Figures = {"rise_s": rise}
        for damping in (0.0, 20.0):
            solver = Solver(mesh, VISCOUS, precision="float32", damping=damping)
            v, _ = run(solver, load, times)
            row[f"% at damping {damping:g}/s"] = round(distance(u, v), 3)
        rows.append(row)
    return rows


def measure(quick: bool = False) -> Figures:
    """All tables, printed as Markdown, and their figures; quick: few and short runs."""
    names = "tumour", "tumour_long", "tumour_120s"
    read = [load_scene(CONFIGS / f"{name}.toml") for name in names]
    if quick:
        read = [replace(scene, frames=replace(scene.frames, count=21)) for scene in read]
    usual, long, longest = read
    numbers = (1,) if quick else (1, 2, 3, 4)
    splits = ("validation",) if quick else ("validation", "hard")
    result: Figures = {
        "machine": {"processor": processor(), "threads": 1, "versions": versions()},
        "frames of 0.25 s": [
            pair(usual, split, number, usual.frames.interval, exact=not quick)
            for split in splits
            for number in numbers
        ],
        "frames of 2.5 s": [
            pair(usual, split, number, LONG, False) for split in splits for number in numbers
        ],
        "frames of 2.5 s, 30 s": [pair(long, "test", number, LONG, False) for number in numbers],
        "frames of 0.25 s, 120 s": [
            pair(longest, "test", 3, longest.frames.interval, False),
        ],
        "rise": rise_table(RISES[:2] if quick else RISES),
    }
    for title, rows in result.items():
        if title != "machine":
            print(f"\n## {title}\n")
            print_table(rows)
    return result


def print_table(rows: list[Figures]) -> None:
    """Rows of the same keys as Markdown."""
    print("| " + " | ".join(rows[0]) + " |")
    print("|" + "---|" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(map(str, row.values())) + " |")
