"""Errors of every competitor but the FEM's loops, on every unseen interaction.

A competitor has an entry for each form that it is deployed in. Keras' answers stand under
"tf.function", the form that is timed.
"""

from pathlib import Path

import numpy as np

from fem.cache import once
from fem.data.dataset import Dataset
from fem.errors import InputError, SolverStopped
from unet_fem.deployment.exported import files_there
from unet_fem.deployment.forms import CALL
from unet_fem.metrics import relative_l2
from unet_fem.networks.files import load_model
from unet_fem.study.dataset import (
    Case,
    everything,
    frame_forces,
    frames_between,
    headline,
    name_of,
    named,
    study_dataset,
    unseen,
)
from unet_fem.study.keys import key
from unet_fem.study.measure.fields import drawn_regression, drawn_runs, keep_field
from unet_fem.study.measure.judged import (
    by_case,
    judged,
    run_facts,
    unseen_cases,
    unseen_samples,
)
from unet_fem.study.measure.reference import references
from unet_fem.study.measure.statistics import errors
from unet_fem.study.runs import KERAS, trained_runs
from unet_fem.study.settings import Study
from unet_fem.study.steppers import (
    Competitor,
    answering,
    followed,
    networks,
    regressions,
    trained_on,
)
from unet_fem.training.inputs import run_input
from unet_fem.training.judge import predict, rest_volume
from unet_fem.training.samples import Samples, load_samples
from unet_fem.training.settings import Settings

VERSION = 2
Truth = dict[Case, np.ndarray]


def run(study: Study) -> dict:
    """{"models": {name: entry}, "runs": {run: facts}, "trained_on": interactions of the split that
    networks and regressions learn from, "subsets", "headline": {"usual", "hard":
    names of unseen interactions}, "force": {name: largest total force, mN}, "fem_violation":
    {name: largest change of volume in the FEM}}.

    entry: the facts of a Competitor, what `judged` says, headline: {"usual", "hard"} against the
    reference, see statistics.errors, and for some field: the file in the cache that holds the
    answer; a regression also has train and validation. facts of a run: kind, family, parent,
    frames and what `run_facts` says. Runs that are not trained yet are left out.
    """
    dataset = study_dataset(study)
    truth = references(study, dataset)
    samples = unseen_samples(dataset)
    models, runs = {}, {}
    for settings, parent in trained_runs(study).values():
        own = networks(settings, parent, dataset)
        del own[f"{settings.name}: {CALL}"]  # answers as KERAS does
        for name, competitor in own.items():
            models[name] = _network(study, settings, name, competitor, dataset, samples, truth)
        facts = next(iter(own.values())).facts()
        del facts["form"]
        runs[settings.name] = facts | _facts(study, settings, dataset)
    for name, competitor in regressions(study, dataset).items():
        models[name] = _regression(study, name, competitor, dataset, samples, truth)
    for name, competitor in answering(study, dataset).items():
        models[name] = _answer(study, name, competitor, dataset, samples, truth)
    chosen = named(headline(study, dataset))
    for model in models.values():
        model["headline"] = errors(model["reference"], chosen)
    cases = unseen_cases(dataset)
    force = np.linalg.norm(samples.force, axis=-1).sum(axis=(1, 2, 3), dtype=float)
    return {
        "models": models,
        "runs": runs,
        "trained_on": trained_on(dataset),
        "subsets": named(unseen(dataset)),
        "headline": chosen,
        "force": by_case(cases, force),
        "fem_violation": by_case(cases, np.abs(samples.volume / rest_volume(dataset) - 1)),
    }


def keras_answer(path: Path, samples: Samples, dataset: Dataset) -> np.ndarray:
    """Displacement (S, nx, ny, nz, 3) mm that the Keras model at `path` gives for Samples.

    In batches: frame by frame the 26 runs of the study would take an hour. A test shows that both
    are the same.
    """
    return predict(load_model(path), samples, dataset)[0]


def _network(study, settings, name, competitor, dataset, samples, truth):
    """The entry of one form of a run, kept until its file, the dataset or the reference changes."""
    batched = competitor.form == KERAS
    path = settings.folder / "best.keras" if batched else files_there(settings)[competitor.form]
    gate, volume_of = settings.loss.volume_threshold, settings.loss.volume_of
    made_from = _key(study, truth, (gate, volume_of, competitor.form), [dataset.path, path])
    entry = study.cache / "accuracy" / f"{made_from}.json"
    field = entry.with_suffix(".npz") if batched and settings.name in drawn_runs(study) else None
    if field and not field.is_file():
        entry.unlink(missing_ok=True)

    def judge():
        print(f"judging {name}", flush=True)
        if batched:
            seen = run_input(settings, dataset)
            own = unseen_samples(dataset, settings.model.window, seen)
            answer = keras_answer(path, own, dataset)
        else:
            answer = _followed(competitor, samples.force, dataset)
        if field:
            keep_field(field, dataset, answer)
        return judged(answer, dataset, samples, truth, gate, volume_of=volume_of)

    found = competitor.facts() | once(entry, made_from, judge)
    return found | ({"field": str(field.relative_to(study.cache))} if field else {})


