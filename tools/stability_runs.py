"""The runs of the stability map: each function returns a relative error, or the solver stops it.
See tools/stability.py."""

from dataclasses import replace
from functools import cache

import numpy as np

import fem.solver.explicit
from fem.contact.push import smooth_step
from fem.contact.surface import Surface
from fem.errors import SolverStopped
from fem.material.neo_hooke import NeoHooke
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box
from fem.solver.energy import EnergyLedger
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS
from fem.solver.rest import equilibrium

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
PAPER = replace(TISSUE, prony=((0.12, 330.0), (0.8, 11.0)))
EDGE = 1e-3  # m
BLOCK = box((6, 6, 4), EDGE)
SMALL = box((3, 3, 2), EDGE)
FORCE = 1e-3  # N: x 1 of the pushes; on a circle of radius 2.2 mm it indents the block by 0.1 mm
RADIUS = 2.2e-3  # m


def push(mesh, peak=FORCE):
    """(3, N) N: a smooth footprint in the middle of the top that pushes down."""
    load, middle = np.zeros((3, mesh.n_nodes)), np.ptp(mesh.points, axis=0) * [0.5, 0.5, 1.0]
    load[2] = -peak * Surface(mesh).footprint(middle, RADIUS)
    return load


def ramp(duration):
    return lambda t: smooth_step(t / duration)


def sudden(t):
    return 1.0


def history(mesh, material, load, scale, duration, steps=None, **choices):
    """Displacement in m that is conjugate to the load field (3, N), at 200 instants of a run under
    scale(t) * load, with an energy ledger."""
    solver, record = Solver(mesh, material, **choices), []
    observers = [
        EnergyLedger(),
        lambda s: record.append((s.time, np.vdot(load, s.u) / np.linalg.norm(load))),
    ]
    solver.advance(duration, lambda t: scale(t) * load, observers, steps)
    return np.interp(np.linspace(0, duration, 200), *np.transpose(record))


def difference(got, exact):
    return np.linalg.norm(got - exact) / np.linalg.norm(exact)


def against_small_steps(got, share, *run, **choices):
    """Error of a history against the same run with a `share` of the critical step, in float64."""
    try:
        return difference(
            got, history(*run, **(choices | {"precision": "float64", "safety": share}))
        )
    except SolverStopped:
        return np.inf  # what must stop has come to an end


def pushed(factor, material=TISSUE, scale=ramp(0.1), duration=0.15, refined=0.08, **choices):
    """A push of the block with `factor` times the force, against smaller steps. A stop counts only
    if they stop too."""
    run = BLOCK, material, push(BLOCK, factor * FORCE), scale, duration
    try:
        got = history(*run, **choices)
    except SolverStopped:
        if "safety" not in choices and against_small_steps(0.0, refined, *run, **choices) < np.inf:
            return np.inf  # smaller steps would have saved this run
        raise
    return against_small_steps(got, refined, *run, **choices)


def fixed_steps(ratio):
    """A fixed number of steps, `ratio` of the critical step at rest, while a push stiffens the
    tissue."""
    run = BLOCK, TISSUE, push(BLOCK, 5 * FORCE), ramp(0.1), 0.15
    steps = int(np.ceil(0.15 / (ratio * Solver(BLOCK, TISSUE).critical_step)))
    return against_small_steps(history(*run, steps=steps), 0.08, *run)


def uniform(mesh, material, stretch, kind="full"):
    """Error of the equilibrium against u = stretch z, which is exact on any mesh with a fixed
    bottom: P is uniform.

    The loads are the tractions P n of NeoHooke.stress, integrated over the faces.
    """
    F = np.eye(3)
    F[:, 2] += stretch
    shape, gradient = element.quad_shape(
        np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3)
    )
    faces = mesh.boundary_faces
    s, t = np.moveaxis(np.einsum("qra,mai->mqri", gradient, mesh.points[faces]), 2, 0)
    load = np.zeros_like(mesh.points)
    np.add.at(load, faces, np.einsum("qa,mqj,ij->mai", shape, np.cross(s, t), material.stress(F)))
    relaxed = 1 - sum(g for g, _ in material.prony)
    return difference(
        equilibrium(mesh, material, relaxed * load, element=kind, max_steps=200_000).displacement,
        mesh.points[:, 2:] * stretch,
    )


STRETCH = np.array([0.05, -0.03, 0.04])  # shear and tension: this equilibrium is stable


def on_all_elements(mesh):
    return max(uniform(mesh, TISSUE, STRETCH, kind) for kind in ELEMENTS)


def warped(mesh, amount=0.15):
    """The mesh with every node that is not on the bottom moved at random by up to `amount` of an
    edge."""
    shift = np.random.default_rng(1).uniform(-1, 1, mesh.points.shape) * (mesh.points[:, 2:] > 0)
    return replace(mesh, points=mesh.points + amount * EDGE * shift)


