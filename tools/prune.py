"""Make a trained network smaller, by zeros or by whole filters, fine-tune it, and measure what that
gives.

    python tools/prune.py runs/<name> [--filters] [--sparsity 0.5 0.8] [--epochs 10]

Without --filters: magnitude pruning of the convolutions (TensorFlow Model Optimization), the
paper's study. With it: the least filters (U-Net) or units (CNN-LSTM) are removed. Each result is a
run of its own, runs/<name>_pruned50 or runs/<name>_thin50, for every other tool to work on. Its
figures go to pruning.json there.
"""

import argparse
import dataclasses
import json
import math
import os
import zipfile
from pathlib import Path

import numpy as np

from fem.commands import command_line
from fem.errors import InputError
from fem.measure.timing import alternate, paired_ratio

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def thinner(model, settings, sparsity):
    """The model settings with about a share `sparsity` of the parameters of `model` gone."""
    choice = settings.model
    if choice.kind == "unet":  # convolutions inside hold filters^2 weights
        return dataclasses.replace(
            choice, filters=max(1, round(choice.filters * math.sqrt(1 - sparsity)))
        )
    lstm = model.get_layer("bilstm").forward_layer
    features = lstm.cell.kernel.shape[0] + 1  # and a bias: the LSTM has 8 N (features + N) weights
    goal = (1 - sparsity) * choice.units * (choice.units + features)
    units = (math.sqrt(features**2 + 4 * goal) - features) / 2
    cells = math.prod(model.get_layer("block").target_shape[:-1])
    multiple = cells // math.gcd(2, cells)  # both directions' units fill the block's cells
    return dataclasses.replace(choice, units=max(multiple, round(units / multiple) * multiple))


