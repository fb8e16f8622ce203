"""A Keras network as a stepper."""

import math
from pathlib import Path

import keras
import numpy as np

from fem.online.grid import NodeGrid
from fem.online.window import WindowStepper
from unet_fem.networks.files import load_model


class KerasStepper(WindowStepper):
    """A Stepper that calls a Keras model, plainly: the window is kept here.

    interval: s between the frames that the model was trained on, None if unknown. grid: of a mesh's
    nodes; None for all nodes of the model's grid.
    """

    def __init__(
        self, model: keras.Model, interval: float | None = None, grid: NodeGrid | None = None
    ) -> None:
        *window, nx, ny, nz, _ = model.input_shape[1:]
        shape = (nx, ny, nz)
        grid = grid or NodeGrid(shape, np.arange(math.prod(shape)))
        super().__init__(model, grid, window[0] if window else None, interval)

    @classmethod
    def open(
        cls, path: Path | str, interval: float | None = None, grid: NodeGrid | None = None
    ) -> "KerasStepper":
        """That of the .keras file at `path`. Raises InputError for another file."""
        return cls(load_model(path), interval, grid)
