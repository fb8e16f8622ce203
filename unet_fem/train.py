"""Train a network on a scene's interactions, from missing data to figures.

    python -m unet_fem.train [config.toml] [key=value ...] [--resume]

Without arguments: configs/quick.toml. Everything goes to runs/<name>/.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from fem.dataset import open_dataset
from fem.errors import InputError, command_line
from fem.scene import load_scene
from unet_fem import config
from unet_fem.ridge import RIDGES

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def ensure_dataset(settings):
    """The dataset of `settings`, generated first if its file is missing. Raises InputError if it is another scene's."""
    scene, path = load_scene(settings.scene), Path(settings.data)
    if not path.is_file():
        print(f"{path} is missing: simulating {len(scene.interactions.all())} interactions of {settings.scene}", flush=True)
        # a process of its own: its workers would otherwise import this one's libraries
        code = subprocess.run([sys.executable, "-m", "fem.generate", settings.scene, "--out", str(path), "--quiet"]).returncode
        if code:
            sys.exit(code)
    dataset = open_dataset(path)
    if dataset.scene != scene:
        raise InputError(f"{path} was made from another scene than {settings.scene}; delete it or give another data=")
    return dataset


def build_model(settings, dataset, force_scale, displacement_scale):
    """The untrained network of `settings` for the grid of `dataset`."""
    from unet_fem import models

    scale = {"force_scale": force_scale, "displacement_scale": displacement_scale, "mask": dataset.free}
    choice = settings.model
    if choice.kind == "unet":
        return models.unet(dataset.grid, choice.filters, **scale)
    return models.cnn_lstm(dataset.grid, choice.units, choice.steps, **scale)


def build_loss(settings, dataset):
    """The loss of `settings` for the mesh of `dataset`, see unet_fem.losses.volume_loss."""
    from unet_fem import losses

    choice = settings.loss
    return losses.volume_loss(
        *dataset.surface, weight=choice.volume_weight, threshold=choice.volume_threshold, direction_weight=choice.direction_weight
    )


def compile_model(model, settings, dataset, steps_per_epoch):
    """Adam, the loss and the metrics of `settings`; the learning rate is a function of the step, so a resumed run keeps it."""
    import keras

    from unet_fem import losses

    choice = settings.train
    rate = choice.learning_rate
    if choice.schedule == "cosine":
        rate = keras.optimizers.schedules.CosineDecay(rate, choice.epochs * steps_per_epoch)
    model.compile(
        # squared millimetres make gradients far below Keras's epsilon of 1e-7, which would turn Adam into slow descent
        keras.optimizers.Adam(rate, epsilon=1e-12),
        build_loss(settings, dataset),
        metrics=[losses.RelativeError(), losses.gate_open(*dataset.surface, settings.loss.volume_threshold)],
    )


def targets(samples, settings):
    """What the loss compares with: the displacement, and the last force beside it if the direction term needs it."""
    import numpy as np

    if not settings.loss.direction_weight:
        return samples.displacement
    return np.concatenate([samples.displacement, samples.last_force], axis=-1)


def fit(model, settings, train, validation):
    """Train from the checkpoint in the run's folder, or from the start if there is none. Returns the history."""
    import keras

    from unet_fem.checkpoint import Checkpoint
    from unet_fem.data import batches

    choice = settings.train
    steps = -(-len(train) // choice.batch_size)
    checkpoint = Checkpoint(settings.folder, steps)
    first = checkpoint.restore(model)
    if first < choice.epochs:
        model.fit(
            batches(train.force, targets(train, settings), choice.batch_size, choice.seed, first),
            steps_per_epoch=steps,
            epochs=choice.epochs,
            initial_epoch=first,
            shuffle=False,
            validation_data=(validation.force, targets(validation, settings)),
            validation_batch_size=choice.batch_size,
            callbacks=[checkpoint, keras.callbacks.TensorBoard(settings.folder / "tensorboard", write_graph=False)],
            verbose=1 if sys.stdout.isatty() else 2,
        )
    return checkpoint.history


def train(settings, resume=False):
    """Everything that `settings` asks for, into settings.folder. Returns the metrics of unet_fem.evaluate."""
    folder = settings.folder
    prepare_folder(settings, resume)
    dataset = ensure_dataset(settings)

    import keras

    from unet_fem import checkpoint, data, evaluate, models

    started = time.monotonic()
    keras.utils.set_random_seed(settings.train.seed)
    keras.mixed_precision.set_global_policy(settings.train.precision)
    samples = {split: data.load_samples(dataset, split, settings.model.window) for split in ("train", "validation")}
    print("fitting the linear regression", flush=True)
    linear = models.linear_regression(
        samples["train"].force, samples["train"].displacement, dataset.free, RIDGES,
        (samples["validation"].force, samples["validation"].displacement),
    )  # fmt: skip
    checkpoint.save_model(linear, folder / "linear.keras")
    model = build_model(settings, dataset, *data.scales(samples["train"]))
    compile_model(model, settings, dataset, -(-len(samples["train"]) // settings.train.batch_size))
    print(
        f"training {model.name}: {model.count_params():,} parameters, {len(samples['train'])} training and "
        f"{len(samples['validation'])} validation samples, {settings.train.epochs} epochs",
        flush=True,
    )
    history = fit(model, settings, samples["train"], samples["validation"])
    opened = max(history["gate_open"])
    print(f"trained in {time.monotonic() - started:.0f} s; the volume gate was open for at most {100 * opened:.2f} % of an epoch's samples")
    return evaluate.evaluate(settings, dataset)


def prepare_folder(settings, resume):
    """Make the run's folder with its settings. Raises InputError if it holds another run, or this one without `resume`."""
    folder, text = settings.folder, settings.toml()
    written = folder / "config.toml"
    if written.is_file():
        if not resume:
            raise InputError(f"{folder} exists already; add --resume to go on with it, or give another name=")
        if written.read_text() != text:
            raise InputError(f"{folder} was started with other settings (see {written}); give the same, or another name=")
    elif resume:
        raise InputError(f"there is no run {folder} to resume; leave --resume out to start it")
    folder.mkdir(parents=True, exist_ok=True)
    written.write_text(text)


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(prog="python -m unet_fem.train", description=__doc__.split("\n")[0])
    parser.add_argument("words", nargs="*", metavar="config.toml or key=value", help="settings; later ones win")
    parser.add_argument("--resume", action="store_true", help="go on with the run of this name")
    options = parser.parse_args(arguments)
    files = [word for word in options.words if "=" not in word]
    if len(files) > 1:
        raise InputError(f"give one configuration file, not {' and '.join(files)}")
    settings = config.load_settings(files[0] if files else config.QUICK, [w for w in options.words if "=" in w])
    metrics = train(settings, options.resume)
    folder = settings.folder
    print(f"\nfigures: {folder / 'figures'}   metrics: {folder / 'metrics.json'}   curves: tensorboard --logdir {folder / 'tensorboard'}")
    print(f"next: python tools/quantize.py {folder}   (TFLite models for a CPU)")
    return metrics


if __name__ == "__main__":
    main()
