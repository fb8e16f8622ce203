"""The force that a Press answers beside that of the quasi-static FEM under the same probe, and the
time of a tick."""

import time
from typing import NamedTuple

import numpy as np

from fem.data.dataset import Dataset
from fem.online.contact_surface import ContactSurface
from fem.online.grid import MM
from fem.online.press import Press
from fem.solver.quasistatic_loop import QuasiStaticLoop

SLIDE = 0.8  # mm that a probe moves sideways over a press
CLOSE = 1e-4  # of the depth, where the FEM's force is found
TRIES = 6


class Pressing(NamedTuple):
    """Over some presses: force, of the reaction, relative L2 over all ticks, worst: of a press;
    largest: reaction in mN; flagged: share of the ticks."""

    force: float
    worst: float
    largest: float
    flagged: float


def places(surface: ContactSurface, count: int, radius: float, seed: int = 0) -> np.ndarray:
    """(count, 3) mm: points of the surface that face up, half a probe's radius and the slide inside
    of it."""
    inner = surface.points - surface.points.min(axis=0)
    across = surface.points.max(axis=0) - surface.points.min(axis=0)
    good = (surface.normal[:, 2] > 0.9) & (
        np.minimum(inner, across - inner)[:, :2].min(axis=1) > radius / 2 + SLIDE / 2
    )
    return surface.points[np.random.default_rng(seed).choice(np.flatnonzero(good), count)]


def pressing(
    press: Press,
    dataset: Dataset,
    depth: float,
    count: int = 6,
    seconds: float = 0.6,
    dt: float = 0.01,
    radius: float = 2.5,
) -> Pressing:
    """`count` presses up to `depth` mm and back in `seconds`, sliding along x, at ticks of dt s.

    The FEM's force is that which moves its surface as deep: secants from the answer, with its own
    stress history.
    """
    loop = QuasiStaticLoop(dataset.fem_mesh, dataset.material, tolerance=1e-5)
    mesh = dataset.fem_mesh
    surface = ContactSurface(mesh.points * MM, mesh.contact_faces, ~mesh.fixed)
    wrong, total, flagged, largest, ticks = [], [], 0, 0.0, round(seconds / dt)
    for place in places(surface, count, radius):
        press.reset()
        loop.reset()
        error = size = force = 0.0
        for tick in range(1, ticks + 1):
            part = tick / ticks
            deep = depth * float(np.sin(np.pi * part))
            at = place + [SLIDE * (part - 0.5), 0, 0]
            touch = press(at, deep, radius, dt=dt)
            force = _force(loop, *surface.patch(at, radius), deep, force, touch.compliance, dt)
            answer = float(np.linalg.norm(touch.force))
            error, size = error + (answer - force) ** 2, size + force**2
            flagged, largest = flagged + touch.flagged, max(largest, force)
        wrong.append(error)
        total.append(size)
    worst = max(e / s for e, s in zip(wrong, total, strict=True))
    return Pressing(
        float(np.sqrt(sum(wrong) / sum(total))),
        float(np.sqrt(worst)),
        largest,
        flagged / (count * ticks),
    )


def _force(loop, shares, normal, depth, force, compliance, dt):
    """mN of a frictionless probe that has pushed the FEM's surface by `depth` mm, and the loop
    goes on from there."""
    began = loop.state()
    for _ in range(TRIES):
        loop.restore(began)
        moved = -float(shares @ loop.step(np.outer(shares, -normal) * force, dt) @ normal)
        if abs(depth - moved) <= CLOSE * max(abs(depth), 1e-2) or (force == 0 and moved > depth):
            break
        force = max(force + (depth - moved) / float(compliance), 0.0)
    return force


def tick_times(
    press: Press, ticks: int = 3000, radius: float = 2.5, depth: float = 0.1
) -> np.ndarray:
    """(ticks,) s of ticks of a millisecond, pressing and sliding, after a hundred to warm up."""
    at = places(press.surface, 1, radius)[0]
    press.reset()
    spent = np.empty(ticks + 100)
    for tick in range(len(spent)):
        turn = 2 * np.pi * tick * 1e-3
        start = time.perf_counter()
        press(at + [0.4 * np.sin(turn), 0, 0], depth * 0.5 * (1 - np.cos(turn)), radius, dt=1e-3)
        spent[tick] = time.perf_counter() - start
    return spent[100:]
