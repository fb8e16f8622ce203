"""Errors of every competitor that is not the FEM itself, on every test interaction, so that any
subset can be judged later.

A competitor has an entry for each form that it is deployed in. Keras' answers stand under
"tf.function", the form that is timed.
"""

from pathlib import Path

import numpy as np

from fem.cache import once
from fem.data.dataset import Dataset
from unet_fem.deployment.answers import answers
from unet_fem.deployment.exported import files_there
from unet_fem.deployment.forms import CALL
from unet_fem.metrics import relative_l2
from unet_fem.networks.files import load_model
from unet_fem.study.dataset import hard_numbers, study_dataset
from unet_fem.study.keys import key
from unet_fem.study.measure import sums
from unet_fem.study.measure.fields import drawn_regression, drawn_runs, keep_field
from unet_fem.study.measure.judged import judged, run_facts
from unet_fem.study.measure.reference import references
from unet_fem.study.runs import KERAS, trained_runs
from unet_fem.study.settings import Study
from unet_fem.study.steppers import Competitor, networks, regressions
from unet_fem.training.inputs import run_input
from unet_fem.training.judge import predict, rest_volume
from unet_fem.training.samples import Samples, load_samples
from unet_fem.training.settings import Settings

VERSION = 1
Truth = dict[int, np.ndarray]


def run(study: Study) -> dict:
    """{"models": {name: entry}, "runs": {run: facts}, "numbers": of the test interactions, "hard",
    "headline": some of them, "force": largest total force of each, mN, "fem_violation": largest
    change of volume of each in the FEM}.

    entry: the facts of a Competitor, what `judged` says, headline {test, hard}: relative L2 against
    the reference, and for some field: the file in the cache that holds the answer; a regression
    also has train and validation. facts of a run: kind, family, parent, frames and what `run_facts`
    says. Runs that are not trained yet are left out.
    """
    dataset = study_dataset(study)
    truth = references(study, dataset)
    test = load_samples(dataset, "test", None)
    models, runs = {}, {}
    for settings, parent in trained_runs(study).values():
        own = networks(settings, parent, dataset)
        del own[f"{settings.name}: {CALL}"]  # answers as KERAS does
        for name, competitor in own.items():
            models[name] = _network(study, settings, name, competitor, dataset, test, truth)
        facts = next(iter(own.values())).facts()
        del facts["form"]
        runs[settings.name] = facts | _facts(study, settings, dataset)
    for name, competitor in regressions(study, dataset).items():
        models[name] = _regression(study, name, competitor, dataset, test, truth)
    hard, chosen = hard_numbers(dataset), list(study.fem.interactions)
    for model in models.values():
        pairs = dict(model["reference"])
        model["headline"] = {
            "test": sums.relative_l2(pairs, chosen),
            "hard": sums.relative_l2(pairs, hard),
        }
    shape = -1, len(dataset.time)
    force = np.linalg.norm(test.force, axis=-1).sum(axis=(1, 2, 3), dtype=float)
    change = np.abs(test.volume / rest_volume(dataset) - 1)
    return {
        "models": models,
        "runs": runs,
        "numbers": dataset.number[dataset.split == "test"].tolist(),
        "hard": hard,
        "headline": chosen,
        "force": force.reshape(shape).max(axis=1).tolist(),
        "fem_violation": change.reshape(shape).max(axis=1).tolist(),
    }


def keras_answer(path: Path, samples: Samples, dataset: Dataset) -> np.ndarray:
    """Displacement (S, nx, ny, nz, 3) mm that the Keras model at `path` gives for Samples.

    In batches: frame by frame the 26 runs of the study would take an hour. A test shows that both
    are the same.
    """
    return predict(load_model(path), samples, dataset)[0]


def _network(study, settings, name, competitor, dataset, test, truth):
    """The entry of one form of a run, kept until its file, the dataset or the reference changes."""
    batched = competitor.form == KERAS
    path = settings.folder / "best.keras" if batched else files_there(settings)[competitor.form]
    made_from = _key(study, settings, truth, competitor.form, [dataset.path, path])
    entry = study.cache / "accuracy" / f"{made_from}.json"
    field = entry.with_suffix(".npz") if batched and settings.name in drawn_runs(study) else None
    if field and not field.is_file():
        entry.unlink(missing_ok=True)

    def judge():
        print(f"judging {name}", flush=True)
        if batched:
            seen = run_input(settings, dataset)
            samples = load_samples(dataset, "test", settings.model.window, seen)
            answer = keras_answer(path, samples, dataset)
        else:
            answer = _followed(competitor, dataset, "test")[0]
        if field:
            keep_field(field, dataset, answer)
        return judged(answer, dataset, test, truth, settings.loss.volume_threshold)

    found = competitor.facts() | once(entry, made_from, judge)
    return found | ({"field": str(field.relative_to(study.cache))} if field else {})


def _regression(study, name, competitor, dataset, test, truth):
    """The entry of a regression; its fit takes seconds, so that it is not kept."""
    print(f"judging {name}", flush=True)
    answer, _ = _followed(competitor, dataset, "test")
    splits = {
        split: relative_l2(*_followed(competitor, dataset, split))
        for split in ("train", "validation")
    }
    found = competitor.facts() | splits | judged(answer, dataset, test, truth)
    if name != drawn_regression(study):
        return found
    field = study.cache / "accuracy" / f"{key(name, [dataset.path], VERSION)}.npz"
    keep_field(field, dataset, answer)
    return found | {"field": str(field.relative_to(study.cache))}


def _followed(
    competitor: Competitor, dataset: Dataset, split: str
) -> tuple[np.ndarray, np.ndarray]:
    """(answer, truth), each (S, nx, ny, nz, 3) mm, frame by frame."""
    own = dataset.read(split, ("force", "displacement"))
    answer = answers(competitor.make(), own["force"])
    return answer, own["displacement"].reshape(answer.shape)


def _facts(study: Study, settings: Settings, dataset: Dataset) -> dict:
    own = [settings.folder / name for name in ("config.toml", "best.keras", "history.json")]
    made_from = key("facts", [dataset.path, *own], VERSION)
    path = study.cache / "accuracy" / f"{made_from}.json"
    return once(path, made_from, lambda: run_facts(settings, dataset))


def _key(study, settings, truth, form, files):
    settings = (study.fem.reference_safety, sorted(truth), settings.loss.volume_threshold, form)
    return key(settings, files, VERSION)
