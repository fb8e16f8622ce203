"""The files of a training run, each written beside its place and then moved there."""

import json
import os
import time
from pathlib import Path

import keras

from fem.errors import InputError
from fem.files import write_text
from unet_fem.networks.layers import float32_twin


def save_model(model, path):
    """Write a whole Keras model in float32 to `path` (.keras), at once or not at all."""
    path = Path(path)
    partial = path.with_name(f".partial-{path.name}")
    keras.saving.save_model(float32_twin(model), partial)
    os.replace(partial, path)


def load_model(path):
    """The Keras model at `path`. Raises InputError if it is missing or damaged."""
    if not Path(path).is_file():
        raise InputError(f"no model {path}; train one with python -m unet_fem.train")
    try:
        return keras.saving.load_model(path, compile=False)
    except (ValueError, OSError, KeyError) as error:
        raise InputError(
            f"{path} cannot be loaded ({str(error).splitlines()[0]}); delete it and train again"
        ) from None


class Checkpoint(keras.callbacks.Callback):
    """After each epoch: history, the best model so far, and all that is needed to go on (weights,
    optimizer, step).

    The step count of the optimizer says how far a checkpoint is, so a kill between two files does
    no harm.
    """

    def __init__(self, folder, steps_per_epoch):
        super().__init__()
        self.folder, self.steps_per_epoch = Path(folder), steps_per_epoch
        self.weights = self.folder / "checkpoint.weights.h5"
        self.history_file = self.folder / "history.json"
        self.history = {}

    def restore(self, model):
        """Load the checkpoint into the compiled `model`, if there is one. Returns the number of
        finished epochs."""
        if not self.weights.is_file():
            return 0
        model.optimizer.build(model.trainable_variables)
        try:
            model.load_weights(self.weights)
            history = json.loads(self.history_file.read_text())
        except (ValueError, OSError, KeyError) as error:
            raise InputError(
                f"{self.weights} does not fit this model or is damaged ({str(error).splitlines()[0]}); give another name= or delete {self.folder}"
            ) from None
        done = int(model.optimizer.iterations) // self.steps_per_epoch
        self.history = {name: values[:done] for name, values in history.items()}
        return done

    def on_epoch_begin(self, epoch, logs=None):
        self.began = time.monotonic()

    def on_epoch_end(self, epoch, logs=None):
        for name, value in {**logs, "seconds": time.monotonic() - self.began}.items():
            self.history.setdefault(name, []).append(float(value))
        write_text(self.history_file, json.dumps(self.history, indent=1))
        errors = self.history["val_relative_error"]
        if errors[-1] == min(errors):
            save_model(self.model, self.folder / "best.keras")
        partial = self.weights.with_name(f".partial-{self.weights.name}")
        self.model.save_weights(partial)
        os.replace(partial, self.weights)
