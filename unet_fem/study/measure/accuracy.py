"""Errors of every competitor that is not the FEM itself, on every test interaction, so that any
subset can be judged later.

A competitor has an entry for each form that it is deployed in. Keras' answers stand under
"tf.function", the form that is timed.
"""

import json

import numpy as np

from fem.errors import InputError
from fem.files import save_arrays
from unet_fem.networks import pod
from unet_fem.study import runs as pipeline
from unet_fem.study.measure.reference import references, relative_l2, study_dataset, sums_of_squares
from unet_fem.study.regressions import competitors, linear_name
from unet_fem.training import settings as config
from unet_fem.training.figures import by_depth
from unet_fem.training.judge import predict, rest_volume
from unet_fem.training.samples import load_samples

FAMILIES = {"cnn_lstm": "CNN-LSTM", "unet": "U-Net"}
KERAS = "tf.function"
GATE = 0.07  # the paper's volume band, for models that were trained without


def run(study):
    """{"models": {name: entry}, "runs": {run: facts}, "numbers": of the test interactions, "hard",
    "headline": some of them, "force": largest total force of each, mN, "fem_violation": largest
    change of volume of each in the FEM}.

    entry: family, run (None for regressions), form, frames of the window, what `judged` says, and
    headline {test, hard}: relative L2 against the reference. facts: family, frames and what
    `run_facts` says. Runs that are not trained yet are left out.
    """
    dataset = study_dataset(study)
    truth = references(study, dataset)
    test = load_samples(dataset, "test", None)
    shape = -1, len(dataset.time)
    models, runs = {}, {}
    for settings in trained_runs(study):
        about = {
            "family": FAMILIES[settings.model.kind],
            "run": settings.name,
            "frames": settings.model.window or 1,
        }
        models |= _network(study, settings, dataset, truth, about)
        keras = settings.folder / "best.keras"
        runs[settings.name] = about | _once(
            study,
            f"{settings.name}-facts",
            dataset,
            keras,
            {},
            lambda: run_facts(settings, dataset),
        )  # noqa: B023
    for name, (frames, model) in competitors(study, dataset).items():
        print(f"judging {name}", flush=True)
        answer = pod.predict(model, load_samples(dataset, "test", frames).force)
        if name == regression_name(study):
            keep_field(study, name, dataset, answer)
        learned = {split: load_samples(dataset, split, frames) for split in ("train", "validation")}
        splits = {
            split: _relative(pod.predict(model, samples.force), samples.displacement)
            for split, samples in learned.items()
        }
        about = {
            "family": model.family,
            "run": None,
            "form": "float32",
            "frames": frames,
            "parameters": model.parameters,
        }
        models[name] = about | splits | judged(answer, dataset, test, truth)
    hard, chosen = dataset.number[dataset.hard].tolist(), list(study.fem.interactions)
    for model in models.values():
        sums = dict(model.pop("reference"))
        model["headline"] = {"test": relative_l2(sums, chosen), "hard": relative_l2(sums, hard)}
        model["reference"] = [[number, pair] for number, pair in sums.items()]
    return {
        "models": models,
        "runs": runs,
        "numbers": dataset.number[dataset.split == "test"].tolist(),
        "hard": hard,
        "headline": chosen,
        "force": np.linalg.norm(test.force, axis=-1)
        .sum(axis=(1, 2, 3), dtype=float)
        .reshape(shape)
        .max(axis=1)
        .tolist(),
        "fem_violation": np.abs(test.volume / rest_volume(dataset) - 1)
        .reshape(shape)
        .max(axis=1)
        .tolist(),
    }


