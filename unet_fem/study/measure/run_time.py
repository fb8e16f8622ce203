"""Run time of every competitor in one run on one thread: force array in, displacement array out,
for one frame, with the same duties for all.

Each turn calls a competitor CALLS times in a row, as its own loop would, so that its weights are in
the caches that it can have; the turns alternate, so that a disturbance of the machine meets all
alike. Every call is timed by itself.
"""

import itertools
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fem.data.dataset import Dataset
from fem.measure.timing import quantiles
from fem.online.stepper import Stepper
from fem.solver.frame_loop import FrameLoop
from unet_fem.deployment.answers import muted
from unet_fem.deployment.latency import graph_action, machine, use_threads
from unet_fem.study.dataset import frame_forces, study_dataset
from unet_fem.study.measure.duties import dutiful
from unet_fem.study.measure.loops import judge, loop, loop_name
from unet_fem.study.measure.tuning import tuned
from unet_fem.study.runs import deployed_runs
from unet_fem.study.settings import Study
from unet_fem.study.steppers import Competitor, answering, networks, regressions

CALLS = 10
WARM_UP = 2  # turns before the clock runs
ENOUGH = 1000  # calls behind a p99
DATA_ROUNDS = 20  # frames of the dataset's own simulation


class Calls:
    """A stepper that is given `forces` (K, ...) mN to and fro without end, so that none jumps."""

    def __init__(self, stepper: Stepper, forces: np.ndarray, frame: float) -> None:
        self.stepper, self.dt = stepper, frame if stepper.interval is None else None
        self._frames = itertools.cycle([*forces, *forces[::-1]])
        self._period, self._done = 2 * len(forces), 0

    def prepare(self) -> None:
        """What comes before a call and is not timed: the next force, and at the end of all of them
        a reset, or tissue would creep on from round to round, farther than any force takes it."""
        if self._done == self._period:
            self.stepper.reset()
            self._done = 0
        self.force = next(self._frames)
        self._done += 1

    def __call__(self) -> None:
        """The call that is timed."""
        self.stepper.step(self.force, self.dt)


def run(study: Study) -> dict:
    """{"seconds": {competitor: {"p50", "p90", "p99", "worst", "calls", "bare"}}, "data_frame_s",
    "data_frames", "machine": {...}}.

    p99: None where fewer than ENOUGH calls are behind it; bare: p50 without the duties, of a
    .tflite file its graph alone. data_frame_s: what the dataset's own solver takes for a frame of
    data on this thread, s; data_frames: frames to learn from.
    """
    use_threads(1)
    dataset = study_dataset(study)
    number = study.fem.interactions[0]
    own = dataset.read("test", ("force",), [number])["force"][0]
    interval = dataset.scene.frames.interval
    frames = {frame: frame_forces(dataset, "test", number, frame) for frame in study.fem.frames}
    actions: dict[str, Any] = {}
    for name, competitor in learned(study, dataset).items():
        forces = own if competitor.frame is None else frames[competitor.frame]
        given = competitor.frame or interval
        actions[name] = Calls(dutiful(competitor.make(), dataset), forces, given)
        file = str(competitor.file or "")
        graph = file.endswith(".tflite")
        bare = graph_action(file) if graph else Calls(competitor.make(), forces, given)
        actions[f"bare {name}"] = bare
    for name, stepper in loop_steppers(study, dataset).items():
        forces = frames[stepper.interval]
        actions[name] = Calls(dutiful(stepper, dataset), forces, stepper.interval)
        actions[f"bare {name}"] = Calls(loop(dataset, stepper.settings), forces, stepper.interval)
    print(f"timing {len(actions)} actions, {study.rounds} turns of {CALLS} calls", flush=True)
    times = time_calls(actions, study.rounds)
    return {
        "seconds": {
            name: distribution(values) | {"bare": float(np.median(times[f"bare {name}"]))}
            for name, values in times.items()
            if not name.startswith("bare ")
        },
        "data_frame_s": data_frame(dataset),
        "data_frames": int(np.isin(dataset.split, ("train", "validation")).sum())
        * len(dataset.time),
        "machine": machine() | {"rounds": study.rounds, "calls": CALLS},
    }


def time_calls(actions: Mapping[str, Callable], rounds: int) -> dict[str, np.ndarray]:
    """{name: (rounds * CALLS,) s}: the actions take turns of CALLS calls."""
    times = {name: np.empty((rounds + WARM_UP, CALLS)) for name in actions}
    with muted():
        for turn in range(rounds + WARM_UP):
            for name, action in actions.items():
                prepare = getattr(action, "prepare", lambda: None)
                for call in range(CALLS):
                    prepare()
                    start = time.perf_counter()
                    action()
                    times[name][turn, call] = time.perf_counter() - start
    return {name: values[WARM_UP:].ravel() for name, values in times.items()}


def distribution(values: np.ndarray) -> dict:
    """{"p50", "p90", "p99", "worst", "calls"} of times in s; p99 None for fewer than ENOUGH."""
    found = quantiles(values, digits=7) | {"calls": len(values)}
    return found if len(values) >= ENOUGH else found | {"p99": None}


def learned(study: Study, dataset: Dataset) -> dict[str, Competitor]:
    """{name: Competitor}: the deployed networks, the regressions and study.answers."""
    competitors: dict[str, Competitor] = {}
    for settings, parent in deployed_runs(study).values():
        competitors |= networks(settings, parent, dataset, threads=1)
    return competitors | regressions(study, dataset) | answering(study, dataset)


def loop_steppers(study: Study, dataset: Dataset) -> dict[str, FrameLoop]:
    """{name: FrameLoop} of every tuned loop that does not stop in the first interaction of
    study.fem."""
    first = "test", study.fem.interactions[0]
    return {
        loop_name(settings): loop(dataset, settings)
        for settings in tuned(study, dataset)[0]
        if "sums" in judge(study, dataset, settings, first)
    }


def data_frame(dataset: Dataset) -> float:
    """Seconds that a frame of the dataset's own simulation takes under a steady push, the
    median."""
    scene = dataset.scene
    solver = scene.build_solver(dataset.fem_mesh)
    force = dataset.sequence("test", 1).force
    load = force[np.linalg.norm(force, axis=(1, 2)).argmax()].T * 1e-3
    times = []
    for _ in range(DATA_ROUNDS):
        start = time.perf_counter()
        solver.advance(scene.frames.interval, lambda t: load)
        times.append(time.perf_counter() - start)
    return float(np.median(times))
