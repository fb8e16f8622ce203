"""The forms in which a trained run answers, each a stepper: called plainly, as a graph, and by its
.tflite files."""

import math
from collections.abc import Callable
from functools import partial

import keras
import numpy as np
import tensorflow as tf

from fem.data.dataset import Dataset
from fem.online.grid import NodeGrid
from fem.online.input_field import InputField
from fem.online.stepper import Stepper
from fem.online.window import WindowStepper
from unet_fem.deployment.exported import lite_files, model_file
from unet_fem.networks.files import load_model
from unet_fem.networks.layers import check_input
from unet_fem.networks.stepper import KerasStepper
from unet_fem.runtime.surrogate import Surrogate
from unet_fem.training.settings import Settings

CALL, GRAPH = "Keras call", "tf.function"


def forms(
    settings: Settings, dataset: Dataset, threads: int = 1
) -> dict[str, Callable[[], Stepper]]:
    """{CALL: make, GRAPH: make, "float32": make, ...}: what makes the stepper of each form of a
    run, the .tflite files by their names.

    threads: of LiteRT; TensorFlow's are set by unet_fem.deployment.latency.use_threads. Raises
    InputError for a run without .tflite files.
    """
    path, interval = model_file(settings), dataset.scene.frames.interval
    files = lite_files(settings)
    return {
        CALL: lambda: KerasStepper.open(path, interval),
        GRAPH: lambda: graph_stepper(load_model(path), interval, InputField.beside(path)),
    } | {variant: partial(Surrogate, file, threads) for variant, file in files.items()}


def graph_stepper(
    model: keras.Model, interval: float | None = None, field: InputField | None = None
) -> WindowStepper:
    """A Stepper that calls a Keras model as one graph: what is paid for Python's call of every
    layer is gone. field: what the model sees in place of the forces."""
    check_input(model, field)
    graph = tf.function(lambda window: model(window, training=False))
    *window, nx, ny, nz, _ = model.input_shape[1:]
    nodes = NodeGrid((nx, ny, nz), np.arange(math.prod((nx, ny, nz))))
    return WindowStepper(
        lambda forces: graph(tf.constant(forces)).numpy(),
        nodes,
        window[0] if window else None,
        interval,
        field,
    )