def trained_runs(study):
    """Settings of the study's networks that are trained to the end, and of what pruning made of the
    main two."""
    names = {network.name: "metrics.json" for network in study.networks}
    names |= {
        name: "pruned"
        for main in (study.cnn_lstm, study.unet)
        for name in pipeline.pruned_runs(study, main).values()
    }
    folders = {study.folder.parent / name: done for name, done in names.items()}
    found = [
        config.load_settings(folder / "config.toml")
        for folder, done in folders.items()
        if (folder / done).is_file()
    ]
    data = study.network(study.cnn_lstm).data
    for settings in found:
        if settings.data != data:
            raise InputError(
                f"run '{settings.name}' is of {settings.data}, '{study.cnn_lstm}' of {data}; give all networks of a study the same data"
            )
    return found


def _network(study, settings, dataset, truth, about):
    """{"<run>: <form>": entry} for Keras and for each .tflite of a run."""
    found = {}
    forms = {KERAS: settings.folder / "best.keras"} | {
        path.stem: path for path in sorted((settings.folder / "lite").glob("*.tflite"))
    }
    for form, path in forms.items():
        keep = form == KERAS and settings.name in drawn_runs(study)

        def judge(form=form, path=path, keep=keep):
            print(f"judging {settings.name}: {form}", flush=True)
            test = load_samples(dataset, "test", settings.model.window)
            answer = (
                keras_answer(path, test, dataset) if form == KERAS else lite_answer(path, dataset)
            )
            if keep:
                keep_field(study, settings.name, dataset, answer)
            return judged(answer, dataset, test, truth, settings.loss.volume_threshold)

        if keep and not _field_path(study, settings.name).is_file():
            _json_path(study, f"{settings.name}-{form}").unlink(missing_ok=True)
        found[f"{settings.name}: {form}"] = (
            about
            | {"form": form}
            | _once(study, f"{settings.name}-{form}", dataset, path, truth, judge)
        )
    return found


def keras_answer(path, samples, dataset):
    """Displacement (S, nx, ny, nz, 3) mm that the Keras model at `path` gives for Samples."""
    from unet_fem.training.checkpoint import load_model

    return predict(load_model(path), samples, dataset)[0]


def lite_answer(path, dataset):
    """The same for the surrogate at `path` on the test split, called frame by frame from rest as at
    run time."""
    from unet_fem.deployment.answers import answers

    return answers(path, dataset.read("test")["force"])


def judged(answer, dataset, samples, truth, gate=GATE):
    """What is known of `answer` (S, nx, ny, nz, 3) mm on the Samples of the test split.

    test, hard: relative L2 against the dataset, from sums [[error, truth], ...] in mm2 over free
    nodes and frames of each interaction;
    reference: [[number, [error, truth]], ...] against `truth` {number: (frames, nx, ny, nz, 3) mm};
    depth: see unet_fem.training.figures.by_depth;
    violation: largest relative change of volume of each interaction; violation_mean over all
    frames; gate, and gate_open: share of frames with more than that. Raises InputError where the
    answer is not finite.
    """
    from unet_fem.training.losses import deformed_volume

    if not np.isfinite(answer).all():
        raise InputError(
            "an answer to the test interactions is not finite; its training has diverged: delete the run and lower train.learning_rate"
        )
    frames = len(dataset.time)
    by_interaction = answer.reshape(-1, frames, *answer.shape[1:])
    pairs = zip(by_interaction, samples.displacement.reshape(by_interaction.shape))
    sums = [sums_of_squares(*pair, dataset) for pair in pairs]
    row = {number: n for n, number in enumerate(dataset.number[dataset.split == "test"].tolist())}
    # in batches: the faces of a few hundred fields fill the memory
    volume = np.concatenate(
        [
            np.asarray(deformed_volume(answer[i : i + 64], *dataset.surface), float)
            for i in range(0, len(answer), 64)
        ]
    )
    violation = np.abs(volume / rest_volume(dataset) - 1)
    sums_hard = np.array(sums)[samples.hard[::frames]]
    return {
        "test": _root(np.array(sums)),
        "hard": _root(sums_hard),
        "sums": sums,
        "reference": [
            [number, sums_of_squares(by_interaction[row[number]], field, dataset)]
            for number, field in truth.items()
        ],
        "depth": by_depth(dataset, answer, samples.displacement),
        "violation": violation.reshape(-1, frames).max(axis=1).tolist(),
        "violation_mean": float(violation.mean()),
        "gate": gate,
        "gate_open": float(np.mean(violation > gate)),
    }


