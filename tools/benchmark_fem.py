"""Time the finite-element solver on one core, beside a plain NumPy step and felupe.

    python tools/benchmark_fem.py [--quick] [--out docs/benchmark_fem.json]

Every figure of a table comes from one process, with the variants taking turns, so that their ratios
hold even when the machine's speed drifts. The table is printed as Markdown; felupe is optional (pip
install -e '.[test]').
"""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"  # before NumPy is imported

import argparse  # noqa: E402
import json  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from fem.commands import command_line  # noqa: E402
from fem.material.neo_hooke import NeoHooke  # noqa: E402
from fem.measure.machine import (
    processor,  # noqa: E402
    versions,  # noqa: E402
)
from fem.measure.timing import alternate, paired_ratio, quantiles  # noqa: E402
from fem.mesh import element  # noqa: E402
from fem.mesh.shapes import box, tumour  # noqa: E402
from fem.solver.explicit import BLOCK, STRIDE, Solver  # noqa: E402

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


def plain_force(mesh, material):
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


def felupe_force(mesh, material):
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


def gentle_load(mesh):
    """A constant nodal load on the free surface that moves the tissue by a few per cent of a
    cell."""
    load = np.zeros((3, mesh.n_nodes))
    nodes = np.unique(mesh.free_faces)
    load[2, nodes] = -20.0 * mesh.volume() ** (2 / 3) / len(nodes)  # about 20 Pa
    return load


class Run:
    """One solver that takes STRIDE steps at a time, so that updates of the viscous stress have
    their full share."""

    def __init__(self, mesh, kind, precision, material, steps=STRIDE):
        self.solver = Solver(mesh, material, kind, precision, damping=50.0)
        self.load, self.steps = gentle_load(mesh), steps
        self.duration = steps * self.solver.max_step

    def __call__(self):
        self.solver.advance(self.duration, lambda t: self.load, steps=self.steps)
        return self.steps


def tumour_table(rounds):
    """Microseconds per step of all variants and both yardsticks on the tumour."""
    mesh = tumour()
    actions = {
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
            np.testing.assert_allclose(
                force(u).reshape(-1, 3).T, reference(u), rtol=1e-9, atol=1e-15
            )  # the same work
            actions[name] = lambda force=force: force(u) is not None
    times = {name: 1e6 * values for name, values in alternate(actions, rounds).items()}
    base = times["full float64 elastic"]
    print("\n## The tumour, 1314 hexahedra, microseconds a step\n")
    print(
        "| variant | p10 | p50 | p90 | against full float64 elastic (p50 of paired ratios) |\n|---|---|---|---|---|"
    )
    result = {}
    for name, values in times.items():
        ratio = paired_ratio(values, base)
        result[name] = quantiles(values, (10, 50, 90), 1) | {"ratio": round(ratio, 3)}
        print(
            f"| {name} | {result[name]['p10']:.0f} | {result[name]['p50']:.0f} | {result[name]['p90']:.0f} | {ratio:.2f} |"
        )
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


def frame_table(rounds):
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
            times = (
                alternate(
                    {"frame": lambda: solver.advance(FRAME, lambda t: load, steps=steps)}, rounds
                )["frame"]
                * 1e3
            )
            result[f"{kind} {steps} steps"] = quantiles(times, (10, 50, 90), 2) | {
                "mass_scaling": scaling,
                "stable": bool(FRAME / steps <= solver.critical_step),
            }
            q = result[f"{kind} {steps} steps"]
            print(
                f"| {kind} | {steps} | {scaling:g} | {q['p10']:.1f} | {q['p50']:.1f} | {q['p90']:.1f} |"
            )
    return result


def size_table(boxes, rounds):
    """Microseconds a step and per thousand cells, and bytes a cell, from the tumour to a million
    hexahedra."""
    result = {}
    print(
        "\n## Cost against size\n\n| mesh | hexahedra | variant | ms a step (p50) | us per 1000 cells | against the tumour | bytes a cell |\n|---|---|---|---|---|---|---|"
    )
    meshes = {"tumour": tumour()} | {name: box(cells, 0.5e-3) for name, cells in boxes.items()}
    first = {}
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
                f"| {mesh_name} | {mesh.n_cells} | {key} | {np.median(times) / 1e3:.2f} | {per_cell * 1e3:.0f} | {per_cell / first[key]:.2f} | {memory:.0f} |",
                flush=True,
            )
    return result


def array_bytes(thing, seen=None):
    """Bytes of all arrays that an object of this package holds, the mesh left out."""
    seen = set() if seen is None else seen
    if id(thing) in seen or type(thing).__name__ in ("HexMesh", "NeoHooke"):
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.nbytes if thing.base is None else array_bytes(thing.base, seen)
    inner = (
        thing.values()
        if isinstance(thing, dict)
        else thing
        if isinstance(thing, (list, tuple))
        else vars(thing).values()
        if hasattr(thing, "__dict__")
        else ()
    )
    return sum(array_bytes(part, seen) for part in list(inner))


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="few repetitions and no box above 10 thousand cells"
    )
    parser.add_argument("--out", type=Path, help="write the figures as JSON too")
    options = parser.parse_args(arguments)
    rounds = 3 if options.quick else 25
    boxes = dict(list(BOXES.items())[:1]) if options.quick else BOXES
    machine = {
        "processor": processor(),
        "threads": 1,
        "versions": versions(),
        "warm-up": f"{STRIDE} steps",
    }
    print(
        f"{machine['processor']}, one thread, NumPy {np.__version__}; blocks of {BLOCK} steps; warm-up {STRIDE} steps"
    )
    result = {
        "machine": machine,
        "tumour": tumour_table(rounds),
        "frame": frame_table(rounds),
        "size": size_table(boxes, rounds),
    }
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n")
        print(f"\nwrote {options.out}")


if __name__ == "__main__":
    main()
