"""The runs of the map of limits: each function returns a relative error, or the solver stops it.
See fem.measure.limits."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from fem.contact.push import smooth_step
from fem.contact.surface import Surface
from fem.errors import SolverStopped, Stop
from fem.material.neo_hooke import NeoHooke
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box
from fem.solver.energy import EnergyLedger
from fem.solver.explicit import Solver
from fem.solver.gate import Gate, doubts
from fem.solver.internal_force import ELEMENTS
from fem.solver.rest import equilibrium

Scale = Callable[[float], float]  # t in s -> share of the load
TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
PAPER = replace(TISSUE, prony=((0.12, 330.0), (0.8, 11.0)))
EDGE = 1e-3  # m
BLOCK = box((6, 6, 4), EDGE)
SMALL = box((3, 3, 2), EDGE)
FORCE = 1e-3  # N: x 1 of the pushes; on a circle of radius 2.2 mm it indents the block by 0.1 mm
RADIUS = 2.2e-3  # m


def push(mesh: HexMesh, peak: float = FORCE) -> np.ndarray:
    """(3, N) N: a smooth footprint in the middle of the top that pushes down."""
    load, middle = np.zeros((3, mesh.n_nodes)), np.ptp(mesh.points, axis=0) * [0.5, 0.5, 1.0]
    load[2] = -peak * Surface(mesh).footprint(middle, RADIUS)
    return load


def ramp(duration: float) -> Scale:
    """A smooth rise from 0 to 1 in `duration` seconds."""
    return lambda t: smooth_step(t / duration)


def sudden(t: float) -> float:
    """All of the load from the start."""
    return 1.0


def history(
    mesh: HexMesh,
    material: NeoHooke,
    load: np.ndarray,
    scale: Scale,
    duration: float,
    steps: int | None = None,
    **choices: Any,
) -> np.ndarray:
    """Displacement in m that is conjugate to the load field (3, N), at 200 instants of a run under
    scale(t) * load, with an energy ledger."""
    solver, record = Solver(mesh, material, **choices), []

    def watch(step):
        record.append((step.time, np.vdot(load, step.u) / np.linalg.norm(load)))

    solver.advance(duration, lambda t: scale(t) * load, [EnergyLedger(), watch], steps)
    return np.interp(np.linspace(0, duration, 200), *np.transpose(record))


def difference(got: np.ndarray | float, exact: np.ndarray) -> float:
    """Relative L2."""
    return float(np.linalg.norm(got - exact) / np.linalg.norm(exact))


def against_small_steps(got: np.ndarray | float, share: float, *run: Any, **choices: Any) -> float:
    """Error of a history against the same run with a `share` of the critical step, in float64."""
    try:
        return difference(
            got, history(*run, **(choices | {"precision": "float64", "safety": share}))
        )
    except SolverStopped:
        return np.inf  # what must stop has come to an end


RISE = ramp(0.1)


def pushed(
    factor: float,
    material: NeoHooke = TISSUE,
    scale: Scale = RISE,
    duration: float = 0.15,
    refined: float = 0.08,
    **choices: Any,
) -> float:
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


def fixed_steps(ratio: float) -> float:
    """A fixed number of steps, `ratio` of the critical step at rest, while a push stiffens the
    tissue."""
    run = BLOCK, TISSUE, push(BLOCK, 5 * FORCE), ramp(0.1), 0.15
    steps = int(np.ceil(0.15 / (ratio * Solver(BLOCK, TISSUE).critical_step)))
    return against_small_steps(history(*run, steps=steps), 0.08, *run)


def uniform(mesh: HexMesh, material: NeoHooke, stretch: np.ndarray, kind: str = "full") -> float:
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
    found = equilibrium(mesh, material, relaxed * load, element=kind, max_steps=200_000)
    return difference(found.displacement, mesh.points[:, 2:] * stretch)


STRETCH = np.array([0.05, -0.03, 0.04])  # shear and tension: this equilibrium is stable


def on_all_elements(mesh: HexMesh) -> float:
    """The worst error of `uniform`."""
    return max(uniform(mesh, TISSUE, STRETCH, kind) for kind in ELEMENTS)


def warped(mesh: HexMesh, amount: float = 0.15) -> HexMesh:
    """The mesh with every node that is not on the bottom moved at random by up to `amount` of an
    edge."""
    shift = np.random.default_rng(1).uniform(-1, 1, mesh.points.shape) * (mesh.points[:, 2:] > 0)
    return replace(mesh, points=mesh.points + amount * EDGE * shift)


def graded(ratio: float) -> HexMesh:
    """A block whose cells shrink by `ratio` from one side to the other."""
    mesh = box((6, 2, 2), EDGE, "bottom")
    lines = np.concatenate([[0], np.cumsum(ratio ** -np.linspace(0, 1, 6))]) * EDGE
    points = mesh.points.copy()
    points[:, 0] = lines[np.rint(points[:, 0] / EDGE).astype(int)]
    return replace(mesh, points=points)


def bad_cell(kind: str, amount: float) -> HexMesh:
    """A block with a layer of slivers `amount` as thick as the others, or a corner whose Jacobian
    is `amount` of a cube's."""
    mesh = box((3, 3, 3), EDGE, "bottom")
    points = mesh.points.copy()
    if kind == "sliver":
        points[np.isclose(points[:, 0], 2 * EDGE), 0] = (1 + amount) * EDGE
    else:
        # the outer corner of the last cell, in along the diagonal
        points[mesh.cells[-1, 6]] -= (1 - amount) / 3 * EDGE
    return HexMesh(points, mesh.cells, mesh.fixed)


