"""One FEM loop on one interaction, judged against the converged reference."""

import numpy as np

from fem.cache import once
from fem.data.dataset import Dataset
from fem.errors import SolverStopped
from fem.solver.frame_loop import FrameLoop, LoopSettings
from unet_fem.study.dataset import Case, frame_forces, frames_between
from unet_fem.study.keys import key
from unet_fem.study.measure.reference import references
from unet_fem.study.measure.sums import sums_of_squares
from unet_fem.study.settings import Study

VERSION = 1


def loop_name(settings: LoopSettings) -> str:
    """What a loop is called among the competitors."""
    coarse = ", coarse" if settings.coarse else ""
    frame = f"{1e3 * settings.frame:g} ms"
    return f"FEM {settings.element}{coarse}, {settings.steps} steps / {frame}"


def loop(dataset: Dataset, settings: LoopSettings) -> FrameLoop:
    """The loop on the dataset's mesh and material."""
    return FrameLoop(dataset.fem_mesh, dataset.material, settings)


def judge(study: Study, dataset: Dataset, settings: LoopSettings, case: Case) -> dict:
    """Simulate one interaction in frames: {"sums": [error, truth] mm2} against the reference, or
    {"stopped": reason, "time": s}.

    With it come "mass_scaling", "damping_rate" and "cells". Kept in a file of the cache.
    """
    made_from = (study.fem.reference_safety, settings, *case)
    name = key(made_from, [dataset.path], VERSION)
    path = study.cache / "fixed_latency" / f"{name}.json"
    return once(path, name, lambda: _judge(study, dataset, settings, case))


def _judge(study, dataset, settings, case):
    truth = references(study, dataset, [case])[case]
    every = frames_between(dataset.scene, settings.frame)
    stepper, answer = loop(dataset, settings), np.zeros_like(truth)
    verdict = {
        "mass_scaling": float(stepper.mass_scaling),
        "damping_rate": float(stepper.damping_rate),
        "cells": int(stepper.solver.mesh.n_cells),
    }
    try:
        for k, force in enumerate(frame_forces(dataset, *case, settings.frame), 1):
            displacement = stepper.step(force)
            if k % every == 0:
                answer[k // every] = displacement
    except SolverStopped as stop:
        return verdict | {"stopped": stop.reason, "time": float(stepper.solver.time)}
    return verdict | {"sums": sums_of_squares(answer, truth, dataset)}
