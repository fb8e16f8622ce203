"""Time dependence: does a network know more than the elastic, memoryless answer to the same force?

The tissue creeps: under a held force it goes on giving way. An elastic tissue answers the force of
the moment alone. What lies between the two answers to the same contacts is the time dependence, and
a network may have learned all, some or none of it.
"""

from dataclasses import replace

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from unet_fem.deployment.answers import answers as frame_by_frame
from unet_fem.study.dataset import judged_numbers, study_dataset
from unet_fem.study.measure.creep import dot, fields, judge
from unet_fem.study.measure.elastic import elastic_answers
from unet_fem.study.measure.statistics import difference
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import Study
from unet_fem.study.steppers import (
    Competitor,
    linear_name,
    linear_regressions,
    networks,
)
from unet_fem.training.run import ensure_dataset

Labelled = tuple[str, np.ndarray]


def run(study: Study) -> dict:
    """{"trained_s": length of the networks' interactions, "factor": ..., "short": ..., "long":
    ...}.

    short: the judged test interactions of the networks' own dataset; long: those of
    study.long_data. Each as `judge` gives it, with "numbers" of the interactions, "left_out":
    {number: why the elastic tissue stopped in it} and "window": the difference that the longer
    window makes, see `difference`. factor: the one number times which the elastic answer
    comes closest to the short interactions: the best that can be known without memory, but for the
    answer's shape.
    """
    short, long = study_dataset(study), _long_dataset(study)
    result: dict = {"trained_s": float(short.time[-1])}
    shown = shown_competitors(study, short)
    for name, dataset, numbers in (
        ("short", short, judged_numbers(study, short)),
        ("long", long, long.number[long.split == "test"].tolist()),
    ):
        simulated, stopped = elastic_answers(study, dataset, numbers)
        elastic = fields(dataset, np.stack(list(simulated.values())))
        learned, truth = answers(shown, dataset, list(simulated))
        if name == "short":
            factor = float(dot(truth, elastic).sum() / dot(elastic, elastic).sum())
            result["factor"] = factor
        own = {
            "elastic": ("elastic FEM", elastic),
            "scaled": (f"elastic FEM × {factor:.2f}", factor * elastic),
        }
        result[name] = judge(dataset.time, truth, elastic, own | learned) | {
            "numbers": list(simulated),
            "left_out": stopped,
        }
        shorter, longer = (
            np.array([result[name]["answers"][run]["squared_error"]]) for run in study.window
        )
        squared_truth = np.array(result[name]["squared_truth"])
        result[name]["window"] = difference(longer, shorter, squared_truth)
    return result


def shown_competitors(study: Study, dataset: Dataset) -> dict[str, tuple[str, Competitor]]:
    """{name: (label, Competitor)}: the main networks and both windows, named by their runs, and one
    linear regression for each number of forces that they see."""
    first, *others = [main.run for main in study.main]
    labels = {main.run: main.label for main in study.main}
    runs = dict.fromkeys((first, *study.window, *others))
    settings = {run: study.network(run) for run in runs}
    linear = linear_regressions(dataset, (own.model.window for own in settings.values()))
    shown = {}
    for run, own in settings.items():
        competitor = networks(own, None, dataset)[f"{run}: {KERAS}"]
        label, frames = labels.get(run, competitor.family), competitor.frames
        shown[run] = f"{label}, {frames} forces" if own.model.window else label, competitor
        if f"linear {frames}" not in shown:
            label = f"linear, {frames} force{'s' * (frames > 1)}"
            shown[f"linear {frames}"] = label, linear[linear_name(frames)]
    return shown


def answers(
    shown: dict[str, tuple[str, Competitor]], dataset: Dataset, numbers: list[int]
) -> tuple[dict[str, Labelled], np.ndarray]:
    """({name: (label, answer)}, truth) for the test interactions `numbers`, each field
    (interactions, frames, d) mm."""
    own = dataset.read("test", ("force", "displacement"), numbers)
    found = {}
    for name, (label, competitor) in shown.items():
        print(f"{label} on {dataset.path.name}", flush=True)
        answer = frame_by_frame(competitor.make(), own["force"])
        found[name] = label, fields(dataset, answer)
    return found, fields(dataset, own["displacement"])


def _long_dataset(study: Study) -> Dataset:
    """That of the long interactions. Raises InputError if the networks cannot take its forces."""
    settings, short = study.network(study.main[0].run), study_dataset(study)
    long = ensure_dataset(replace(settings, scene=study.long_scene, data=study.long_data))
    if long.grid != short.grid or long.scene.frames.interval != short.scene.frames.interval:
        raise InputError(
            f"{study.long_scene} has a grid of {long.grid} nodes and frames"
            f" {long.scene.frames.interval:g} s apart, the networks learned from {short.grid} and"
            f" {short.scene.frames.interval:g} s; give it the mesh and frames.interval of"
            f" {settings.scene}"
        )
    return long
