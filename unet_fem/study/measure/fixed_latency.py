"""The FEM at a fixed latency: so many time steps a frame, and the error that they leave, each
competitor made as good as it can be.

Damping, the rise of the load within a frame and the hourglass stiffness are chosen on validation
interactions alone.
"""

import hashlib
import itertools
import json
import math
import os
from dataclasses import asdict, replace

import numpy as np

from fem.contact.push import Load
from fem.contact.surface import Surface
from fem.data.interaction import contacts_of
from fem.errors import InputError, SolverStopped
from fem.solver.frame_loop import FrameLoop, LoopSettings, longest_step
from fem.workers import on_all_cores
from unet_fem.study.measure.reference import (
    hard_numbers,
    references,
    relative_l2,
    study_dataset,
    sums_of_squares,
)

DAMPINGS = (0.0125, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8)
RISES = (0.0, 0.25, 0.5, 1.0)
HOURGLASS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
TUNED_ON = 2  # validation interactions


def run(study):
    """{"points": [...], "numbers", "tuned_on": validation numbers, "elements": see `tuned`}; a
    point is a competitor and its errors.

    A point has its settings (see frame_loop.LoopSettings), cells, mass_scaling, damping_rate in 1/s;
    test and hard: relative L2 over the interactions that it ended, against the reference; sums:
    {"number": [error, truth] mm2} of these; stopped: [{"number", "reason", "time" s}] of the
    others.
    """
    dataset = study_dataset(study)
    numbers = list(references(study, dataset))
    if not numbers:
        raise InputError(
            "no test interaction has a reference: the FEM stopped in all of fem.interactions and the hard ones; lower contact.force in the scene"
        )
    found, elements = tuned(study, dataset)
    verdicts = on_all_cores(
        judge,
        [(study, dataset, c, "test", n) for c in found for n in numbers],
        "FEM at fixed latency",
    )
    points = [
        _point(c, dict(zip(numbers, verdicts[i * len(numbers) :])), study, dataset)
        for i, c in enumerate(found)
    ]
    return {
        "points": points,
        "numbers": numbers,
        "tuned_on": _tuned_on(study, dataset),
        "elements": elements,
    }


def frame_actions(study, dataset):
    """{name: action} of every tuned competitor for fem.measure.timing.alternate: an action answers
    one frame, force array in, displacement array out.

    The frames are those of the first interaction of study.fem, forwards and back again, so that no
    force jumps. A competitor that stops there has no action.
    """
    number, actions = study.fem.interactions[0], {}
    forces = {frame: frame_forces(dataset, "test", number, frame) for frame in study.fem.frames}
    for competitor in tuned(study, dataset)[0]:
        if "sums" in judge(study, dataset, competitor, "test", number):
            actions[loop_name(competitor)] = player(
                frame_loop(dataset, competitor), forces[competitor.frame]
            )
    return actions


def frame_loop(dataset, settings):
    """The FrameLoop of a dataset's mesh and material."""
    return FrameLoop(dataset.fem_mesh, dataset.scene.material, settings)


def loop_name(settings):
    """How tables and figures name the LoopSettings."""
    coarse = ", coarse" if settings.coarse else ""
    return f"FEM {settings.element}{coarse}, {settings.steps} steps / {1e3 * settings.frame:g} ms"


def player(loop, forces):
    """A function that answers the next of `forces` at each call, to and fro without end."""
    frames = itertools.cycle([*forces, *forces[::-1], None])

    def answer_one_frame():
        force = next(frames)
        if (
            force is None
            # or the tissue would creep on from round to round, farther than any interaction takes it
        ):
            loop.solver.force.forget()
            force = next(frames)
        loop.step(force)

    return answer_one_frame


def frame_forces(dataset, split, number, frame):
    """(frames, nx, ny, nz, 3) float32 mN: the forces of an interaction every `frame` seconds, the
    first at `frame`; on the grid.

    Raises InputError if the dataset's frames do not lie among them.
    """
    scene, load = (
        dataset.scene,
        Load(Surface(dataset.fem_mesh), contacts_of(dataset, split, number)),
    )
    times = frame * np.arange(1, frames_between(scene, frame) * (scene.frames.count - 1) + 1)
    return np.stack([dataset.fem_mesh.grid.to_grid((load(t).T * 1e3).astype(np.float32)) for t in times])


def frames_between(scene, frame):
    """Number of frames of `frame` seconds to one of the dataset."""
    ratio = scene.frames.interval / frame
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
        raise InputError(
            f"fem.frames has {frame} s, which does not divide the {scene.frames.interval} s between the dataset's frames; give a whole share of it"
        )
    return round(ratio)


