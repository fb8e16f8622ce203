"""A Keras network as a stepper."""

import math
from pathlib import Path

import keras
import numpy as np

from fem.online.grid import NodeGrid
from fem.online.input_field import InputField
from fem.online.window import WindowStepper
from unet_fem.networks.files import load_model
from unet_fem.networks.layers import check_input


class KerasStepper(WindowStepper):
    """A Stepper that calls a Keras model, plainly: the window is kept here.

    interval: s between the frames that the model was trained on, None if unknown. grid: of a mesh's
    nodes; None for all nodes of the model's grid. field: what the model sees in place of the
    forces. Raises InputError where it is not the one that the model was trained on.
    """

    def __init__(
        self,
        model: keras.Model,
        interval: float | None = None,
        grid: NodeGrid | None = None,
        field: InputField | None = None,
    ) -> None:
        check_input(model, field)
        *window, nx, ny, nz, _ = model.input_shape[1:]
        shape = (nx, ny, nz)
        grid = grid or NodeGrid(shape, np.arange(math.prod(shape)))
        super().__init__(model, grid, window[0] if window else None, interval, field)

    @classmethod
    def open(
        cls, path: Path | str, interval: float | None = None, grid: NodeGrid | None = None
    ) -> "KerasStepper":
        """That of the .keras file at `path`, with the input field that lies beside it, if one does.
        Raises InputError for another file, and where the field is missing."""
        return cls(load_model(path), interval, grid, InputField.beside(path))
