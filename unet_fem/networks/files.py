"""Keras models as files, written whole or not at all."""

from pathlib import Path

import keras

from fem.errors import InputError
from fem.files import replacing
from unet_fem.networks.layers import float32_twin


def save_model(model: keras.Model, path: Path | str) -> None:
    """Write a whole Keras model in float32 to `path` (.keras)."""
    with replacing(path) as partial:
        keras.saving.save_model(float32_twin(model), partial)


def load_model(path: Path | str) -> keras.Model:
    """The Keras model at `path`. Raises InputError if it is missing or damaged."""
    if not Path(path).is_file():
        raise InputError(f"no model {path}; train one with python -m unet_fem.train")
    try:
        return keras.saving.load_model(path, compile=False)
    except (ValueError, OSError, KeyError) as error:
        raise InputError(
            f"{path} cannot be loaded ({str(error).splitlines()[0]}); delete it and train again"
        ) from None
