"""Run time of every competitor in one run on one thread: force array in, displacement array out,
for one frame.

Each turn calls a competitor CALLS times in a row, as its own loop would, so that its weights are in
the caches that it can have; the turns alternate, so that a disturbance of the machine meets all
alike.
"""

from collections.abc import Callable

import numpy as np

from fem.data.dataset import Dataset
from fem.measure.timing import quantiles
from fem.online.stepper import Stepper
from fem.solver.frame_loop import FrameLoop
from unet_fem.deployment.latency import machine, time_steppers, use_threads
from unet_fem.study.dataset import frame_forces, study_dataset
from unet_fem.study.measure.loops import judge, loop, loop_name
from unet_fem.study.measure.tuning import tuned
from unet_fem.study.runs import deployed_runs
from unet_fem.study.settings import Study
from unet_fem.study.steppers import Competitor, networks, regressions

CALLS = 3
WARM_UP = 3  # turns before the clock runs


def run(study: Study) -> dict:
    """{"seconds": {competitor: {"p50": ..., "p90": ..., "p99": ..., "worst": ...}}, "data_frame_s",
    "data_frames", "machine": {...}}.

    data_frame_s: what the dataset's own solver takes for a frame of data on this thread, s;
    data_frames: frames to learn from.
    """
    use_threads(1)
    dataset = study_dataset(study)
    number = study.fem.interactions[0]
    own = dataset.read("test", ("force",), [number])["force"][0]
    frames = {frame: frame_forces(dataset, "test", number, frame) for frame in study.fem.frames}
    learned, loops = learned_steppers(study, dataset), loop_steppers(study, dataset)
    steppers: dict[str, Stepper] = {**learned, **loops}
    forces = dict.fromkeys(learned, own)
    forces |= {name: frames[loop.interval] for name, loop in loops.items()}
    print(
        f"timing {len(steppers)} competitors, {study.rounds} turns of {CALLS} calls, one thread",
        flush=True,
    )
    times = time_steppers(
        steppers,
        forces,
        study.rounds,
        calls=CALLS,
        warm_up=WARM_UP,
        beside={"dataset": data_action(dataset)},
    )
    data = times.pop("dataset")
    return {
        "seconds": {name: quantiles(values, digits=7) for name, values in times.items()},
        "data_frame_s": float(np.median(data)),
        "data_frames": int(np.isin(dataset.split, ("train", "validation")).sum())
        * len(dataset.time),
        "machine": machine() | {"rounds": study.rounds, "calls": CALLS},
    }


def learned_steppers(study: Study, dataset: Dataset) -> dict[str, Stepper]:
    """{name: Stepper} of the deployed networks and the regressions."""
    competitors: dict[str, Competitor] = {}
    for settings, parent in deployed_runs(study).values():
        competitors |= networks(settings, parent, dataset, threads=1)
    competitors |= regressions(study, dataset)
    return {name: own.make() for name, own in competitors.items()}


def loop_steppers(study: Study, dataset: Dataset) -> dict[str, FrameLoop]:
    """{name: FrameLoop} of every tuned loop that does not stop in the first interaction of
    study.fem."""
    return {
        loop_name(settings): loop(dataset, settings)
        for settings in tuned(study, dataset)[0]
        if "sums" in judge(study, dataset, settings, "test", study.fem.interactions[0])
    }


def data_action(dataset: Dataset) -> Callable:
    """One frame of the dataset's own simulation, under a steady push."""
    scene = dataset.scene
    solver = scene.build_solver(dataset.fem_mesh)
    force = dataset.sequence("test", 1).force
    load = force[np.linalg.norm(force, axis=(1, 2)).argmax()].T * 1e-3
    return lambda: solver.advance(scene.frames.interval, lambda t: load)
