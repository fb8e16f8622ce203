"""Networks built anew with the scales and the mask of a trained one: of another size, or in Keras
2."""

from types import ModuleType
from typing import TYPE_CHECKING

import keras
import numpy as np

from unet_fem.networks.layers import seeing, seen_by
from unet_fem.networks.registry import Options, network

if TYPE_CHECKING:
    import tf_keras


def rebuild(model: keras.Model, options: Options, lib: ModuleType | None = None) -> keras.Model:
    """An untrained network of `options` with the grid, scales and mask of `model`; lib: the Keras
    to build with, keras if None."""
    scale = np.asarray(model.get_layer("displacement").scale, "float32")
    scales = 1 / float(model.get_layer("force_scaled").scale), float(np.abs(scale).max())
    mask = scale[..., 0] != 0 if scale.ndim else None
    built = network(options.kind).build(model.output_shape[1:4], options, scales, mask, lib)
    return seeing(built, *seen_by(model), lib)


def legacy_twin(model: keras.Model, options: Options) -> "tf_keras.Model":
    """The same network and weights as a Keras 2 model (tf_keras), built by the same code."""
    import tf_keras  # a second Keras, for pruning alone

    twin = rebuild(model, options, tf_keras)
    twin.set_weights(model.get_weights())
    return twin
