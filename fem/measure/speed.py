"""How fast the finite-element solver is on one core, beside a plain NumPy step and felupe.

Every figure of a table comes from one process, with the variants taking turns, so that their ratios
hold even when the machine's speed drifts. felupe is optional (pip install -e '.[test]').
tools/benchmark_fem.py is the command.
"""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any

import numpy as np

from fem.material.neo_hooke import NeoHooke
from fem.measure.machine import processor, versions
from fem.measure.timing import alternate, paired_ratio, quantiles
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box, tumour
from fem.solver.explicit import BLOCK, Solver
from fem.solver.step_control import STRIDE

Force = Callable[[np.ndarray], np.ndarray]
Figures = dict[str, Any]  # as JSON holds them
ELASTIC = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
VISCOUS = NeoHooke(mu=400.0, nu=0.42, density=1000.0, prony=((0.12, 330.0), (0.8, 11.0)))
FRAME = 0.010  # s of simulated time that a haptic loop asks for at once
BOXES = {"10 thousand": (27, 27, 14), "100 thousand": (60, 60, 28), "1 million": (120, 120, 70)}
VARIANTS = [
    (kind, precision, name, material)
    for kind in ("full", "reduced")
    for precision in ("float64", "float32")
    for name, material in (("elastic", ELASTIC), ("viscoelastic", VISCOUS))
]


def plain_force(mesh: HexMesh, material: NeoHooke) -> Force:
    """The internal force as a first draft would have it: einsum, an inverse in every point,
    np.add.at."""
    jacobian = element.jacobians(mesh.points, mesh.cells, element.GAUSS)
    gradient = np.einsum(
        "qra,eqrj->eqaj", element.shape_gradients(element.GAUSS), np.linalg.inv(jacobian)
    )
    weight = np.linalg.det(jacobian)

    def force(u):
        F = np.eye(3) + np.einsum("eai,eqaj->eqij", u.T[mesh.cells], gradient)
        J = np.linalg.det(F)[..., None, None]
        cof = J * np.linalg.inv(F).swapaxes(-1, -2)
        P = material.mu * F + (material.K * (J - 1) - material.mu / J) * cof
        cells = np.einsum("eqij,eqaj,eq->eai", P, gradient, weight)
        out = np.zeros_like(mesh.points)
        np.add.at(out, mesh.cells, cells)
        return out

    return force


def felupe_force(mesh: HexMesh, material: NeoHooke) -> Force | None:
    """The same force assembled by felupe, or None if it is not installed."""
    try:
        import felupe
    except ImportError:
        return None
    region = felupe.RegionHexahedron(felupe.Mesh(mesh.points, mesh.cells, "hexahedron"))
    law = felupe.NeoHookeCompressible(mu=material.mu) & felupe.Volumetric(bulk=material.K)
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    body = felupe.SolidBody(law, field)

    def force(u):
        field[0].values[:] = u.T
        return body.assemble.vector(field=field).toarray()

    return force


def gentle_load(mesh: HexMesh) -> np.ndarray:
    """A constant nodal load on the free surface that moves the tissue by a few per cent of a
    cell."""
    load = np.zeros((3, mesh.n_nodes))
    nodes = np.unique(mesh.contact_faces)
    load[2, nodes] = -20.0 * mesh.volume() ** (2 / 3) / len(nodes)  # about 20 Pa
    return load


class Run:
    """One solver that takes STRIDE steps at a time, so that updates of the viscous stress have
    their full share."""

    def __init__(
        self, mesh: HexMesh, kind: str, precision: str, material: NeoHooke, steps: int = STRIDE
    ) -> None:
        self.solver = Solver(mesh, material, kind, precision, damping=50.0)
        self.load, self.steps = gentle_load(mesh), steps
        self.duration = steps * self.solver.max_step

    def __call__(self) -> int:
        """Take the steps; their number."""
        self.solver.advance(self.duration, lambda t: self.load, steps=self.steps)
        return self.steps


def tumour_table(rounds: int) -> Figures:
    """Microseconds per step of all variants and both yardsticks on the tumour."""
    mesh = tumour()
    actions: dict[str, Callable[[], object]] = {
        f"{kind} {precision} {name}": Run(mesh, kind, precision, material)
        for kind, precision, name, material in VARIANTS
    }
    u = 1e-5 * np.random.default_rng(0).normal(size=(3, mesh.n_nodes))
    yardsticks = {
        "plain einsum + np.add.at (force alone)": plain_force(mesh, ELASTIC),
        "felupe (force alone)": felupe_force(mesh, ELASTIC),
    }
    reference = Run(mesh, "full", "float64", ELASTIC).solver.force
    for name, force in yardsticks.items():
        if force is not None:
            got = force(u).reshape(-1, 3).T  # the same work
            np.testing.assert_allclose(got, reference(u), rtol=1e-9, atol=1e-15)
            actions[name] = partial(_apply, force, u)
    times = {name: 1e6 * values for name, values in alternate(actions, rounds).items()}
    base = times["full float64 elastic"]
    print("\n## The tumour, 1314 hexahedra, microseconds a step\n")
    print("| variant | p10 | p50 | p90 | against full float64 elastic (p50 of paired ratios) |")
    print("|---|---|---|---|---|")
    result = {}
    for name, values in times.items():
        ratio = paired_ratio(values, base)
        result[name] = quantiles(values, (10, 50, 90), 1) | {"ratio": round(ratio, 3)}
        quoted = " | ".join(f"{result[name][q]:.0f}" for q in ("p10", "p50", "p90"))
        print(f"| {name} | {quoted} | {ratio:.2f} |")
    print("\nViscoelastic over elastic, paired: ", end="")
    for kind in ("full", "reduced"):
        for precision in ("float64", "float32"):
            ratio = paired_ratio(
                times[f"{kind} {precision} viscoelastic"], times[f"{kind} {precision} elastic"]
            )
            result[f"{kind} {precision} viscoelastic"]["over elastic"] = round(ratio, 3)
            print(f"{kind} {precision} {ratio:.2f}", end="; ")
    print()
    return result