def judge(study, dataset, competitor, split, number):
    """Simulate one interaction in frames: {"sums": [error, truth] mm2} against the reference, or
    {"stopped": reason, "time": s}.

    With it come "mass_scaling", "damping_rate" and "cells". Kept in a file under the study's
    folder.
    """
    made_from = repr(
        (dataset.scene.digest(), study.fem.reference_safety, competitor, split, number)
    )
    path = (
        study.folder
        / "fixed_latency"
        / f"{hashlib.sha256(made_from.encode()).hexdigest()[:16]}.json"
    )
    if path.is_file():
        return json.loads(path.read_text())
    truth, every = (
        references(study, dataset, split, [number])[number],
        frames_between(dataset.scene, competitor.frame),
    )
    loop, answer = frame_loop(dataset, competitor), np.zeros_like(truth)
    verdict = {
        "mass_scaling": loop.mass_scaling,
        "damping_rate": loop.damping_rate,
        "cells": loop.solver.mesh.n_cells,
    }
    try:
        for k, force in enumerate(frame_forces(dataset, split, number, competitor.frame), 1):
            displacement = loop.step(force)
            if k % every == 0:
                answer[k // every] = displacement
        verdict["sums"] = sums_of_squares(answer, truth, dataset)
    except SolverStopped as stop:
        verdict |= {"stopped": stop.reason, "time": loop.solver.time}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    partial.write_text(json.dumps({"made_from": made_from} | verdict, allow_nan=False))
    os.replace(partial, path)
    return verdict


def tuned(study, dataset):
    """([LoopSettings], {element: {hourglass stiffness: relative L2 on validation, None if one
    stopped}}): every element, frame and number of steps."""
    _tuned_on(study, dataset)
    elements, errors = _elements(study, dataset)
    chains = on_all_cores(
        _chain,
        [(study, dataset, element, frame) for element in elements for frame in study.fem.frames],
        "FEM at fixed latency, tuning",
    )
    return list(itertools.chain(*chains)), errors


def _elements(study, dataset):
    """([LoopSettings], errors): the full and reduced element, and the better of both on the coarse
    mesh, by their error where steps are plenty."""
    plenty = {
        "frame": max(study.fem.frames),
        "steps": max(study.fem.steps),
        "damping": 0.4,
        "rise": 0.5,
    }
    meshes = (
        (False,) if dataset.scene.mesh.kind == "file" else (False, True)
    )  # a curved mesh has no coarse one here
    choices = [LoopSettings("full", coarse, **plenty) for coarse in meshes]
    choices += [
        LoopSettings("reduced", coarse, hourglass_stiffness=h, **plenty)
        for coarse in meshes
        for h in HOURGLASS
    ]
    errors = dict(
        zip(
            choices,
            on_all_cores(
                _score, [(study, dataset, c) for c in choices], "FEM at fixed latency, elements"
            ),
        )
    )
    groups = [
        [c for c in choices if not c.coarse and c.element == element]
        for element in ("full", "reduced")
    ]
    groups += [[c for c in choices if c.coarse]] * (len(meshes) - 1)
    table = {}
    for choice, error in errors.items():
        row = table.setdefault(f"{choice.element}{', coarse' if choice.coarse else ''}", {})
        row[f"{choice.hourglass_stiffness:g}" if choice.element == "reduced" else "-"] = (
            error if math.isfinite(error) else None
        )
    return [min(group, key=errors.get) for group in groups], table


def _chain(study, dataset, element, frame):
    """Competitors of one element and frame, from few steps to the first number that needs hardly
    any mass scaling: more of them would only cost."""
    found, start = [], replace(element, frame=frame, damping=0.1, rise=0.5)
    longest = longest_step(dataset.fem_mesh, dataset.scene.material, element)
    for steps in sorted(study.fem.steps):
        start = replace(start, steps=steps)
        if (
            frame / steps <= 1.1 * longest
            # what damps the steps before damps these: with the true mass the answer hardly depends on
            # it
        ):
            return [*found, start]
        start = _walk(study, dataset, start)
        found.append(start)
    return found


def _walk(study, dataset, best):
    """`best` with the damping and the rise that err least, by steps to the neighbouring value of
    either while that helps."""
    least, moved = _score(study, dataset, best), True
    while moved:
        moved = False
        for (name, values), way in itertools.product(
            (("damping", DAMPINGS), ("rise", RISES)), (1, -1)
        ):
            while 0 <= (place := values.index(getattr(best, name)) + way) < len(values):
                other = replace(best, **{name: values[place]})
                error = _score(study, dataset, other)
                if not error < 0.99 * least:
                    break
                best, least, moved = other, error, True
    return best


def _score(study, dataset, competitor):
    """Relative L2 over the validation interactions, inf if one stops."""
    numbers = _tuned_on(study, dataset)
    verdicts = [judge(study, dataset, competitor, "validation", number) for number in numbers]
    if any("stopped" in verdict for verdict in verdicts):
        return math.inf
    return relative_l2(dict(zip(numbers, (verdict["sums"] for verdict in verdicts))), numbers)


def _tuned_on(study, dataset):
    """Numbers of the first validation interactions that have a reference; it is made where it is
    missing."""
    numbers = list(
        references(
            study,
            dataset,
            "validation",
            dataset.number[dataset.split == "validation"][:TUNED_ON].tolist(),
        )
    )
    if not numbers:
        raise InputError(
            "the FEM stopped in the first validation interactions, on which its competitors are tuned; lower contact.force in the scene"
        )
    return numbers


def _point(competitor, verdicts, study, dataset):
    sums = {number: verdict["sums"] for number, verdict in verdicts.items() if "sums" in verdict}
    stopped = [
        {"number": n, "reason": v["stopped"], "time": v["time"]}
        for n, v in verdicts.items()
        if "stopped" in v
    ]
    first = next(iter(verdicts.values()))
    return (
        {"name": loop_name(competitor)}
        | asdict(competitor)
        | {name: first[name] for name in ("cells", "mass_scaling", "damping_rate")}
        | {
            "test": relative_l2(sums, study.fem.interactions),
            "hard": relative_l2(sums, hard_numbers(dataset)),
            "stopped": stopped,
        }
        | {"sums": {str(number): pair for number, pair in sums.items()}}
    )