def _regression(study, name, competitor, dataset, samples, truth):
    """The entry of a regression; its fit takes seconds, so that it is not kept."""
    print(f"judging {name}", flush=True)
    answer = _followed(competitor, samples.force, dataset)
    splits = {}
    for split in ("train", "validation"):
        own = load_samples(dataset, split, None)
        splits[split] = relative_l2(_followed(competitor, own.force, dataset), own.displacement)
    found = competitor.facts() | splits | judged(answer, dataset, samples, truth)
    if name != drawn_regression(study):
        return found
    field = study.cache / "accuracy" / f"{key(name, [dataset.path], VERSION)}.npz"
    keep_field(field, dataset, answer)
    return found | {"field": str(field.relative_to(study.cache))}


def _answer(study, name, competitor, dataset, samples, truth):
    """The entry of one of study.answers, and "stopped": [{"case", "reason"}] where it is a solver
    that cannot go on; a FEM, and what is asked for frames shorter than the dataset's, is judged on
    the interactions of the headline alone."""
    same = (competitor.family, competitor.frame, competitor.options)  # and its file
    made_from = _key(study, truth, same, [dataset.path, competitor.file or ""])
    entry = study.cache / "accuracy" / f"{made_from}.json"
    frame = competitor.frame or dataset.scene.frames.interval
    few = competitor.kind == "FEM" or frames_between(dataset.scene, frame) > 1

    def judge():
        print(f"judging {name}", flush=True)
        every = unseen_cases(dataset)
        stepper, order = competitor.make(), {case: n for n, case in enumerate(every)}
        answers, stopped = {}, []
        for case in everything(headline(study, dataset)) if few else every:
            rows = _rows(dataset, [order[case]])
            try:
                answers[case] = _one(stepper, dataset, case, frame, samples.force[rows])
            except SolverStopped as stop:
                stopped.append({"case": name_of(case), "reason": stop.reason})
        if not answers:
            raise InputError(f"answer '{name}' stops in every interaction; leave it out")
        cases = list(answers)
        own = samples.select(_rows(dataset, [order[case] for case in cases]))
        known = {case: field for case, field in truth.items() if case in answers}
        found = judged(np.concatenate(list(answers.values())), dataset, own, known, cases=cases)
        return found | {"stopped": stopped}

    return competitor.facts() | once(entry, made_from, judge)


def _one(stepper, dataset, case, frame, force):
    """The answer to an interaction at the dataset's frames, (frames, nx, ny, nz, 3) mm; force: at
    these frames, mN."""
    every = frames_between(dataset.scene, frame)
    if every == 1:
        return followed(stepper, force, frame)
    answer = np.zeros_like(force)
    answer[1:] = followed(stepper, frame_forces(dataset, *case, frame), frame)[every - 1 :: every]
    return answer


def _rows(dataset, places):
    """Rows of the samples of the interactions at these places of `unseen_cases`."""
    frames = np.arange(len(dataset.time))
    return np.concatenate([place * len(frames) + frames for place in places])


def _followed(competitor: Competitor, force: np.ndarray, dataset: Dataset) -> np.ndarray:
    """(S, nx, ny, nz, 3) mm, frame by frame, of forces (S, nx, ny, nz, 3) mN of whole
    interactions."""
    stepper, frames = competitor.make(), len(dataset.time)
    parts = force.reshape(-1, frames, *force.shape[1:])
    interval = dataset.scene.frames.interval
    return np.concatenate([followed(stepper, own, interval) for own in parts])


def _facts(study: Study, settings: Settings, dataset: Dataset) -> dict:
    own = [settings.folder / name for name in ("config.toml", "best.keras", "history.json")]
    made_from = key("facts", [dataset.path, *own], VERSION)
    path = study.cache / "accuracy" / f"{made_from}.json"
    return once(path, made_from, lambda: run_facts(settings, dataset))


def _key(study, truth, settings, files):
    chosen = (study.fem.reference_safety, sorted(truth), settings)
    return key(chosen, files, VERSION)
