"""What a training run keeps after each epoch, each file written whole or not at all."""

import json
import math
import time
from pathlib import Path

import keras
import numpy as np

from fem.errors import InputError
from fem.files import load_arrays, save_arrays, write_text
from unet_fem.networks.files import LARGEST, load_model, save_model
from unet_fem.training.run import read_history

__all__ = ["Checkpoint", "load_model", "save_model"]


class Checkpoint(keras.callbacks.Callback):
    """After each epoch: history, the best model so far, and all that is needed to go on (weights,
    optimizer, step).

    The step count of the optimizer says how far a checkpoint is, so a kill between two files does
    no harm. history: {name: value of each epoch}.
    """

    def __init__(self, folder: Path | str, steps_per_epoch: int) -> None:
        super().__init__()
        self.folder, self.steps_per_epoch = Path(folder), steps_per_epoch
        self.weights = self.folder / "checkpoint.npz"
        self.history_file = self.folder / "history.json"
        self.history: dict[str, list[float]] = {}

    def restore(self, model: keras.Model) -> int:
        """Load the checkpoint into the compiled `model`, if there is one. Returns the number of
        finished epochs. Raises InputError for a checkpoint that is damaged or another model's."""
        if (old := self.folder / "checkpoint.weights.h5").exists():
            raise InputError(
                f"{old} is of an older version and cannot go on; judge what is there with python"
                f" -m unet_fem.evaluate {self.folder}, or delete it and train again"
            )
        if not self.weights.exists():
            return 0
        model.optimizer.build(model.trainable_variables)
        arrays, variables = load_arrays(self.weights, most=LARGEST), state_of(model)
        kinds = {name: (tuple(own.shape), own.dtype) for name, own in variables.items()}
        if {name: (own.shape, own.dtype.name) for name, own in arrays.items()} != kinds:
            raise InputError(
                f"{self.weights} does not fit this model or is damaged; give another name= or"
                f" delete {self.folder}"
            )
        for name, variable in variables.items():
            variable.assign(arrays[name])
        history = read_history(self.history_file)
        done = int(model.optimizer.iterations) // self.steps_per_epoch
        self.history = {name: values[:done] for name, values in history.items()}
        if any(
            len(values) < done
            for values in [self.history.get("val_relative_error", []), *self.history.values()]
        ):
            raise InputError(
                f"{self.history_file} has fewer than the {done} epochs of {self.weights}; delete"
                f" {self.folder} and train again"
            )
        return done

    @property
    def best(self) -> int | None:
        """The epoch, from 0, whose model is kept: the least finite error; None without one."""
        errors = self.history.get("val_relative_error", [])
        finite = [epoch for epoch, error in enumerate(errors) if math.isfinite(error)]
        return min(finite, key=lambda epoch: (errors[epoch], -epoch), default=None)

    def on_epoch_begin(self, epoch: int, logs: dict | None = None) -> None:
        self.began = time.monotonic()

    def on_epoch_end(self, epoch: int, logs: dict | None = None) -> None:
        for name, value in {**(logs or {}), "seconds": time.monotonic() - self.began}.items():
            self.history.setdefault(name, []).append(float(value))
        write_text(self.history_file, json.dumps(self.history, indent=1))
        if self.best == len(self.history["val_relative_error"]) - 1:
            save_model(self.model, self.folder / "best.keras")
        state = {name: np.asarray(variable) for name, variable in state_of(self.model).items()}
        save_arrays(self.weights, **state)


def state_of(model: keras.Model) -> dict[str, keras.Variable]:
    """All that training goes on from, by a name for a file: weights, seeds and the optimizer's."""
    variables = [*model.variables, *model.optimizer.variables]
    return {str(n): variable for n, variable in enumerate(variables)}
