"""How the force ranges of a scene are chosen: what its pushes do when they are weaker and stronger.

At each factor on contact.force, usual and hard draws are simulated once each, without drawing
again. What tells: how many are refused and why, how far the tissue moves, how much its volume
changes (the FEM's own, not a network's), and how much of the motion is beyond a linear answer.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
import scipy.linalg

from fem.contact.draw import draw_contacts
from fem.contact.surface import surface_of
from fem.data.interaction import simulate, unfit
from fem.data.scene import Scene
from fem.errors import SolverStopped
from fem.mesh import element
from fem.online.creep import Creep, remembered_force
from fem.online.grid import MM
from fem.workers import on_all_cores

RIDGE = 1e-6  # of the largest eigenvalue: a least-squares fit but for what rounding decides


def measure(scene: Scene, factors: list[float], usual: int, hard: int, seed: int = 1) -> list[dict]:
    """A row for each factor and kind of draw ("usual", "hard"): {"factor", "kind", "draws",
    "refused": {reason: count}, and of those that are fit "peak_mm" [median, 90 %, largest],
    "volume" and "tumour_volume" (largest relative change, of all cells and of the cell set `tumour`
    or None), "min_J", "linear" and "linear_remembered"}.

    linear: relative L2 error of the best linear answer to the forces of the moment on the usual
    draws that it was fitted to; linear_remembered: to the forces as the tissue remembers them, see
    fem.online.creep. None for the hard ones, and where no draw is fit.
    """
    mesh = scene.mesh.build()
    tasks = [
        (_scaled(scene, factor), kind == "hard", number, seed)
        for factor in factors
        for kind, count in (("usual", usual), ("hard", hard))
        for number in range(count)
    ]
    results = iter(on_all_cores(_draw, tasks, "forces", unit="draw"))
    rows = []
    for factor in factors:
        for kind, count in (("usual", usual), ("hard", hard)):
            drawn = [next(results) for _ in range(count)]
            fit = [result for result in drawn if "reason" not in result]
            refused = Counter(result["reason"] for result in drawn if "reason" in result)
            row = {"factor": factor, "kind": kind, "draws": count, "refused": dict(refused)}
            if fit:
                linear = linear_errors(scene, fit) if kind == "usual" else (None, None)
                row |= _of_fit(mesh, fit)
                row |= {"linear": linear[0], "linear_remembered": linear[1]}
            rows.append(row)
    return rows


def _scaled(scene, factor):
    low, high = scene.contact.force
    return replace(scene, contact=replace(scene.contact, force=(factor * low, factor * high)))


def _draw(scene, hard, number, seed):
    """The fields of one draw, or {"reason"} where it is refused."""
    mesh = scene.mesh.build()
    surface = surface_of(mesh)
    rng = np.random.default_rng([seed, int(hard), number])
    factor = scene.interactions.hard_force if hard else None
    contacts = draw_contacts(surface, scene.contact, scene.frames.duration, rng, factor)
    try:
        result = simulate(scene, mesh, contacts, surface)
        reason = unfit(scene, result)
    except SolverStopped as stop:
        reason = stop.reason
    if reason is not None:
        return {"reason": str(reason)}
    return {name: result[name] for name in ("force", "displacement", "volume", "min_J")}


def _of_fit(mesh, fit):
    peaks = [float(np.linalg.norm(result["displacement"], axis=-1).max()) for result in fit]
    change = [float(np.abs(result["volume"] / result["volume"][0] - 1).max()) for result in fit]
    tumour = mesh.cell_sets.get("tumour")
    inside = None
    if tumour is not None:
        cells = mesh.cells[tumour]
        rest = element.gauss_volumes(mesh.points, cells).sum()
        inside = max(
            abs(element.gauss_volumes(mesh.points + u / MM, cells).sum() / rest - 1)
            for result in fit
            for u in result["displacement"].astype(float)
        )
    return {
        "peak_mm": np.percentile(peaks, [50, 90, 100]).tolist(),
        "volume": max(change),
        "tumour_volume": inside,
        "min_J": min(float(result["min_J"]) for result in fit),
    }


def linear_errors(scene: Scene, fit: list[dict]) -> tuple[float, ...]:
    """(on the forces of the moment, on the remembered ones): relative L2 error of the linear answer
    that fits best, on what it was fitted to."""
    force = np.stack([result["force"] for result in fit]).astype(float)  # (I, F, N, 3)
    force = force.reshape(*force.shape[:2], -1)
    force = force[..., force.any(axis=(0, 1))]
    u = np.stack([result["displacement"] for result in fit]).astype(float)
    u = u.reshape(-1, u.shape[2] * 3)
    remembered = remembered_force(Creep.of(scene.material.prony), force, scene.frames.interval)
    return tuple(_misfit(f.reshape(len(u), -1), u) for f in (force, remembered))


def _misfit(X, Y):
    values, vectors = scipy.linalg.eigh(X.T @ X)
    kernel = vectors @ ((vectors.T @ (X.T @ Y)) / (values + RIDGE * values[-1])[:, None])
    return float(np.linalg.norm(X @ kernel - Y) / np.linalg.norm(Y))
