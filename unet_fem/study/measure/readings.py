"""Which reading of the data gives the paper's order? Linear regression on one and two forces, U-Net
and CNN-LSTM under each reading of the paper's samples (see unet_fem.training.readings), judged on
the reading's own validation frames and on the usual interactions of the split "test", which leak
under none."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace

import keras

from fem.data.dataset import Dataset
from fem.files import write_text
from unet_fem.metrics import relative_l2
from unet_fem.networks.files import load_model
from unet_fem.networks.registry import Linear, Model, network
from unet_fem.study.measure.statistics import errors
from unet_fem.study.measure.sums import sums_of_squares
from unet_fem.training.fit import train_network
from unet_fem.training.judge import predict
from unet_fem.training.readings import leaking, read_as, rows_of
from unet_fem.training.run import ensure_dataset, model_file, prepare_folder
from unet_fem.training.samples import Samples, load_samples, training_samples
from unet_fem.training.settings import SampleChoice, Settings, load_settings

READINGS = {"A": SampleChoice(), "B": SampleChoice("frames"), "C": SampleChoice(each=3)}
NETWORKS = {"configs/paper_unet.toml": "model.filters=32", "configs/paper.toml": "model.units=256"}
LINEAR = (Linear(steps=1), Linear(steps=2))


def run(
    names: Sequence[str],
    changes: Iterable[str] = (),
    many: tuple[str, str] | None = None,
    half: bool = False,
) -> list[dict]:
    """[{"reading", "leaking", "samples", "interactions", "model", "validation", "usual", "seed"}]
    for each of the READINGS `names`: a row a model.

    changes: key=value laid over the settings of both networks; many: (scene, data) that reading C
    takes its more interactions from; half: both networks at half of their width. What is trained is
    kept, and one that was cut off goes on.
    leaking: share of the validation frames that have a neighbour among those learned from; usual:
    an error of statistics.errors.
    """
    rows = []
    for name in names:
        trained = [
            _settings(path, [*changes, *[width] * half], name, many)
            for path, width in NETWORKS.items()
        ]
        fitted = [trained[0].with_model(options) for options in LINEAR]
        for settings in (*fitted, *trained):
            dataset = ensure_dataset(settings)
            samples = _samples(settings, dataset)
            test = _usual(load_settings(next(iter(NETWORKS)), changes), settings.model.window)
            label, model = _model(settings, dataset, samples)
            rows.append(_row(name, settings, dataset, samples, (label, model), test))
    return rows


def _model(settings, dataset, samples):
    """(label, model) of `settings`, fitted or trained."""
    row, options = network(settings.model.kind), settings.model
    if not row.fitted:
        return row.label, _trained(settings, dataset, samples)
    label = f"linear, {options.steps} frame{'s' * (options.steps > 1)}"
    return label, row.fit(*samples, dataset.free, options)


def _settings(path, changes, name, many):
    settings = load_settings(path, changes)
    if name == "C" and many:
        settings = replace(settings, scene=many[0], data=many[1])
    run_name = f"reading_{name}_{settings.name}_{settings.train.seed}"
    return replace(settings, name=run_name, samples=READINGS[name])


def _samples(settings: Settings, dataset: Dataset) -> tuple[Samples, Samples]:
    own = training_samples(dataset, settings.model.window)
    return read_as(*own, len(dataset.time), settings.samples)


def _usual(settings: Settings, window: int | None) -> tuple[Dataset, Samples]:
    """The usual interactions of the split "test" of the dataset of `settings`."""
    dataset = ensure_dataset(settings)
    test = load_samples(dataset, "test", window)
    return dataset, test.select(~test.hard)


def _trained(settings: Settings, dataset: Dataset, samples: tuple[Samples, Samples]) -> Model:
    done = settings.folder / "reading.json"
    if not done.is_file():
        keras.backend.clear_session()
        prepare_folder(settings, dataset, resume=(settings.folder / "config.toml").is_file())
        print(settings.name, flush=True)
        train_network(settings, dataset, *samples)
        write_text(done, json.dumps({"samples": len(samples[0])}))
    return load_model(model_file(settings))


def _row(name, settings, dataset, samples, labelled, test):
    label, model = labelled
    train, validation = samples
    frames = len(dataset.time)
    sizes = tuple(int((dataset.split == split).sum()) * frames for split in ("train", "validation"))
    judged, own = test
    answer = predict(model, own, judged)[0]
    sums = {}
    for number in sorted(set(own.interaction.tolist())):
        rows = own.interaction == number
        sums[f"test {number}"] = sums_of_squares(answer[rows], own.displacement[rows], judged)
    return {
        "reading": name,
        "leaking": leaking(*rows_of(sizes, frames, settings.samples), frames),
        "samples": len(train),
        "interactions": len(set(train.interaction.tolist())),
        "model": label,
        "validation": relative_l2(predict(model, validation, dataset)[0], validation.displacement),
        "usual": errors(sums, {"usual": list(sums)})["usual"],
        "seed": settings.train.seed,
    }


def table(rows: list[dict]) -> str:
    """The rows of `run` in Markdown."""
    lines = [
        "| reading | samples | interactions | frames with a neighbour in training % | model |"
        " own validation % | usual tests % |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        usual = row["usual"]
        test = f"{100 * usual['relative_l2']:.1f}"
        if usual["low"] is not None:
            test += f" ({100 * usual['low']:.1f} to {100 * usual['high']:.1f})"
        cells = [row["reading"], row["samples"], row["interactions"]]
        cells += [f"{100 * row['leaking']:.0f}", row["model"], f"{100 * row['validation']:.1f}"]
        lines.append("| " + " | ".join(map(str, [*cells, test])) + " |")
    return "\n".join(lines)
