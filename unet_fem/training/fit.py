"""Train the network of some settings, or fit the regression, from its dataset to its metrics."""

import math
import random
import sys
import time

import keras
import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.input_field import InputField
from unet_fem.networks.layers import seeing
from unet_fem.networks.registry import network
from unet_fem.training import losses
from unet_fem.training import samples as data
from unet_fem.training.checkpoint import Checkpoint
from unet_fem.training.judge import evaluate
from unet_fem.training.precision import precision
from unet_fem.training.regressions import fit_regression, linear_regression
from unet_fem.training.run import model_file
from unet_fem.training.samples import Samples
from unet_fem.training.settings import Settings
from unet_fem.training.surface import volume_surface


def build_model(
    settings: Settings, dataset: Dataset, force_scale: float, displacement_scale: float
) -> keras.Model:
    """The untrained network of `settings` for the grid of `dataset`; scales in mN and mm."""
    scales = force_scale, displacement_scale
    row = network(settings.model.kind)
    model = row.build(dataset.grid, settings.model, scales, dataset.free)
    choice = settings.input
    return seeing(model, choice.memory == "creep", choice.physics == "elastic")


def build_loss(settings: Settings, dataset: Dataset) -> losses.Loss:
    """The loss of `settings` for the mesh of `dataset`, see
    unet_fem.training.losses.volume_loss."""
    choice = settings.loss
    return losses.volume_loss(
        *volume_surface(dataset, choice.volume_of),
        weight=choice.volume_weight,
        threshold=choice.volume_threshold,
        direction_weight=choice.direction_weight,
    )


def compile_model(
    model: keras.Model, settings: Settings, dataset: Dataset, steps_per_epoch: int
) -> None:
    """Adam, the loss and the metrics of `settings`; the learning rate is a function of the step, so
    a resumed run keeps it."""
    choice = settings.train
    points, faces = volume_surface(dataset, settings.loss.volume_of)
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
            losses.gate_open(points, faces, settings.loss.volume_threshold),
        ],
    )


def targets(samples: Samples, settings: Settings) -> np.ndarray:
    """What the loss compares with: the displacement, and the last force beside it if the direction
    term needs it."""
    if not settings.loss.direction_weight:
        return samples.displacement
    return np.concatenate([samples.displacement, samples.last_force], axis=-1)


def fit(
    model: keras.Model, settings: Settings, train: Samples, validation: Samples
) -> dict[str, list[float]]:
    """Train from the checkpoint in the run's folder, or from the start if there is none. Returns
    the history. Raises InputError where no epoch gave a finite error."""
    choice = settings.train
    steps = -(-len(train) // choice.batch_size)
    checkpoint = Checkpoint(settings.folder, steps)
    first = checkpoint.restore(model)
    if first:
        print(f"going on after {first} of {choice.epochs} epochs", flush=True)
    if first < choice.epochs:
        model.fit(
            data.batches(
                train.input, targets(train, settings), choice.batch_size, choice.seed, first
            ),
            steps_per_epoch=steps,
            epochs=choice.epochs,
            initial_epoch=first,
            shuffle=False,
            validation_data=(validation.input, targets(validation, settings)),
            validation_batch_size=choice.batch_size,
            callbacks=[
                checkpoint,
                keras.callbacks.TensorBoard(settings.folder / "tensorboard", write_graph=False),
            ],
            verbose=1 if sys.stdout.isatty() else 2,
        )
    if checkpoint.best is None:
        raise InputError(
            f"training has diverged: no epoch gave a finite error; delete {settings.folder} and"
            f" lower train.learning_rate = {choice.learning_rate:g}"
        )
    if not math.isfinite(checkpoint.history["val_relative_error"][-1]):
        print(
            f"training has diverged: the last error is not finite, the model kept is that of epoch"
            f" {checkpoint.best + 1}; lower train.learning_rate = {choice.learning_rate:g}"
        )
    return checkpoint.history


def train_run(
    settings: Settings,
    dataset: Dataset,
    samples: tuple[Samples, Samples],
    field: InputField | None = None,
    quiet: bool = False,
) -> dict:
    """All that `settings` asks for on its dataset, into settings.folder, which
    unet_fem.training.run has made. samples: for training and validation. field: that the model sees
    in place of the forces. Returns the metrics; quiet: without showing them."""
    if settings.fitted:
        print(f"fitting the {network(settings.model.kind).label}", flush=True)
        fit_regression(dataset, settings.model, samples, field).save(model_file(settings))
    else:
        train_network(settings, dataset, *samples)
    return evaluate(settings, dataset, quiet)


def seed(number: int) -> None:
    """Seed Keras, NumPy and Python, at the place in Python's sequence where the published runs
    began: behind two draws for the Keras layers that their linear regression was made of."""
    keras.utils.set_random_seed(number)
    for _ in range(2):
        random.randint(1, 10**9)


def said_scale(settings: Settings, dataset: Dataset, train: Samples) -> str:
    """How large the volume term is beside the mean square, in words."""
    choice = settings.loss
    surface = volume_surface(dataset, choice.volume_of)
    band = choice.volume_threshold * losses.volume_at_rest(*surface)
    scale = losses.volume_scale(
        *surface, choice.volume_weight, choice.volume_threshold, train.displacement
    )
    return (
        f"volume term ({choice.volume_of} cells): {choice.volume_weight:g} x (change of volume)^2"
        f" beyond {band:.3g} mm3, in mm6 beside the mm2 of the mean square: where the gate opens"
        f" {scale:.3g} times the loss of an answer at rest"
    )


def train_network(
    settings: Settings, dataset: Dataset, train: Samples, validation: Samples
) -> None:
    """Train the network of `settings`, and fit the linear regression that it is compared with
    unless it corrects the elastic answer."""
    started = time.monotonic()
    seed(settings.train.seed)
    corrects = settings.input.physics == "elastic"
    if not corrects:
        print("fitting the linear regression", flush=True)
        linear_regression(settings, dataset, (train, validation))
    with precision(settings.train.precision):
        model = build_model(settings, dataset, *data.scales(train, corrects))
        compile_model(model, settings, dataset, -(-len(train) // settings.train.batch_size))
        print(
            f"training {model.name}: {model.count_params():,} parameters, {len(train)} training and"
            f" {len(validation)} validation samples, {settings.train.epochs} epochs",
            flush=True,
        )
        print(said_scale(settings, dataset, train), flush=True)
        history = fit(model, settings, train, validation)
    opened = max(history["gate_open"])
    print(
        f"trained in {time.monotonic() - started:.0f} s; the volume gate was open for at most"
        f" {100 * opened:.2f} % of an epoch's samples"
    )
