"""The networks in two dimensions: every 3-D layer expressed by operators that TensorFlow Lite has
for a CPU.

As Keras writes them the networks convert to nothing that runs: MaxPooling3D has no builtin
operator, CONV_3D stays float32 whatever is asked for, and slices of six dimensions fail at run
time. Here each layer works on arrays that take x as the batch, (B*nx, ny, nz, C), over the model's
own graph; B is 1, or the window's steps where the CNN-LSTM folds time into the batch. Between
layers arrays keep Keras's shape: the converter removes the reshapes.
"""

import math

import keras
import numpy as np
import tensorflow as tf
from keras import layers

from fem.errors import InputError
from unet_fem.networks.layers import float32_twin


def reexpress(model: keras.Model) -> keras.Model:
    """The float32 model with batch 1 and every 3-D layer expressed by 2-D operators, as a Keras
    model."""

    def clone(layer):
        if type(layer) not in EXPRESSIONS:
            return layer
        _check(layer)
        express, weights = EXPRESSIONS[type(layer)], layer.get_weights()
        return layers.Lambda(
            lambda x: express(layer, weights, x), layer.compute_output_shape, name=layer.name
        )

    force = keras.Input(model.input_shape[1:], batch_size=1, name="force")
    return keras.models.clone_model(float32_twin(model), input_tensors=force, clone_function=clone)


def _check(layer):
    """Raises InputError for the options of a layer that its expression leaves out."""
    if isinstance(layer, layers.Conv3D):
        same = layer.padding == "same" or set(layer.kernel_size) == {1}
        cube = len(set(layer.kernel_size)) == 1
        if not (
            same
            and cube
            and layer.use_bias
            and {layer.groups, *layer.strides, *layer.dilation_rate} == {1}
        ):
            raise InputError(
                f"layer {layer.name}: only convolutions with bias, cubic kernel, 'same' padding"
                " and no strides deploy"
            )
    if isinstance(layer, layers.MaxPooling3D) and layer.strides != layer.pool_size:
        raise InputError(
            f"layer {layer.name} pools {layer.pool_size} in strides of {layer.strides};"
            " make them equal"
        )
    if isinstance(layer, layers.Bidirectional) and type(layer.forward_layer) is not layers.LSTM:
        raise InputError(f"layer {layer.name}: of recurrent layers only the LSTM deploys")


def _around(x, axis):
    """x as (before, n, after): everything that happens along one axis happens here in three
    dimensions."""
    return tf.reshape(x, (math.prod(x.shape[:axis]), x.shape[axis], math.prod(x.shape[axis + 1 :])))


def _restored(x, shape, axis):
    """(before, n, after) as `shape` with n at `axis`."""
    return tf.reshape(x, (*shape[:axis], x.shape[1], *shape[axis + 1 :]))


def _conv(layer, weights, x):
    """The slices x - 1, x, x + 1 side by side as channels, and one 2-D convolution over (y, z); an
    even kernel reaches one farther up, as "same" padding has it."""
    B, X, Y, Z, C = x.shape
    kernel, bias = weights  # (k, k, k, C, F), (F,)
    k = len(kernel)
    axis = int(B > 1)
    x = tf.reshape(x, (B, X, Y * Z, C) if axis else (X, Y, Z, C))
    if k > 1:
        x = tf.pad(x, [((k - 1) // 2, k // 2) if n == axis else (0, 0) for n in range(4)])
    depth = [x[:, d : d + X] if axis else x[d : d + X] for d in range(k)]
    depth = [tf.reshape(part, (B * X, Y, Z, C)) for part in depth]
    kernel = kernel.transpose(1, 2, 0, 3, 4).reshape(
        *kernel.shape[1:3], k * C, -1
    )  # (ky, kz, kx*C, F)
    x = tf.nn.conv2d(tf.concat(depth, axis=-1) if k > 1 else depth[0], kernel, 1, "SAME")
    return tf.reshape(layer.activation(x + bias), (B, X, Y, Z, -1))


def _max_pool(layer, weights, x):
    B, X, Y, Z, C = x.shape
    px, py, pz = layer.pool_size
    padding = layer.padding.upper()
    x = tf.nn.max_pool2d(tf.reshape(x, (B, X, Y * Z, C)), (px, 1), (px, 1), padding)
    X = x.shape[1]
    x = tf.nn.max_pool2d(tf.reshape(x, (B * X, Y, Z, C)), (py, pz), (py, pz), padding)
    return tf.reshape(x, (B, X, *x.shape[1:]))


def _upsample(layer, weights, x):
    for axis, factor in zip((3, 2, 1), reversed(layer.size), strict=True):
        shape = x.shape
        x = tf.reshape(x, (math.prod(shape[: axis + 1]), 1, math.prod(shape[axis + 1 :])))
        x = tf.reshape(
            tf.concat([x] * factor, axis=1),
            (*shape[:axis], factor * shape[axis], *shape[axis + 1 :]),
        )
    return x


def _crop(layer, weights, x):
    for axis, (low, high) in enumerate(layer.cropping, start=1):
        if low or high:
            x = _restored(_around(x, axis)[:, low : x.shape[axis] - high], x.shape, axis)
    return x


def _rescale(layer, weights, x):
    if not np.any(layer.scale) and not np.any(layer.offset):
        return tf.zeros(x.shape)  # how unet_fem.networks.layers pads; _concatenate knows it again
    x = x * (np.broadcast_to(layer.scale, x.shape) if np.ndim(layer.scale) else layer.scale)
    return x + layer.offset if np.any(layer.offset) else x


def _concatenate(layer, weights, parts):
    axis, shape = layer.axis % len(parts[0].shape), parts[0].shape
    real = [tf.get_static_value(part) is None for part in parts]
    if sum(real) > 1 or all(real):
        return _restored(tf.concat([_around(part, axis) for part in parts], axis=1), shape, axis)
    at, width = real.index(True), [part.shape[axis] for part in parts]
    margins = sum(width[:at]), sum(width[at + 1 :])
    return _restored(tf.pad(_around(parts[at], axis), ((0, 0), margins, (0, 0))), shape, axis)


def _bilstm(layer, weights, x):
    """Keras's LSTM cell, gates (input, forget, cell, output), written out; all steps' inputs in one
    product."""
    _, steps, features = x.shape
    units = layer.forward_layer.units
    kernel = np.concatenate(weights[::3], axis=1)  # (features, 8 units)
    inputs = tf.reshape(x, (steps, features)) @ kernel + np.concatenate(
        weights[2::3]
    )  # (T, 8 units)
    last = []
    for direction, recurrent in enumerate(weights[1::3]):  # forward, backward
        order = range(steps) if direction == 0 else range(steps - 1, -1, -1)
        h = c = None
        for t in order:
            gates = inputs[
                t : t + 1, 4 * units * direction : 4 * units * (direction + 1)
            ]  # (1, 4 units)
            if h is not None:
                gates += h @ recurrent
            i, f, g, o = (gates[:, n * units : (n + 1) * units] for n in range(4))
            new = tf.sigmoid(i) * tf.tanh(g)
            c = new if c is None else tf.sigmoid(f) * c + new
            h = tf.sigmoid(o) * tf.tanh(c)
        last.append(h)
    return tf.concat(last, axis=1)  # (1, 2 units)


EXPRESSIONS = {
    layers.Conv3D: _conv,
    layers.MaxPooling3D: _max_pool,
    layers.UpSampling3D: _upsample,
    layers.Cropping3D: _crop,
    layers.Rescaling: _rescale,
    layers.Concatenate: _concatenate,
    layers.Bidirectional: _bilstm,
}
