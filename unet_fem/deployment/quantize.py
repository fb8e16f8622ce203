"""Export a trained run in four variants and measure what each costs."""

import json
import logging
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.files import write_text
from unet_fem.deployment.answers import answers
from unet_fem.deployment.exported import lite_file, model_file
from unet_fem.deployment.layer_errors import layer_errors
from unet_fem.deployment.tflite import VARIANTS, calibration_windows, export, surrogate_facts
from unet_fem.deployment.tflite_graph import audit
from unet_fem.metrics import relative_l2
from unet_fem.networks.files import load_model
from unet_fem.runtime.surrogate_file import write_surrogate
from unet_fem.training.inputs import run_input
from unet_fem.training.samples import load_samples
from unet_fem.training.settings import Settings


def quantize(
    settings: Settings, dataset: Dataset, count: int = 64, margin: float = 1.5, layers: bool = False
) -> Path:
    """Write the four surrogates of a run and quantization.json, and print what each costs. Returns
    the surrogates' folder.

    count: training windows that calibrate int8; margin: how far beyond the strongest it reaches;
    layers: also what each layer's output loses. Raises InputError for a model that is not of these
    settings and this dataset.
    """
    logging.getLogger("absl").setLevel(
        logging.ERROR
    )  # the converter's remarks on how it was called
    steps = settings.model.window
    model = load_model(model_file(settings))
    if model.input_shape[1:] != (*(steps,) * bool(steps), *dataset.grid, 3):
        raise InputError(
            f"{settings.folder}: the model takes {model.input_shape[1:]}, its settings or dataset"
            " say otherwise; train again"
        )
    test = dataset.read("test")
    force, hard = test["force"], np.repeat(test["hard"], test["force"].shape[1])
    truth = test["displacement"].reshape(-1, *force.shape[2:])
    field = run_input(settings, dataset)
    train = load_samples(dataset, "train", steps, field)
    shown = calibration_windows(train.input, count, margin)
    seen = load_samples(dataset, "test", steps, field).input
    keras = model.predict(seen, batch_size=16, verbose=0)
    about = surrogate_facts(dataset, field)
    figures: dict[str, dict] = {"keras": _against_fem(keras, truth, hard)}
    print("variant        MB  against Keras: L2 %  worst %  against FEM: L2 %  hard %", flush=True)
    print(_row("keras", figures["keras"]), flush=True)
    files = {}
    for variant in VARIANTS:
        files[variant] = data = export(model, variant, shown)
        path = lite_file(settings, variant)
        write_surrogate(path, data, **about, label=f"{settings.name}: {variant}")
        said = answers(path, force)
        figures[variant] = {
            "bytes": path.stat().st_size,
            "keras_relative_l2": relative_l2(said, keras),
            "keras_worst": float(
                np.abs(said - keras).max() / np.abs(keras).max()
            ),  # of the largest displacement
            **_against_fem(said, truth, hard),
            "operators": dict(audit(data, variant)),
        }
        print(_row(variant, figures[variant]), flush=True)
    for variant in VARIANTS:
        operators = sorted(figures[variant]["operators"].items())
        print(f"{variant}: " + ", ".join(f"{count} {name}" for name, count in operators))
    if layers:
        _add_layers(figures, files, seen)
    write_text(settings.folder / "quantization.json", json.dumps(figures, indent=1))
    return path.parent


def _add_layers(figures, files, seen):
    """Measure the loss by layer on some of the windows seen, and print it."""
    seen = seen[:: max(1, len(seen) // 32)]
    for variant in ("dynamic", "int8"):
        figures[variant]["layers"] = layer_errors(files["float32"], files[variant], seen)
        print(f"\n{variant}: relative L2 error of each layer's output, %")
        for name, error in figures[variant]["layers"].items():
            print(f"  {100 * error:7.3f}  {name}")


def _against_fem(answer, truth, hard):
    return {
        "fem_relative_l2": relative_l2(answer, truth),
        "hard_relative_l2": relative_l2(answer[hard], truth[hard]),
    }


def _row(name, figures):
    def percent(key, width, digits):
        return f"{100 * figures[key]:{width}.{digits}f}" if key in figures else "-".rjust(width)

    size = f"{figures['bytes'] / 1e6:6.2f}" if "bytes" in figures else "     -"
    return (
        f"{name:<10}{size}  {percent('keras_relative_l2', 19, 4)}  {percent('keras_worst', 7, 4)}"
        f"  {percent('fem_relative_l2', 17, 2)}  {percent('hard_relative_l2', 6, 2)}"
    )
