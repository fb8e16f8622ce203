"""The networks of the paper (Karami, Lombaert, Rivest-Hénault, arXiv 2301.04614) as Keras 3
functional models.

Every model maps nodal force in mN to nodal displacement in mm on a grid of nodes whose last layer,
z = nz - 1, is the free, loaded surface. Normalisation is part of the model, so a saved model is
whole: forces are divided by `force_scale`, and the last layer, `displacement`, multiplies by
`displacement_scale` and by `mask`, so that fixed and void nodes are exactly zero. Only built-in
layers are used: a saved `.keras` file loads without this package.

Each is built with the Keras that `lib` names, so that the same code gives a model of Keras 2
(tf_keras), which alone can be pruned.

Under the policy `mixed_bfloat16` the last convolution and the output are float32; `float32_twin`
gives the same network in float32 throughout.
"""

import json
import math
import re
from types import ModuleType

import keras
import numpy as np
import tensorflow as tf

from fem.errors import InputError
from fem.online.input_field import InputField


def float32_twin(model: keras.Model) -> keras.Model:
    """The same network and weights in float32, to deploy or compare a model trained under mixed
    precision."""
    config = re.sub(r"mixed_b?float16", "float32", json.dumps(model.get_config()))
    twin = type(model).from_config(json.loads(config))
    twin.set_weights(model.get_weights())
    return twin


def displacement_layer(
    x: keras.KerasTensor,
    scale: float,
    mask: np.ndarray | None,
    lib: ModuleType | None = None,
) -> keras.KerasTensor:
    """The last layer: mm, and exactly zero outside the mask (nx, ny, nz)."""
    if mask is not None:
        mask = np.asarray(mask)
        if mask.shape != x.shape[1:4]:
            raise InputError(
                f"mask of shape {mask.shape} on a grid of {x.shape[1:4]} nodes;"
                " give one value a node"
            )
    by = scale if mask is None else scale * mask[..., None].astype("float32")
    last = (lib or keras).layers.Rescaling(by, dtype="float32", name="displacement")
    return last(x)  # (B, nx, ny, nz, 3)


def seeing(
    model: keras.Model, memory: bool, elastic: bool, lib: ModuleType | None = None
) -> keras.Model:
    """`model` on what stands in place of the force in its input, see
    fem.online.input_field.InputField, which its name then tells: "_creep", "_elastic" behind it.

    elastic: the input is an elastic answer in mm, and its last frame is added to what the model
    gives, in a last layer without weights.
    """
    lib = lib or keras
    name = model.name + "_creep" * memory + "_elastic" * elastic
    if name == model.name:
        return model
    answer, last = model.output, model.input
    if elastic:
        if len(last.shape) == 6:  # as in the CNN-LSTM, a slice that can be deployed
            steps, grid = last.shape[1], last.shape[2:]
            last = reshape(last, (-1, steps, math.prod(grid)), lib)
            last = lib.layers.Cropping1D((steps - 1, 0), dtype="float32", name="last_answer")(last)
            last = lib.layers.Reshape(grid, dtype="float32", name="last_answer_grid")(last)
        answer = lib.layers.Add(dtype="float32", name="corrected")([answer, last])
    return lib.Model(model.input, answer, name=name)


def seen_by(model: keras.Model) -> tuple[bool, bool]:
    """(memory, elastic) of a model that `seeing` gave, or of any other."""
    return "_creep" in model.name, model.name.endswith("_elastic")


def check_input(model: keras.Model, field: InputField | None) -> None:
    """Raises InputError unless `field` is of the kind that `model` was trained on."""
    found = (False, False) if field is None else (bool(field.creep.terms), field.corrects)
    if found != seen_by(model):
        raise InputError(
            f"the model '{model.name}' sees another input than it is given; open it where its run"
            " has put it, beside its input.npz"
        )


def correction(model: keras.Model) -> keras.Model:
    """Of a model that corrects the elastic answer the part that gives the correction; any other
    itself."""
    if not seen_by(model)[1]:
        return model
    return keras.Model(model.input, model.get_layer("displacement").output, name=model.name)


def reshape(x: keras.KerasTensor, shape: tuple[int, ...], lib: ModuleType) -> keras.KerasTensor:
    """`x` in another shape, the batch too. Keras 2 has no ops of its own: its models take
    TensorFlow's."""
    return lib.ops.reshape(x, shape) if hasattr(lib, "ops") else tf.reshape(x, shape)


def pad(
    x: keras.KerasTensor,
    margins: tuple[tuple[int, int], ...],
    lib: ModuleType | None = None,
) -> keras.KerasTensor:
    """Zero-pad (B, x, y, z, C) by margins ((low, high), (low, high), (low, high)), concatenating
    zeros.

    Not ZeroPadding3D: TensorFlow 2.21 fuses Pad and Conv3D in graph mode and loses the padding.
    Each margin must be no wider than the grid.
    """
    layers = (lib or keras).layers
    for axis, (low, high) in enumerate(margins):
        name = "pad_" + "xyz"[axis]
        parts = [x]
        for end, width in (("low", low), ("high", high)):
            if width:
                crop = [(0, 0)] * 3
                crop[axis] = (0, x.shape[axis + 1] - width)
                slab = layers.Cropping3D(crop, name=f"{name}_{end}_slab")(x)
                zeros = layers.Rescaling(0.0, name=f"{name}_{end}")(slab)
                parts.insert(0 if end == "low" else len(parts), zeros)
        if len(parts) > 1:
            x = layers.Concatenate(axis=axis + 1, name=name)(parts)
    return x
