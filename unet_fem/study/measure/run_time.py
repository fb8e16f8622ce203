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

from fem.contact.surface import surface_of
from fem.data.dataset import Dataset
from fem.data.draws import drawn_contacts
from fem.data.interaction import simulate
from fem.data.scene import load_scene
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
SIMULATED = 3  # interactions of each scene, for what data cost


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
    """{"seconds": {competitor: {"p50", "p90", "p99", "worst", "calls", "bare"}}, "interaction_s":
    {scene: s}, "simulated": interactions of the dataset to learn from and to choose by,
    "machine": {...}}.

    p99: None where fewer than ENOUGH calls are behind it; bare: p50 without the duties, of a
    .tflite file its graph alone. interaction_s: what a scene's own solver takes for an interaction,
    s of this thread; "" is the scene of the dataset.
    """
    use_threads(1)
    dataset = study_dataset(study)
    scenes = sorted({"", *(own.scene for own in study.answers)})
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
        "interaction_s": {scene: interaction_seconds(dataset, scene) for scene in scenes},
        "simulated": int(np.isin(dataset.split, ("train", "validation")).sum()),
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


def interaction_seconds(dataset: Dataset, scene: str) -> float:
    """CPU seconds that the first training interactions of `scene`, "" for the dataset's, take in
    the middle; its own solver, one thread."""
    own = load_scene(scene) if scene else dataset.scene
    mesh, times = dataset.fem_mesh, []
    surface = surface_of(mesh)
    for number in range(1, SIMULATED + 1):
        contacts = drawn_contacts(own, surface, "train", number, 0)
        start = time.process_time()
        simulate(own, mesh, contacts, surface)
        times.append(time.process_time() - start)
    return float(np.median(times))