def graded(ratio):
    """A block whose cells shrink by `ratio` from one side to the other."""
    mesh = box((6, 2, 2), EDGE, "bottom")
    lines = np.concatenate([[0], np.cumsum(ratio ** -np.linspace(0, 1, 6))]) * EDGE
    points = mesh.points.copy()
    points[:, 0] = lines[np.rint(points[:, 0] / EDGE).astype(int)]
    return replace(mesh, points=points)


def bad_cell(kind, amount):
    """A block with a layer of slivers `amount` as thick as the others, or a corner whose Jacobian
    is `amount` of a cube's."""
    mesh = box((3, 3, 3), EDGE, "bottom")
    points = mesh.points.copy()
    if kind == "sliver":
        points[np.isclose(points[:, 0], 2 * EDGE), 0] = (1 + amount) * EDGE
    else:
        points[mesh.cells[-1, 6]] -= (
            (1 - amount) / 3 * EDGE
        )  # the outer corner of the last cell, in along the diagonal
    return HexMesh(points, mesh.cells, mesh.fixed)


@cache
def indentation(nu, kind, refinement):
    """Depth in m to which the footprint indents the block, in cells of EDGE / refinement."""
    mesh = box(tuple(refinement * n for n in (6, 6, 4)), EDGE / refinement)
    load = push(mesh)
    u = equilibrium(mesh, replace(TISSUE, nu=nu), load.T, residual=1e-4, element=kind).displacement
    return np.vdot(load.T, u) / FORCE


def stiffness_error(nu, kind):
    """Relative error of the indentation on a mesh with 4.4 cells a radius against one of half the
    cell with mean dilatation."""
    return indentation(nu, kind, 2) / indentation(nu, "mean_dilatation", 4) - 1


def locking(values):
    """[(nu, full, reduced, mean dilatation)]: the errors above, the full element's where it is
    refused too."""
    limit, fem.solver.explicit.LOCKING_NU = fem.solver.explicit.LOCKING_NU, 0.5
    try:
        return [
            (nu, *(stiffness_error(nu, kind) for kind in ("full", "reduced", "mean_dilatation")))
            for nu in values
        ]
    finally:
        fem.solver.explicit.LOCKING_NU = limit


def creep(prony, duration, exact, kind="full", mass_scaling=1.0, **choices):
    """Error of the displacement after `duration` s of a sudden, small, held force against the creep
    function `exact`."""
    load = push(SMALL, 1e-6 * FORCE)
    elastic = equilibrium(SMALL, TISSUE, load.T, residual=1e-7, element=kind).displacement.T
    solver = Solver(
        SMALL,
        replace(TISSUE, prony=prony),
        kind,
        mass_scaling=mass_scaling,
        damping=200 / np.sqrt(mass_scaling),
        **choices,
    )
    solver.advance(duration, lambda t: load, [EnergyLedger()])
    return abs(np.vdot(load, solver.u) / np.vdot(load, elastic) / exact - 1)


def one_term(g, tau, duration):
    """Creep function of one Prony term: it retards with the time tau / (1 - g)."""
    return (1 - g * np.exp(-duration * (1 - g) / tau)) / (1 - g)


def hour(choice):
    """The paper's tissue under a force held for an hour: D = 12.5 - 3.2365 exp(-t / 50.68) - 8.2635
    exp(-t / 895.3)."""
    kind, precision = choice
    exact = 12.5 - 3.2365 * np.exp(-3600 / 50.68) - 8.2635 * np.exp(-3600 / 895.3)
    return creep(PAPER.prony, 3600.0, exact, kind, mass_scaling=1e5, precision=precision)


def densities(ratio):
    """One factor a cell on the density: 1 on one half of the block, `ratio` on the other."""
    return np.where(BLOCK.points[BLOCK.cells].mean(axis=1)[:, 0] < 3 * EDGE, 1.0, ratio)


SINGLE = {  # label: material, element, peak force N, history of the load, duration s
    "strain 1e-9": (TISSUE, "full", 1e-8 * FORCE, ramp(0.1), 0.15),
    "strain 1e-4": (TISSUE, "full", 1e-3 * FORCE, ramp(0.1), 0.15),
    "push x1": (TISSUE, "full", FORCE, ramp(0.1), 0.15),
    "impact x5": (TISSUE, "full", 5 * FORCE, sudden, 0.03),
    "reduced x2": (TISSUE, "reduced", 2 * FORCE, ramp(0.1), 0.15),
    "nu 0.4999": (replace(TISSUE, nu=0.4999), "mean_dilatation", FORCE, ramp(0.1), 0.15),
    "Prony": (PAPER, "full", FORCE, ramp(0.1), 0.5),
}


def single_precision(label):
    """float32 against float64 with the same steps."""
    material, kind, peak, scale, duration = SINGLE[label]
    run = BLOCK, material, push(BLOCK, peak), scale, duration
    return against_small_steps(
        history(*run, element=kind, precision="float32"), 0.85, *run, element=kind
    )
