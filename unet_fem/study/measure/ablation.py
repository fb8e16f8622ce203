"""What memory and elasticity in the input are worth: small networks of the paper on each input, and
beside them the answers that learn little or nothing."""

import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import keras
import numpy as np

from fem.data.dataset import Dataset
from fem.files import write_text
from fem.online.input_field import InputField
from unet_fem.networks.files import load_model
from unet_fem.networks.registry import Elastic, Linear, Model, Options, Pod, network
from unet_fem.study.measure.statistics import interval
from unet_fem.study.measure.sums import sums_of_squares
from unet_fem.training.fit import train_network
from unet_fem.training.inputs import input_field, keep_input, run_input
from unet_fem.training.judge import predict
from unet_fem.training.regressions import fit_regression
from unet_fem.training.run import ensure_dataset, model_file, prepare_folder
from unet_fem.training.samples import load_samples, training_samples
from unet_fem.training.settings import InputChoice, Settings, load_settings

NETWORKS = {  # kind: settings file, and what is laid over it
    "cnn_lstm": ("configs/paper.toml", ["model.units=128"]),
    "unet": ("configs/paper_unet.toml", ["model.filters=16", "train.learning_rate=1e-3"]),
}
COMMON = ["train.precision=mixed_bfloat16"]
INPUTS = (
    InputChoice("window", "force"),
    InputChoice("window", "elastic"),
    InputChoice("creep", "force"),
    InputChoice("creep", "elastic"),
)
BASELINES: tuple[Options, ...] = (Linear(), Pod(), Elastic())
SPLITS = ("validation", "usual", "hard")


def arm(kind: str, choice: InputChoice, seed: int, changes: Iterable[str] = ()) -> Settings:
    """The run of a network of `kind` on the input of `choice`, from `seed`."""
    path, own = NETWORKS[kind]
    settings = load_settings(path, [*own, *COMMON, *changes])
    name = f"ablation_{kind}_{choice.memory}_{choice.physics}_{seed}"
    return replace(settings, name=name, input=choice, train=replace(settings.train, seed=seed))


def ablation(
    seeds: Sequence[int], kinds: Sequence[str] = tuple(NETWORKS), changes: Iterable[str] = ()
) -> list[dict]:
    """Train what is missing, seed after seed, judge it, and return a row for each network of
    `kinds` and input, and for each baseline; without seeds for the baselines alone.

    changes: key=value laid over the settings of all networks. A run that was cut off goes on. A
    row: label, memory, physics, seeds, parameters, and of each of SPLITS an
    unet_fem.study.measure.statistics.interval with the error of each seed, or None. hard: all
    interactions beyond the training range, of the tests and of the split of their own; usual: the
    other tests.
    """
    found: dict[tuple[str, str, str], list[dict]] = {}
    dataset = ensure_dataset(arm("cnn_lstm", INPUTS[0], 1, changes))
    for seed, kind, choice in itertools.product(seeds, kinds, INPUTS):
        settings = arm(kind, choice, seed, changes)
        key = network(kind).label, choice.memory, choice.physics
        found.setdefault(key, []).append(judged(settings, dataset))
    for options, choice in itertools.product(BASELINES, INPUTS[::2]):
        field = input_field(choice, dataset)
        model = fit_regression(dataset, options, field=field)
        sums = errors(model, dataset, options.window, field) | {"parameters": model.parameters}
        found[network(options.kind).label, choice.memory, choice.physics] = [sums]
    return [_row(key, runs) for key, runs in found.items()]


def judged(settings: Settings, dataset: Dataset) -> dict:
    """The `errors` of the run of `settings`, which is trained first if it was not; kept in its
    folder."""
    path = settings.folder / "ablation.json"
    if path.is_file():
        return json.loads(path.read_text())
    field = run_input(settings, dataset)
    samples = training_samples(dataset, settings.model.window, field)
    prepare_folder(settings, dataset, resume=(settings.folder / "config.toml").is_file())
    keep_input(settings, dataset, field)
    keras.backend.clear_session()
    print(settings.name, flush=True)
    train_network(settings, dataset, *samples)
    model = load_model(model_file(settings))
    sums = errors(model, dataset, settings.model.window, field)
    sums["parameters"] = model.count_params()
    write_text(path, json.dumps(sums))
    return sums


def errors(model: Model, dataset: Dataset, window: int | None, field: InputField | None) -> dict:
    """{split: [[error, truth], ...]} in mm2 of each interaction, see sums_of_squares."""
    found: dict[str, list] = {name: [] for name in SPLITS}
    for split in ("validation", "test", "hard"):
        if split not in dataset.split:
            continue
        samples = load_samples(dataset, split, window, field)
        answer = predict(model, samples, dataset)[0]
        for number in np.unique(samples.interaction):
            rows = samples.interaction == number
            name = "validation" if split == "validation" else "usual"
            if split != "validation" and samples.hard[rows].all():
                name = "hard"
            found[name].append(sums_of_squares(answer[rows], samples.displacement[rows], dataset))
    return found


def _row(key, runs):
    label, memory, physics = key
    row = {"label": label, "memory": memory, "physics": physics, "seeds": len(runs)}
    row["parameters"] = runs[0]["parameters"]
    for split in SPLITS:
        pairs = np.array([run[split] for run in runs])  # (seeds, I, 2) mm2
        if not pairs.size:
            row[split] = None
            continue
        each = np.sqrt(pairs[..., 0].sum(axis=1) / pairs[..., 1].sum(axis=1))
        row[split] = interval(pairs[..., 0], pairs[0, :, 1]) | {"of_seeds": each.tolist()}
    return row


def table(rows: list[dict]) -> str:
    """The rows of `ablation` in Markdown."""

    def cell(found):
        if found is None:
            return "-"
        spread, ranges = found["of_seeds"], []
        if found["low"] is not None:
            ranges.append((found["low"], found["high"]))
        if len(spread) > 1:
            ranges.append((min(spread), max(spread)))
        told = "; ".join(f"{100 * low:.1f}-{100 * high:.1f}" for low, high in ranges)
        return f"{100 * found['relative_l2']:.1f}" + (f" ({told})" if told else "")

    lines = [
        "| answer | memory | input | parameters | seeds | validation % | usual % | hard % |",
        "|" + "---|" * 8,
    ]
    for row in rows:
        facts = [row["label"], row["memory"], row["physics"], f"{row['parameters']:,}"]
        cells = [cell(row[split]) for split in SPLITS]
        lines.append("| " + " | ".join([*facts, str(row["seeds"]), *cells]) + " |")
    return "\n".join(lines)


def write(rows: list[dict], out: Path, command: str) -> None:
    """The rows as <out>.json and, with what they are, as <out>.md."""
    head = (
        f"# Memory and elasticity in the input\n\n`{command}`\n\n"
        "Relative L2 error over free nodes and frames in %. In brackets the 95 % interval of"
        " drawing the interactions again, and the least and the largest error of the seeds.\n\n"
    )
    write_text(out.with_suffix(".md"), head + table(rows) + "\n")
    write_text(out.with_suffix(".json"), json.dumps(rows, indent=1) + "\n")