def _apply(force, u):
    force(u)


def frame_table(rounds: int) -> Figures:
    """Milliseconds for one frame of 10 ms at fixed latency: as many steps as the stable step asks
    for, and fewer."""
    mesh, result = tumour(), {}
    print("\n## One frame of 10 ms at fixed latency, viscoelastic float32, milliseconds\n")
    print("| element | steps a frame | mass scaling | p10 | p50 | p90 |\n|---|---|---|---|---|---|")
    for kind in ("full", "reduced"):
        for steps in (44, 22, 11):
            scaling = max(1.0, (44 / steps) ** 2)
            solver = Solver(mesh, VISCOUS, kind, "float32", damping=50.0, mass_scaling=scaling)
            load = gentle_load(mesh)

            def frame(solver=solver, load=load, steps=steps):
                solver.advance(FRAME, lambda t: load, steps=steps)

            times = 1e3 * alternate({"frame": frame}, rounds)["frame"]
            q = quantiles(times, (10, 50, 90), 2)
            stable = bool(FRAME / steps <= solver.critical_step)
            result[f"{kind} {steps} steps"] = q | {"mass_scaling": scaling, "stable": stable}
            quoted = " | ".join(f"{q[name]:.1f}" for name in ("p10", "p50", "p90"))
            print(f"| {kind} | {steps} | {scaling:g} | {quoted} |")
    return result


def size_table(boxes: dict[str, tuple[int, int, int]], rounds: int) -> Figures:
    """Microseconds a step and per thousand cells, and bytes a cell, from the tumour to a million
    hexahedra."""
    result = {}
    print("\n## Cost against size\n")
    print("| mesh | hexahedra | variant | ms a step (p50) | us per 1000 cells", end="")
    print(" | against the tumour | bytes a cell |\n|---|---|---|---|---|---|---|")
    meshes = {"tumour": tumour()} | {name: box(cells, 0.5e-3) for name, cells in boxes.items()}
    first: dict[str, float] = {}
    for mesh_name, mesh in meshes.items():
        for kind, precision, name, material in VARIANTS:
            if (kind, precision) in (("full", "float32"), ("reduced", "float64")):
                continue  # between the others
            large = mesh.n_cells > 500_000
            if large and material.prony:
                continue  # minutes, and the smaller boxes have shown its share
            run = Run(mesh, kind, precision, material, 8 if large else STRIDE)
            times = 1e6 * alternate({"step": run}, rounds if mesh_name == "tumour" else 2)["step"]
            per_cell = float(np.median(times)) / mesh.n_cells
            key = f"{kind} {precision} {name}"
            first.setdefault(key, per_cell)
            memory = array_bytes(run.solver) / mesh.n_cells
            result[f"{mesh_name}: {key}"] = {
                "us_per_step": round(float(np.median(times)), 1),
                "bytes_per_cell": round(memory),
            }
            print(
                f"| {mesh_name} | {mesh.n_cells} | {key} | {np.median(times) / 1e3:.2f}"
                f" | {per_cell * 1e3:.0f} | {per_cell / first[key]:.2f} | {memory:.0f} |",
                flush=True,
            )
    return result


def array_bytes(thing: object, seen: set[int] | None = None) -> int:
    """Bytes of all arrays that an object of this package holds, the mesh left out."""
    seen = set() if seen is None else seen
    if id(thing) in seen or isinstance(thing, HexMesh):
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.nbytes if thing.base is None else array_bytes(thing.base, seen)
    return sum(array_bytes(part, seen) for part in _inside(thing))


def _inside(thing):
    if isinstance(thing, dict):
        return list(thing.values())
    if isinstance(thing, list | tuple):
        return thing
    if is_dataclass(thing):  # with slots it has no __dict__
        return [getattr(thing, field.name) for field in fields(thing)]
    return list(getattr(thing, "__dict__", {}).values())


def measure(quick: bool = False) -> Figures:
    """All tables, printed as Markdown, and their figures; quick: few repetitions and no box above
    10 thousand cells."""
    rounds = 3 if quick else 25
    boxes = dict(list(BOXES.items())[:1]) if quick else BOXES
    machine = {
        "processor": processor(),
        "threads": 1,
        "versions": versions(),
        "warm-up": f"{STRIDE} steps",
    }
    print(
        f"{machine['processor']}, one thread, NumPy {np.__version__};"
        f" blocks of {BLOCK} steps; warm-up {STRIDE} steps"
    )
    return {
        "machine": machine,
        "tumour": tumour_table(rounds),
        "frame": frame_table(rounds),
        "size": size_table(boxes, rounds),
    }
