"""Time dependence: does a network know more than the elastic, memoryless answer to the same force?

The tissue creeps: under a held force it goes on giving way. An elastic tissue answers the force of
the moment alone. What lies between the two answers to the same contacts is the time dependence, and
a network may have learned all, some or none of it.
"""

from dataclasses import replace

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from unet_fem.study.dataset import Case, name_of, study_dataset
from unet_fem.study.measure.creep import dot, fields, judge
from unet_fem.study.measure.elastic import elastic_answers
from unet_fem.study.measure.statistics import difference
from unet_fem.study.runs import KERAS, trained_runs
from unet_fem.study.settings import Long, Study
from unet_fem.study.steppers import (
    Competitor,
    answering,
    followed,
    linear_name,
    linear_regressions,
    networks,
)
from unet_fem.training.run import ensure_dataset

Labelled = tuple[str, np.ndarray]
FACTOR_FROM = 8  # validation interactions that the factor of the scaled elastic answer is fitted to


def run(study: Study) -> dict:
    """{"trained_s": length of the networks' interactions, "factor": ..., "parts": [...]}.

    parts: the usual interactions of the headline, then those of each of study.long. Each as `judge`
    gives it, with "cases": names of the interactions, "solver": kind of the solver that they are
    simulated by, "left_out": {name: why the elastic tissue stopped in it} and "window": the
    difference that the longer window makes, see `difference`, None where one of both is not
    trained. factor: the one number times which the elastic answer comes closest to validation
    interactions: the best that can be known without memory, but for the answer's shape.
    """
    short = study_dataset(study)
    factor = elastic_factor(study, short)
    shown = shown_competitors(study, short)
    chosen = [(short, list(study.fem.interactions))]
    for which in study.long:
        long = _long_dataset(study, which)
        numbers = long.number[long.split == "test"].tolist()
        chosen.append((long, numbers[: which.interactions]))
    parts = []
    for dataset, numbers in chosen:
        simulated, stopped = elastic_answers(study, dataset, [("test", n) for n in numbers])
        elastic = fields(dataset, np.stack(list(simulated.values())))
        learned, truth = answers(shown, dataset, list(simulated))
        own = {
            "elastic": ("elastic FEM", elastic),
            "scaled": (f"elastic FEM × {factor:.2f}", factor * elastic),
        }
        part = judge(dataset.time, truth, elastic, own | learned) | {
            "cases": [name_of(case) for case in simulated],
            "solver": dataset.scene.solver.kind,
            "left_out": stopped,
            "window": None,
        }
        found = part["answers"]
        if all(run in found for run in study.window):
            shorter, longer = (np.array([found[run]["squared_error"]]) for run in study.window)
            squared_truth = np.array(part["squared_truth"])
            part["window"] = difference(longer, shorter, squared_truth)
        parts.append(part)
    return {"trained_s": float(short.time[-1]), "factor": factor, "parts": parts}


def elastic_factor(study: Study, dataset: Dataset) -> float:
    """The number times which the elastic answer comes closest to the first validation
    interactions."""
    numbers = dataset.number[dataset.split == "validation"][:FACTOR_FROM].tolist()
    simulated, _ = elastic_answers(study, dataset, [("validation", n) for n in numbers])
    elastic = fields(dataset, np.stack(list(simulated.values())))
    chosen = [number for _, number in simulated]
    truth = dataset.read("validation", ("displacement",), chosen)["displacement"]
    own = fields(dataset, truth)
    return float(dot(own, elastic).sum() / dot(elastic, elastic).sum())


def shown_competitors(study: Study, dataset: Dataset) -> dict[str, tuple[str, Competitor]]:
    """{name: (label, Competitor)}: the main networks and both windows where they are trained, named
    by their runs, one linear regression for each number of forces that they see, and those of
    study.answers that are to be shown, at the dataset's frames."""
    first, *others = [main.run for main in study.main]
    labels = {main.run: main.label for main in study.main}
    runs = dict.fromkeys((first, *study.window, *others))
    settings, trained = {run: study.network(run) for run in runs}, trained_runs(study)
    linear = linear_regressions(dataset, (own.model.window for own in settings.values()))
    shown: dict[str, tuple[str, Competitor]] = {}
    for run, own in settings.items():
        frames = own.model.window or 1
        if run in trained:
            competitor = networks(own, None, dataset)[f"{run}: {KERAS}"]
            label = labels.get(run, competitor.family)
            shown[run] = f"{label}, {frames} forces" if own.model.window else label, competitor
        if f"linear {frames}" not in shown:
            label = f"linear, {frames} force{'s' * (frames > 1)}"
            shown[f"linear {frames}"] = label, linear[linear_name(frames)]
    interval = dataset.scene.frames.interval
    for name, competitor in answering(study, dataset, shown=True).items():
        if competitor.frame in (None, interval):
            shown[name] = name.split(" / ")[0], competitor
    return shown


def answers(
    shown: dict[str, tuple[str, Competitor]], dataset: Dataset, cases: list[Case]
) -> tuple[dict[str, Labelled], np.ndarray]:
    """({name: (label, answer)}, truth) for interactions of the split "test", each field
    (interactions, frames, d) mm."""
    own = dataset.read("test", ("force", "displacement"), [number for _, number in cases])
    interval, found = dataset.scene.frames.interval, {}
    for name, (label, competitor) in shown.items():
        print(f"{label} on {dataset.path.name}", flush=True)
        stepper = competitor.make()
        answer = np.stack([followed(stepper, force, interval) for force in own["force"]])
        found[name] = label, fields(dataset, answer.reshape(-1, *answer.shape[2:]))
    return found, fields(dataset, own["displacement"])


def _long_dataset(study: Study, own: Long) -> Dataset:
    """That of long interactions. Raises InputError if the networks cannot take its forces."""
    settings, short = study.network(study.main[0].run), study_dataset(study)
    long = ensure_dataset(replace(settings, scene=own.scene, data=own.data))
    if long.grid != short.grid or long.scene.frames.interval != short.scene.frames.interval:
        raise InputError(
            f"{own.scene} has a grid of {long.grid} nodes and frames"
            f" {long.scene.frames.interval:g} s apart, the networks learned from {short.grid} and"
            f" {short.scene.frames.interval:g} s; give it the mesh and frames.interval of"
            f" {settings.scene}"
        )
    return long
