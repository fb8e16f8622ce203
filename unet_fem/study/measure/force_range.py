"""Stability beside accuracy: under which multiple of the usual forces, and until when, does each
competitor stay close to the FEM?

The contacts of test interactions push with their forces times each factor. The dataset's own solver
gives the truth, as far as its run is fit for a dataset; a competitor holds where its relative L2
error is within TOLERANCE and its volume within the paper's band.
"""

from dataclasses import dataclass, field

import numpy as np

from fem.data.dataset import Dataset
from fem.online.stepper import Stepper
from fem.online.volume import VOLUME_BAND
from fem.solver.frame_loop import LoopSettings
from unet_fem.deployment.answers import muted
from unet_fem.runtime.surrogate import force_size
from unet_fem.study.dataset import study_dataset
from unet_fem.study.measure.judged import volumes
from unet_fem.study.measure.multiplied import frames, simulated
from unet_fem.study.measure.tuning import tuned
from unet_fem.study.runs import KERAS, trained_runs
from unet_fem.study.settings import LINEAR, Study
from unet_fem.study.steppers import (
    Competitor,
    answering,
    linear_name,
    linear_regressions,
    networks,
)

TOLERANCE = 0.10  # relative L2


def run(study: Study) -> dict:
    """How far every competitor is from the truth, over force factor and time.

    Returns {"factors", "time": s, "interactions": numbers, "tolerance", "band", "alive":
    interactions that the truth reaches this frame in, "flag": share of all interactions whose force
    leaves the training range, "stops": [{"what", "number", "factor", "after": s, "reason"}],
    "competitors": {name: {"relative_l2", "volume", "stopped"}}}. Tables are lists [factors][frames]
    over
    the interactions that are alive: relative_l2, None where none moves or where a run of the
    competitor has stopped; volume, the largest |V / V_rest - 1| (also of "truth"), None where none
    is alive; stopped, runs of the competitor that have.
    """
    dataset = study_dataset(study)
    parts = simulated(study, dataset, real_time(study, dataset))
    steppers = {name: own.make() for name, own in shown_competitors(study, dataset).items()}
    largest = np.array(force_size(dataset.read("train")["force"]))
    factors, interval = list(study.stability.factors), dataset.scene.frames.interval
    count = len(study.stability.interactions)
    tables = Tables((len(factors), len(dataset.time)), dataset)
    flag, stops = np.zeros(tables.shape), []
    for (number, factor), (force, answers, reasons) in parts:
        print(f"judging interaction {number}, forces x {factor:g}", flush=True)
        row = factors.index(factor)
        flag[row] += [np.any(np.array(force_size(field)) > 1.00001 * largest) for field in force]
        for name, own in steppers.items():
            answers[name], reasons[name] = as_far(own, force, interval)
        stops += [
            {
                "what": name,
                "number": number,
                "factor": factor,
                "after": float(dataset.time[len(answers[name]) - 1]),
                "reason": reason,
            }
            for name, reason in reasons.items()
            if reason
        ]
        tables.add(row, answers)
    return {
        "factors": factors,
        "time": dataset.time.tolist(),
        "interactions": list(study.stability.interactions),
        "tolerance": TOLERANCE,
        "band": VOLUME_BAND,
        "alive": tables.alive.tolist(),
        "flag": (flag / count).tolist(),
        "stops": stops,
        "competitors": tables.results(),
    }


def as_far(stepper: Stepper, force: np.ndarray, interval: float) -> tuple[np.ndarray, str]:
    """(answers (frames reached, ...) mm to forces (F, ...) mN every `interval` s, why it went no
    farther, or "")."""
    dt = interval if stepper.interval is None else None
    stepper.reset()
    with muted(), np.errstate(all="ignore"):
        first = stepper.step(force[0], dt)
        fields, reason = frames(lambda n: stepper.step(force[n], dt), force.shape)
    fields[0] = first
    return fields, str(reason)


@dataclass
class Tables:
    """Sums over interactions, each (factors, frames)."""

    shape: tuple[int, int]
    dataset: Dataset
    squared: dict[str, np.ndarray] = field(default_factory=dict)
    volume: dict[str, np.ndarray] = field(default_factory=dict)
    stopped: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.alive, self.size = np.zeros(self.shape, int), np.zeros(self.shape)
        self.rest = self.dataset.rest_volume

    def add(self, row: int, answers: dict[str, np.ndarray]) -> None:
        """Take in the answers to one interaction, "truth" among them, at the factor of `row`."""
        free = self.dataset.free
        truth = answers["truth"][:, free].astype(float)
        here = len(truth)  # frames that the truth reaches
        self.alive[row, :here] += 1
        self.size[row, :here] += np.square(truth).sum(axis=(1, 2))
        for name, answer in answers.items():
            answer = answer[:here]  # what comes after the truth has stopped cannot be judged
            squared, volume, stopped = (
                store.setdefault(name, np.zeros(self.shape))
                for store in (self.squared, self.volume, self.stopped)
            )
            reached = len(answer)
            error = np.square(answer[:, free] - truth[:reached]).sum(axis=(1, 2))
            squared[row, :reached] += error
            change = np.abs(volumes(self.dataset.surface, answer) / self.rest - 1)
            volume[row, :reached] = np.maximum(volume[row, :reached], change)
            stopped[row, reached:here] += 1

    def results(self) -> dict[str, dict]:
        """{name: {"relative_l2", "volume", "stopped"}} as `run` gives them."""
        moving, size = self.size > 0, np.where(self.size > 0, self.size, 1)
        found = {}
        for name, squared in self.squared.items():
            going = self.stopped[name] == 0
            found[name] = {
                "relative_l2": _known(np.sqrt(squared / size), moving & going),
                "volume": _known(self.volume[name], (self.alive > 0) & going),
                "stopped": self.stopped[name].astype(int).tolist(),
            }
        return found


def real_time(study: Study, dataset: Dataset) -> LoopSettings:
    """The loop that stands for the FEM in real time: of the tuned loops of full elements at the
    shortest frame, that of fewest steps."""
    found = [
        settings
        for settings in tuned(study, dataset)[0]
        if settings.element == "full"
        and not settings.coarse
        and settings.frame == min(study.fem.frames)
    ]
    return min(found, key=lambda settings: settings.steps)


def shown_competitors(study: Study, dataset: Dataset) -> dict[str, Competitor]:
    """{label: Competitor}: linear regression on the forces that the first main network sees, those
    of study.answers that are to be shown, at the dataset's frames, and the main networks, each also
    in int8 where it is exported."""
    window = study.network(study.main[0].run).model.window
    shown = {LINEAR: linear_regressions(dataset, [window])[linear_name(window)]}
    for name, competitor in answering(study, dataset, shown=True).items():
        if competitor.frame in (None, dataset.scene.frames.interval):
            shown[name.split(" / ")[0]] = competitor
    trained = trained_runs(study)
    for main in study.main:
        if main.run not in trained:
            continue
        forms = networks(study.network(main.run), None, dataset)
        shown[main.label] = forms[f"{main.run}: {KERAS}"]
        if f"{main.run}: int8" in forms:
            shown[f"{main.label}, int8"] = forms[f"{main.run}: int8"]
    return shown


def _known(values, known):
    return np.where(known, values, None).tolist()
