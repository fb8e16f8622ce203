"""Train the network of some settings, from its dataset to its metrics."""

import sys
import time

from unet_fem.networks.ridge import RIDGES
from unet_fem.training.run import ensure_dataset, prepare_folder


def build_model(settings, dataset, force_scale, displacement_scale):
    """The untrained network of `settings` for the grid of `dataset`."""
    from unet_fem.networks.cnn_lstm import cnn_lstm
    from unet_fem.networks.unet import unet

    scale = {
        "force_scale": force_scale,
        "displacement_scale": displacement_scale,
        "mask": dataset.free,
    }
    choice = settings.model
    if choice.kind == "unet":
        return unet(dataset.grid, choice.filters, **scale)
    return cnn_lstm(dataset.grid, choice.units, choice.steps, **scale)


def build_loss(settings, dataset):
    """The loss of `settings` for the mesh of `dataset`, see
    unet_fem.training.losses.volume_loss."""
    from unet_fem.training import losses

    choice = settings.loss
    return losses.volume_loss(
        *dataset.surface,
        weight=choice.volume_weight,
        threshold=choice.volume_threshold,
        direction_weight=choice.direction_weight,
    )


def compile_model(model, settings, dataset, steps_per_epoch):
    """Adam, the loss and the metrics of `settings`; the learning rate is a function of the step, so
    a resumed run keeps it."""
    import keras

    from unet_fem.training import losses

    choice = settings.train
    rate = choice.learning_rate
    if choice.schedule == "cosine":
        rate = keras.optimizers.schedules.CosineDecay(rate, choice.epochs * steps_per_epoch)
    model.compile(
        # squared millimetres make gradients far below Keras's epsilon of 1e-7, which would turn
        # Adam into slow descent
        keras.optimizers.Adam(rate, epsilon=1e-12),
        build_loss(settings, dataset),
        metrics=[
            losses.RelativeError(),
            losses.gate_open(*dataset.surface, settings.loss.volume_threshold),
        ],
    )


def targets(samples, settings):
    """What the loss compares with: the displacement, and the last force beside it if the direction
    term needs it."""
    import numpy as np

    if not settings.loss.direction_weight:
        return samples.displacement
    return np.concatenate([samples.displacement, samples.last_force], axis=-1)


def fit(model, settings, train, validation):
    """Train from the checkpoint in the run's folder, or from the start if there is none. Returns
    the history."""
    import keras

    from unet_fem.training.checkpoint import Checkpoint
    from unet_fem.training.samples import batches

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
            callbacks=[
                checkpoint,
                keras.callbacks.TensorBoard(settings.folder / "tensorboard", write_graph=False),
            ],
            verbose=1 if sys.stdout.isatty() else 2,
        )
    return checkpoint.history


def train(settings, resume=False):
    """Everything that `settings` asks for, into settings.folder. Returns the metrics of
    unet_fem.evaluate."""
    folder = settings.folder
    prepare_folder(settings, resume)
    dataset = ensure_dataset(settings)

    import keras

    from unet_fem.networks.linear import linear_regression
    from unet_fem.training import samples as data
    from unet_fem.training.checkpoint import save_model
    from unet_fem.training.judge import evaluate

    started = time.monotonic()
    keras.utils.set_random_seed(settings.train.seed)
    keras.mixed_precision.set_global_policy(settings.train.precision)
    samples = {
        split: data.load_samples(dataset, split, settings.model.window)
        for split in ("train", "validation")
    }
    print("fitting the linear regression", flush=True)
    linear = linear_regression(
        samples["train"].force,
        samples["train"].displacement,
        dataset.free,
        RIDGES,
        (samples["validation"].force, samples["validation"].displacement),
    )
    save_model(linear, folder / "linear.keras")
    model = build_model(settings, dataset, *data.scales(samples["train"]))
    compile_model(model, settings, dataset, -(-len(samples["train"]) // settings.train.batch_size))
    print(
        f"training {model.name}: {model.count_params():,} parameters, {len(samples['train'])} training and "
        f"{len(samples['validation'])} validation samples, {settings.train.epochs} epochs",
        flush=True,
    )
    history = fit(model, settings, samples["train"], samples["validation"])
    opened = max(history["gate_open"])
    print(
        f"trained in {time.monotonic() - started:.0f} s; the volume gate was open for at most {100 * opened:.2f} % of an epoch's samples"
    )
    return evaluate(settings, dataset)
