"""Runs made smaller by zeros or by whole filters, fine-tuned, and measured against their parent."""

import dataclasses
import zipfile
from pathlib import Path

import keras
import numpy as np

from fem.cache import digest
from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.files import write_text
from fem.locks import lock
from fem.measure.timing import paired_ratio
from unet_fem.deployment.exported import lite_file, model_file
from unet_fem.deployment.latency import time_steppers
from unet_fem.deployment.tflite import calibration_windows, export, surrogate_facts
from unet_fem.deployment.thinning import smaller_size, thin
from unet_fem.networks.files import load_model, save_model
from unet_fem.networks.registry import network
from unet_fem.runtime.surrogate import Surrogate
from unet_fem.runtime.surrogate_file import write_surrogate
from unet_fem.training.fit import build_loss, compile_model, fit, targets
from unet_fem.training.inputs import keep_input, run_input
from unet_fem.training.judge import error_metrics, predict
from unet_fem.training.precision import precision
from unet_fem.training.run import prepare_folder
from unet_fem.training.samples import load_samples
from unet_fem.training.settings import Settings

VARIANTS = ("float32", "int8")


def smaller_run(
    settings: Settings,
    dataset: Dataset,
    share: float,
    by_filters: bool,
    epochs: int,
    learning_rate: float,
) -> Settings:
    """Prune and fine-tune into a run folder of its own, unless that is done already. Returns its
    settings.

    share: of the parameters that go, 0-1. by_filters: whole filters or units, in place of single
    weights of the convolutions. Raises InputError where that run was made of an older model.
    """
    parent = model_file(settings)
    model = load_model(parent)
    small = _smaller_settings(settings, model, share, by_filters, epochs, learning_rate)
    with lock(small.folder):
        prepare_folder(small, dataset, resume=(small.folder / "config.toml").is_file())
        keep_input(small, dataset, run_input(settings, dataset))
        done, origin = small.folder / "pruned", digest([], [parent])
        if done.is_file():
            if done.read_text() not in ("", origin):  # empty in runs made before 0.2
                raise InputError(
                    f"{small.folder} is of an older {settings.folder}; delete it to make it again"
                )
            print(f"{small.folder} is done already; delete it to make it again")
            return small
        print(f"making {small.folder}: {epochs} epochs of fine-tuning", flush=True)
        keras.utils.set_random_seed(small.train.seed)
        if by_filters:
            _thin_and_tune(model, small, dataset)
        else:
            _prune_and_tune(model, small, dataset, share)
        write_text(done, origin)
    return small


def _smaller_settings(settings, model, share, by_filters, epochs, learning_rate):
    choice = settings.model
    if by_filters:
        size = {network(choice.kind).size: smaller_size(model, choice, share)}
        choice = dataclasses.replace(choice, **size)
    tuning = dataclasses.replace(
        settings.train, epochs=epochs, learning_rate=learning_rate, schedule="cosine"
    )
    name = f"{settings.name}_{'thin' if by_filters else 'pruned'}{100 * share:.0f}"
    return dataclasses.replace(settings, name=name, model=choice, train=tuning)


def _thin_and_tune(model, small, dataset):
    train, validation = (_samples(small, dataset, split) for split in ("train", "validation"))
    with precision(small.train.precision):
        slim = thin(model, small.model)
        compile_model(slim, small, dataset, -(-len(train) // small.train.batch_size))
        fit(slim, small, train, validation)


def _prune_and_tune(model, small, dataset, share):
    from unet_fem.deployment.pruning import magnitude_prune  # brings a second Keras

    train, tuning = _samples(small, dataset, "train"), small.train
    magnitude_prune(
        model,
        small.model,
        share,
        train.input,
        targets(train, small),
        build_loss(small, dataset),
        epochs=tuning.epochs,
        batch_size=tuning.batch_size,
        learning_rate=tuning.learning_rate,
        precision=tuning.precision,
    )
    save_model(model, small.folder / "best.keras")


def measure(settings: Settings, dataset: Dataset) -> dict[str, float]:
    """Errors and sizes of one run; its surrogates are written beside."""
    model = load_model(model_file(settings))
    test = _samples(settings, dataset, "test")
    prediction, volume = predict(model, test, dataset)
    hard = test.hard
    judged = {
        "test_relative_l2": error_metrics(prediction, test, dataset, volume),
        "hard_relative_l2": error_metrics(
            prediction[hard], test.select(hard), dataset, volume[hard]
        ),
    }
    weights = [
        layer.get_weights()[0] for layer in model.layers if isinstance(layer, keras.layers.Conv3D)
    ]  # what pruning works on
    figures = {
        "parameters": model.count_params(),
        "zeros": sum(int((w == 0).sum()) for w in weights) / sum(w.size for w in weights),
    } | {name: metrics["relative_l2"] for name, metrics in judged.items()}
    shown = calibration_windows(_samples(settings, dataset, "train").input)
    about = surrogate_facts(dataset, run_input(settings, dataset))
    for variant in VARIANTS:
        path, label = lite_file(settings, variant), f"{settings.name}: {variant}"
        write_surrogate(path, export(model, variant, shown), **about, label=label)
        figures[f"{variant}_MB"] = path.stat().st_size / 1e6
        figures[f"{variant}_zipped_MB"] = zipped_size(path) / 1e6
    return figures


def _samples(settings, dataset, split):
    """What the network of a run learns from and is judged on."""
    field = run_input(settings, dataset)
    return load_samples(dataset, split, settings.model.window, field)


def zipped_size(path: Path) -> int:
    """Bytes of the file as a zip archive."""
    archive = path.with_suffix(".zip")
    try:
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
            file.write(path, path.name)
        return archive.stat().st_size
    finally:
        archive.unlink(missing_ok=True)


def compare(runs: list[Settings], dataset: Dataset, rounds: int) -> dict[str, dict[str, float]]:
    """Figures of all runs with paired latencies, one thread, {name: figures}; the first run is the
    one to beat."""
    figures = {settings.name: measure(settings, dataset) for settings in runs}
    steppers = {
        (settings.name, variant): Surrogate(lite_file(settings, variant))
        for settings in runs
        for variant in VARIANTS
    }
    force = dataset.read("train")["force"][0, -1:]
    times = time_steppers(steppers, dict.fromkeys(steppers, force), rounds)
    for (name, variant), values in times.items():
        figures[name][f"{variant}_ms"] = 1e3 * float(np.median(values))
        figures[name][f"{variant}_speed-up"] = paired_ratio(times[runs[0].name, variant], values)
    return figures


def table(figures: dict[str, dict[str, float]]) -> str:
    """The figures of `compare` in Markdown."""
    lines = [
        "| run | parameters | zeros % | test L2 % | hard L2 % | float32 MB | zipped | int8 MB"
        " | float32 ms | faster | int8 ms | faster |",
        "|" + "---|" * 12,
    ]
    for name, f in figures.items():
        lines.append(
            f"| {name} | {f['parameters']:,} | {100 * f['zeros']:.0f}"
            f" | {100 * f['test_relative_l2']:.1f} | {100 * f['hard_relative_l2']:.1f}"
            f" | {f['float32_MB']:.2f} | {f['float32_zipped_MB']:.2f} | {f['int8_MB']:.2f}"
            f" | {f['float32_ms']:.2f} | {f['float32_speed-up']:.2f}x"
            f" | {f['int8_ms']:.2f} | {f['int8_speed-up']:.2f}x |"
        )
    return "\n".join(lines)