def smaller_run(settings, dataset, sparsity, by_filters, epochs, learning_rate):
    """Prune and fine-tune into a run folder of its own, unless that is done already. Returns its
    settings."""
    import keras

    from unet_fem.deployment import pruning as prune
    from unet_fem.training import samples as data
    from unet_fem.training.checkpoint import load_model, save_model
    from unet_fem.training.fit import build_loss, compile_model, fit, targets
    from unet_fem.training.run import prepare_folder

    model = load_model(settings.folder / "best.keras")
    choice = thinner(model, settings, sparsity) if by_filters else settings.model
    name = f"{settings.name}_{'thin' if by_filters else 'pruned'}{100 * sparsity:.0f}"
    tuning = dataclasses.replace(
        settings.train, epochs=epochs, learning_rate=learning_rate, schedule="cosine"
    )
    small = dataclasses.replace(settings, name=name, model=choice, train=tuning)
    prepare_folder(small, resume=(small.folder / "config.toml").is_file())
    done = small.folder / "pruned"
    if done.is_file():
        if done.stat().st_mtime < (settings.folder / "best.keras").stat().st_mtime:
            raise InputError(
                f"{small.folder} is of an older {settings.folder}; delete it to make it again"
            )
        print(f"{small.folder} is done already; delete it to make it again")
        return small
    samples = {
        split: data.load_samples(dataset, split, settings.model.window)
        for split in ("train", "validation")
    }
    print(f"making {small.folder}: {epochs} epochs of fine-tuning", flush=True)
    keras.utils.set_random_seed(tuning.seed)
    if by_filters:
        keras.mixed_precision.set_global_policy(tuning.precision)
        thin = prune.thin(model, choice.filters if choice.kind == "unet" else choice.units)
        compile_model(thin, small, dataset, -(-len(samples["train"]) // tuning.batch_size))
        fit(thin, small, samples["train"], samples["validation"])
        keras.mixed_precision.set_global_policy("float32")
    else:
        targets = targets(samples["train"], settings)
        prune.magnitude_prune(
            model,
            sparsity,
            samples["train"].force,
            targets,
            build_loss(settings, dataset),
            epochs=epochs,
            batch_size=tuning.batch_size,
            learning_rate=learning_rate,
            precision=tuning.precision,
        )
        save_model(model, small.folder / "best.keras")
    done.touch()
    return small


def measure(settings, dataset):
    """Errors and sizes of one run, and its surrogates: (figures, {variant: path})."""
    import keras

    from unet_fem.deployment import tflite as lite
    from unet_fem.runtime.surrogate_file import write_surrogate
    from unet_fem.training import samples as data
    from unet_fem.training.checkpoint import load_model
    from unet_fem.training.judge import error_metrics, predict

    model = load_model(settings.folder / "best.keras")
    test = data.load_samples(dataset, "test", settings.model.window)
    prediction, volume = predict(model, test, dataset)
    every = error_metrics(prediction, test, dataset, volume)["relative_l2"]
    hard = error_metrics(prediction[test.hard], test.select(test.hard), dataset, volume[test.hard])[
        "relative_l2"
    ]
    weights = [
        layer.get_weights()[0] for layer in model.layers if isinstance(layer, keras.layers.Conv3D)
    ]  # what pruning works on
    shown = lite.calibration_windows(
        data.load_samples(dataset, "train", settings.model.window).force
    )
    about = lite.surrogate_facts(dataset)
    folder = settings.folder / "lite"
    folder.mkdir(exist_ok=True)
    figures = {
        "parameters": model.count_params(),
        "zeros": sum(int((w == 0).sum()) for w in weights) / sum(w.size for w in weights),
        "test_relative_l2": every,
        "hard_relative_l2": hard,
    }
    files = {variant: folder / f"{variant}.tflite" for variant in ("float32", "int8")}
    for variant, path in files.items():
        write_surrogate(path, lite.export(model, variant, shown), **about)
        figures[f"{variant}_MB"] = path.stat().st_size / 1e6
        figures[f"{variant}_zipped_MB"] = zipped_size(path) / 1e6
    return figures, files


def zipped_size(path):
    archive = path.with_suffix(".zip")
    try:
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
            file.write(path, path.name)
        return archive.stat().st_size
    finally:
        archive.unlink(missing_ok=True)


def compare(runs, dataset, rounds):
    """Figures of all runs with paired latencies, one thread, {name: figures}; the first run is the
    one to beat."""
    from unet_fem.deployment.latency import surrogate_action

    figures, actions = {}, {}
    force = dataset.read("train")["force"][0, -1]
    for settings in runs:
        figures[settings.name], files = measure(settings, dataset)
        for variant, path in files.items():
            actions[settings.name, variant] = surrogate_action(path, force)
    times = alternate(actions, rounds, warm_up=20)
    for (name, variant), values in times.items():
        figures[name][f"{variant}_ms"] = 1e3 * float(np.median(values))
        figures[name][f"{variant}_speed-up"] = paired_ratio(times[runs[0].name, variant], values)
    return figures


def table(figures):
    lines = [
        "| run | parameters | zeros % | test L2 % | hard L2 % | float32 MB | zipped | int8 MB | float32 ms | faster | int8 ms | faster |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, f in figures.items():
        lines.append(
            f"| {name} | {f['parameters']:,} | {100 * f['zeros']:.0f} | {100 * f['test_relative_l2']:.1f} | {100 * f['hard_relative_l2']:.1f} "
            f"| {f['float32_MB']:.2f} | {f['float32_zipped_MB']:.2f} | {f['int8_MB']:.2f} "
            f"| {f['float32_ms']:.2f} | {f['float32_speed-up']:.2f}x | {f['int8_ms']:.2f} | {f['int8_speed-up']:.2f}x |"
        )
    return "\n".join(lines)


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/prune.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("run", type=Path, help="folder of a training run, such as runs/quick")
    parser.add_argument(
        "--filters",
        action="store_true",
        help="remove whole filters or units instead of single weights",
    )
    parser.add_argument(
        "--sparsity",
        type=float,
        nargs="+",
        default=[0.5, 0.8],
        help="shares to remove (default: 0.5 0.8)",
    )
    parser.add_argument("--epochs", type=int, default=10, help="of fine-tuning (default: 10)")
    parser.add_argument(
        "--learning-rate",
        type=float,
        default=3e-4,
        help="of fine-tuning, falling to zero (default: 3e-4)",
    )
    parser.add_argument(
        "--rounds", type=int, default=200, help="paired timings of each (default: 200)"
    )
    options = parser.parse_args(arguments)
    if not all(0 < s < 1 for s in options.sparsity) or options.epochs < 1 or options.rounds < 1:
        raise InputError(
            f"--sparsity {options.sparsity} must lie between 0 and 1, --epochs and --rounds be at least 1"
        )
    from fem.files import write_text
    from unet_fem.training.run import open_run

    settings, dataset = open_run(options.run)
    small = [
        smaller_run(settings, dataset, s, options.filters, options.epochs, options.learning_rate)
        for s in options.sparsity
    ]
    figures = compare([settings, *small], dataset, options.rounds)
    kind = "filters" if options.filters else "weights"
    write_text(settings.folder / f"pruning_{kind}.json", json.dumps(figures, indent=1))
    print(f"\n{table(figures)}\n\nwrote {settings.folder / f'pruning_{kind}.json'}")
    print(f"next: python tools/benchmark.py {' '.join(str(s.folder) for s in [settings, *small])}")


if __name__ == "__main__":
    main()
