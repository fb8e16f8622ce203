"""Run time of every competitor in one run on one thread: force array in, displacement array out,
for one frame.

Each turn calls a competitor CALLS times in a row, as its own loop would, so that its weights are in
the caches that it can have; the turns alternate, so that a disturbance of the machine meets all
alike.
"""

from functools import partial

import numpy as np

from fem.measure.timing import alternate, quantiles
from unet_fem.study import runs as pipeline

CALLS = 3
WARM_UP = 3  # turns before the clock runs


def run(study):
    """{"seconds": {competitor: {"p50": ..., "p90": ..., "p99": ..., "worst": ...}}, "data_frame_s",
    "data_frames", "machine": {...}}.

    data_frame_s: what the dataset's own solver takes for a frame of data on this thread, s;
    data_frames: frames to learn from.
    """
    from unet_fem.deployment import latency

    latency.use_threads(1)
    from unet_fem.deployment.forms import forms
    from unet_fem.study import regressions
    from unet_fem.study.measure import fixed_latency
    from unet_fem.training.run import open_run

    actions = {}
    for folder in deployed_runs(study):
        settings, dataset = open_run(folder)
        actions |= {
            f"{settings.name}: {form}": partial(make().step, dataset.read("test")["force"][0, -1])
            for form, make in forms(settings, dataset).items()
        }
    actions |= regressions.actions(study, dataset)
    actions |= fixed_latency.frame_actions(study, dataset)
    actions["dataset"] = data_action(dataset)
    print(
        f"timing {len(actions)} competitors, {study.rounds} turns of {CALLS} calls, one thread",
        flush=True,
    )
    times = alternate(
        {name: repeated(action) for name, action in actions.items()}, study.rounds, WARM_UP
    )
    data = times.pop("dataset")
    return {
        "seconds": {name: quantiles(values, digits=7) for name, values in times.items()},
        "data_frame_s": float(np.median(data)),
        "data_frames": int((dataset.split != "test").sum()) * len(dataset.time),
        "machine": latency.machine() | {"rounds": study.rounds, "calls": CALLS},
    }


def deployed_runs(study):
    """Folders of the deployed runs and of what pruning made of the main ones, where it is there."""
    names = [
        *study.deployed,
        *(
            run
            for main in (study.cnn_lstm, study.unet)
            for run in pipeline.pruned_runs(study, main).values()
        ),
    ]
    folders = [study.folder.parent / name for name in dict.fromkeys(names)]
    return [folder for folder in folders if (folder / "best.keras").is_file()]


def repeated(action):
    def turn():
        for _ in range(CALLS):
            action()
        return CALLS

    return turn


def data_action(dataset):
    """One frame of the dataset's own simulation, under a steady push."""
    scene = dataset.scene
    solver = scene.build_solver(dataset.fem_mesh)
    force = dataset.sequence("test", 1).force
    load = force[np.linalg.norm(force, axis=(1, 2)).argmax()].T * 1e-3
    return lambda: solver.advance(scene.frames.interval, lambda t: load)