def run_facts(settings, dataset):
    """parameters; train and validation: relative L2; epochs, best_epoch, seconds (None where the
    history does not tell), seed;
    threshold of the volume loss, and train_gate_open, validation_gate_open: mean over the epochs of
    the share of samples beyond it."""
    from unet_fem.training.checkpoint import load_model

    model = load_model(settings.folder / "best.keras")
    facts = {
        "parameters": model.count_params(),
        "seed": settings.train.seed,
        "threshold": settings.loss.volume_threshold,
    }
    for split in ("train", "validation"):
        samples = load_samples(dataset, split, settings.model.window)
        facts[split] = _relative(predict(model, samples, dataset)[0], samples.displacement)
    written = settings.folder / "history.json"
    history = (
        json.loads(written.read_text()) if written.is_file() else {}
    )  # magnitude pruning leaves none
    epochs, seconds = history.get("val_relative_error", []), history.get("seconds", [])
    return facts | {
        "epochs": len(epochs) or None,
        "best_epoch": int(np.argmin(epochs)) + 1 if epochs else None,
        "seconds": float(sum(seconds)) if seconds and len(seconds) == len(epochs) else None,
        "train_gate_open": float(np.mean(history["gate_open"])) if epochs else None,
        "validation_gate_open": float(np.mean(history["val_gate_open"])) if epochs else None,
    }


def drawn_runs(study):
    """Runs whose answers to the test interactions are kept for the figures of fields: the main two,
    and the first of every arm."""
    return {study.cnn_lstm, study.unet, *(arm.runs[0] for arm in study.physics)}


def regression_name(study):
    """The linear regression in those figures: the one that sees what the CNN-LSTM sees."""
    return linear_name(study.network(study.cnn_lstm).model.window)


def keep_field(study, name, dataset, answer):
    save_arrays(
        _field_path(study, name), field=answer[:, dataset.free].astype("float16")
    )  # rounded by 0.05 % at most


def kept_field(study, name, dataset):
    """(S, nx, ny, nz, 3) float32 mm: the answer of a run of `drawn_runs` or of `regression_name` to
    the test split."""
    path = _field_path(study, name)
    if not path.is_file():
        raise InputError(f"no {path}; give python tools/report.py --again accuracy")
    with np.load(path) as file:
        values = file["field"]
    field = np.zeros((len(values), *dataset.grid, 3), "float32")
    field[:, dataset.free] = values
    return field


def _field_path(study, name):
    return study.folder / "accuracy" / f"{name}.npz"


def _json_path(study, name):
    return study.folder / "accuracy" / f"{name}.json"


def _once(study, name, dataset, source, truth, make):
    """The dict that `make()` gives, kept until the file `source`, the dataset or the reference
    changes."""
    from fem.files import write_text

    path = _json_path(study, name)
    state = source.stat()
    stamp = [
        state.st_size,
        state.st_mtime_ns,
        dataset.scene.digest(),
        study.fem.reference_safety,
        sorted(truth),
    ]
    if path.is_file():
        kept = json.loads(path.read_text())
        if kept["stamp"] == stamp:
            return kept["result"]
    path.parent.mkdir(parents=True, exist_ok=True)
    result = make()
    write_text(path, json.dumps({"stamp": stamp, "result": result}, allow_nan=False))
    return result


def _relative(answer, truth):
    return float(
        np.sqrt(
            np.sum(np.square(answer - truth), dtype=float) / np.sum(np.square(truth), dtype=float)
        )
    )


def _root(sums):
    return float(np.sqrt(sums[:, 0].sum() / sums[:, 1].sum()))