@cache
def indentation(nu: float, kind: str, refinement: int, allow_locking: bool = False) -> float:
    """Depth in m to which the footprint indents the block, in cells of EDGE / refinement."""
    mesh = box((6 * refinement, 6 * refinement, 4 * refinement), EDGE / refinement)
    load, tissue = push(mesh), replace(TISSUE, nu=nu)
    found = equilibrium(mesh, tissue, load.T, 1e-4, kind, allow_locking=allow_locking)
    return float(np.vdot(load.T, found.displacement)) / FORCE


def stiffness_error(nu: float, kind: str, allow_locking: bool = False) -> float:
    """Relative error of the indentation on a mesh with 4.4 cells a radius against one of half the
    cell with mean dilatation."""
    return indentation(nu, kind, 2, allow_locking) / indentation(nu, "mean_dilatation", 4) - 1


def locking(values: Sequence[float]) -> list[tuple[float, ...]]:
    """[(nu, full, reduced, mean dilatation)]: the errors above, the full element's where it is
    refused too."""
    kinds = "full", "reduced", "mean_dilatation"
    return [(nu, *(stiffness_error(nu, kind, True) for kind in kinds)) for nu in values]


def creep(
    prony: tuple[tuple[float, float], ...],
    duration: float,
    exact: float,
    kind: str = "full",
    mass_scaling: float = 1.0,
    **choices: Any,
) -> float:
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


def one_term(g: float, tau: float, duration: float) -> float:
    """Creep function of one Prony term: it retards with the time tau / (1 - g)."""
    return (1 - g * np.exp(-duration * (1 - g) / tau)) / (1 - g)


def hour(choice: tuple[str, str]) -> float:
    """The paper's tissue under a force held for an hour: D = 12.5 - 3.2365 exp(-t / 50.68) - 8.2635
    exp(-t / 895.3)."""
    kind, precision = choice
    exact = 12.5 - 3.2365 * np.exp(-3600 / 50.68) - 8.2635 * np.exp(-3600 / 895.3)
    return creep(PAPER.prony, 3600.0, exact, kind, mass_scaling=1e5, precision=precision)


def densities(ratio: float) -> np.ndarray:
    """One factor a cell on the density: 1 on one half of the block, `ratio` on the other."""
    return np.where(BLOCK.points[BLOCK.cells].mean(axis=1)[:, 0] < 3 * EDGE, 1.0, ratio)


class Rejected(Exception):
    """The gate rejects an answer for `reason`, a Stop; `error`: relative, against the reference."""

    def __init__(self, reason: Stop, error: float) -> None:
        super().__init__(reason)
        self.reason, self.error = reason, error


def believed(error: float, gate: Gate | None) -> float:
    """The error of a run that its gate lets pass. Raises Rejected."""
    reasons = doubts(gate.signs) if gate else []
    if reasons:
        raise Rejected(reasons[0], error)
    return error


SLOW = 0.1  # s between the frames of a slow push


def slow_push(factor: float, frames: int = 20, **choices: Any) -> tuple[np.ndarray, Gate | None]:
    """(frames, 3, N) displacement of the viscoelastic block under a push that rises within 0.6 s,
    stays, and goes within 0.6 s; and its gate."""
    load, found = push(BLOCK, factor * FORCE), []
    solver, ledger = Solver(BLOCK, PAPER, **choices), EnergyLedger()
    for frame in range(1, frames + 1):
        solver.advance(
            frame * SLOW - solver.time,
            lambda t: smooth_step(t / 0.6) * (1 - smooth_step((t - 1.0) / 0.6)) * load,
            [ledger],
        )
        found.append(solver.u.copy())
    return np.array(found), solver.gate


@cache
def true_mass(factor: float, damping: float) -> np.ndarray:
    """A slow push with the true mass."""
    return slow_push(factor, damping=damping)[0]


def scaled_mass(factor: float, damping: float, scaling: float) -> float:
    """A slow push with scaled mass against the same with the true, judged by the gate."""
    got, gate = slow_push(factor, damping=damping, mass_scaling=scaling)
    return believed(difference(got, true_mass(factor, damping)), gate)


FINE = 4  # cells of the reference to an edge
# label: peak N, place m, radius m, tangential over normal force
PUSHES = {
    "middle": (FORCE, (3e-3, 3e-3), RADIUS, 0.0),
    "narrow": (0.5 * FORCE, (3e-3, 3e-3), 1.3e-3, 0.0),
    "inclined": (2 * FORCE, (2.2e-3, 2.6e-3), RADIUS, 0.5),
}


def push_of(label: str, mesh: HexMesh) -> np.ndarray:
    """(3, N) N of one of PUSHES."""
    peak, place, radius, slope = PUSHES[label]
    share = Surface(mesh).footprint(np.array([*place, mesh.points[:, 2].max()]), radius)
    return peak * np.array([[slope], [slope / 3], [-1.0]]) * share


@cache
def fine_rest(label: str) -> np.ndarray:
    """(3, N) displacement at rest at the nodes of cells of half an EDGE, found on cells of a
    quarter with mean dilatation."""
    mesh = box((6 * FINE, 6 * FINE, 4 * FINE), EDGE / FINE)
    found = equilibrium(mesh, TISSUE, push_of(label, mesh).T, 1e-4, "mean_dilatation")
    shared = np.all(np.rint(mesh.points / EDGE * FINE) % 2 == 0, axis=1)
    return found.displacement[shared].T


def hourglass(label: str, stiffness: float) -> float:
    """A push of the reduced element in cells of half an EDGE, brought to rest by damping, against
    finer cells; judged by the gate."""
    mesh = box((12, 12, 8), EDGE / 2)
    load, scale = push_of(label, mesh), ramp(0.15)
    solver = Solver(mesh, TISSUE, "reduced", hourglass_stiffness=stiffness, damping=100.0)
    solver.advance(0.3, lambda t: scale(t) * load, [EnergyLedger()])
    return believed(difference(solver.u, fine_rest(label)), solver.gate)


def crushed(factor: float) -> float:
    """A slow push that crushes corners, in float32, against a third of the step in float64; judged
    by the gate."""
    got, gate = slow_push(factor, 10, damping=20.0, precision="float32")
    exact, _ = slow_push(factor, 10, damping=20.0, safety=0.28)
    return believed(difference(got, exact), gate)


SINGLE = {  # label: material, element, peak force N, history of the load, duration s
    "strain 1e-9": (TISSUE, "full", 1e-8 * FORCE, ramp(0.1), 0.15),
    "strain 1e-4": (TISSUE, "full", 1e-3 * FORCE, ramp(0.1), 0.15),
    "push x1": (TISSUE, "full", FORCE, ramp(0.1), 0.15),
    "impact x5": (TISSUE, "full", 5 * FORCE, sudden, 0.03),
    "reduced x2": (TISSUE, "reduced", 2 * FORCE, ramp(0.1), 0.15),
    "nu 0.4999": (replace(TISSUE, nu=0.4999), "mean_dilatation", FORCE, ramp(0.1), 0.15),
    "Prony": (PAPER, "full", FORCE, ramp(0.1), 0.5),
}


def single_precision(label: str) -> float:
    """float32 against float64 with the same steps."""
    material, kind, peak, scale, duration = SINGLE[label]
    run = BLOCK, material, push(BLOCK, peak), scale, duration
    return against_small_steps(
        history(*run, element=kind, precision="float32"), 0.85, *run, element=kind
    )
