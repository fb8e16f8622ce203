"""The networks of the paper (Karami, Lombaert, Rivest-Hénault, arXiv 2301.04614) as Keras 3 functional models.

Every model maps nodal force in mN to nodal displacement in mm on a grid of nodes whose last layer, z = nz - 1, is the
free, loaded surface. Normalisation is part of the model, so a saved model is whole: forces are divided by
`force_scale`, and the last layer, `displacement`, multiplies by `displacement_scale` and by `mask`, so that fixed and
void nodes are exactly zero. Only built-in layers are used: a saved `.keras` file loads without this package.

Under the policy `mixed_bfloat16` the last convolution and the output are float32; `float32_twin` gives the same
network in float32 throughout.
"""

import json
import math
import re

import keras
import numpy as np
from keras import layers, ops

from fem.errors import InputError
from unet_fem import ridge as ridge_regression


def unet(grid=(17, 17, 8), filters=64, *, force_scale=1.0, displacement_scale=1.0, mask=None):
    """U-Net: force (B, nx, ny, nz, 3) in mN -> displacement (B, nx, ny, nz, 3) in mm.

    The paper counts six convolutions in the decoder and lists five (64, 64, 128, 64, 3). Here the sixth directly
    follows the upsampling, as in the original U-Net, and the five listed ones follow the skip connection:
    1,780,611 parameters with 64 filters.

    The grid is zero-padded to even sizes, x and y at the high end, z at the deep one, so that the pooling starts at
    the loaded surface.

    grid: nodes (nx, ny, nz). filters: channels of the first convolution. force_scale: mN. displacement_scale: mm.
    mask: (nx, ny, nz) bool, the free material nodes; None for all.
    """
    odd_x, odd_y, odd_z = (n % 2 for n in grid)
    margins = ((0, odd_x), (0, odd_y), (odd_z, 0))

    def conv(x, channels, name):
        return layers.Conv3D(channels, 3, padding="same", activation="relu", name=name)(x)

    force = keras.Input((*grid, 3), name="force")  # (B, nx, ny, nz, 3)
    x = layers.Rescaling(1 / force_scale, dtype="float32", name="force_scaled")(force)
    x = _pad(x, margins)  # (B, X, Y, Z, 3), all even
    x = conv(x, filters, "encoder_conv1")
    skip = conv(x, filters, "encoder_conv2")  # (B, X, Y, Z, f)
    x = layers.MaxPooling3D(2, name="pool")(skip)  # (B, X/2, Y/2, Z/2, f)
    x = conv(x, 2 * filters, "bottleneck_conv1")
    x = conv(x, 2 * filters, "bottleneck_conv2")  # (B, X/2, Y/2, Z/2, 2f)
    x = layers.UpSampling3D(2, name="upsample")(x)  # (B, X, Y, Z, 2f)
    x = conv(x, filters, "decoder_conv1")
    x = layers.Concatenate(name="skip")([x, skip])  # (B, X, Y, Z, 2f)
    x = conv(x, filters, "decoder_conv2")
    x = conv(x, filters, "decoder_conv3")
    x = conv(x, 2 * filters, "decoder_conv4")
    x = conv(x, filters, "decoder_conv5")
    x = layers.Conv3D(3, 3, padding="same", dtype="float32", name="decoder_conv6")(x)  # (B, X, Y, Z, 3)
    if any((odd_x, odd_y, odd_z)):
        x = layers.Cropping3D(margins, dtype="float32", name="crop")(x)  # (B, nx, ny, nz, 3)
    return keras.Model(force, _displacement(x, displacement_scale, mask), name="unet")


def cnn_lstm(grid=(17, 17, 8), units=512, steps=2, *, force_scale=1.0, displacement_scale=1.0, mask=None):
    """CNN-LSTM: force (B, steps, nx, ny, nz, 3) in mN -> displacement of the last step (B, nx, ny, nz, 3) in mm.

    Each step is convolved and pooled by three, a bidirectional LSTM reads the steps, and its output becomes a coarse
    block of displacement features, upsampled by (4, 4, 3) and joined with the first convolution of the last step.

    Pooling and block are anchored at the loaded surface: the nz mod 3 deepest layers are not pooled, and the block is
    zero there. In x and y the pooling rounds up, and the block stands in the middle of the grid. Time is folded into
    the batch around the convolution.

    grid: nodes (nx, ny, nz). units: LSTM units per direction (the paper's N_N). steps: length of the window (N_t).
    force_scale: mN. displacement_scale: mm. mask: (nx, ny, nz) bool, the free material nodes; None for all.
    Raises InputError for a grid smaller than (4, 4, 3), and when 2 * units does not fill the block.
    """
    nx, ny, nz = grid
    block = (nx // 4, ny // 4, nz // 3)
    if 0 in block:
        raise InputError(f"grid {nx} x {ny} x {nz} is too small for the CNN-LSTM; give at least 4 x 4 x 3 nodes")
    channels = _block_channels(units, block)
    pooled = (math.ceil(nx / 3), math.ceil(ny / 3), nz // 3)
    deep = nz % 3

    force = keras.Input((steps, *grid, 3), name="force")  # (B, T, nx, ny, nz, 3)
    x = layers.Rescaling(1 / force_scale, dtype="float32", name="force_scaled")(force)
    x = ops.reshape(x, (-1, *grid, 3))  # (B*T, nx, ny, nz, 3)
    first = layers.Conv3D(32, 3, padding="same", activation="relu", name="first_conv")(x)  # (B*T, nx, ny, nz, 32)
    x = layers.Cropping3D(((0, 0), (0, 0), (deep, 0)), name="drop_deep")(first) if deep else first
    x = layers.MaxPooling3D(3, padding="same", name="pool")(x)  # (B*T, nx/3, ny/3, nz/3, 32)
    x = ops.reshape(x, (-1, steps, math.prod(pooled) * 32))  # (B, T, features)
    x = layers.Bidirectional(layers.LSTM(units, name="lstm"), name="bilstm")(x)  # (B, 2 units)
    x = layers.Activation("tanh", name="tanh")(x)
    x = layers.Reshape((*block, channels), name="block")(x)  # (B, nx//4, ny//4, nz//3, C)
    x = layers.UpSampling3D((4, 4, 3), name="upsample")(x)
    spare_x, spare_y = nx % 4, ny % 4
    x = _pad(x, ((spare_x // 2, spare_x - spare_x // 2), (spare_y // 2, spare_y - spare_y // 2), (deep, 0)))
    x = layers.Conv3D(32, 3, padding="same", activation="relu", name="decoder_conv")(x)  # (B, nx, ny, nz, 32)

    # The last step by way of (B, T, features): a slice of a six-dimensional array cannot be deployed.
    last = ops.reshape(first, (-1, steps, math.prod(grid) * 32))
    last = layers.Cropping1D((steps - 1, 0), name="last_step")(last)  # (B, 1, nx*ny*nz*32)
    last = layers.Reshape((*grid, 32), name="last_step_grid")(last)
    x = layers.Concatenate(name="skip")([x, last])  # (B, nx, ny, nz, 64)
    x = layers.Conv3D(3, 1, dtype="float32", name="output_conv")(x)  # (B, nx, ny, nz, 3)
    return keras.Model(force, _displacement(x, displacement_scale, mask), name="cnn_lstm")


def linear_regression(force, displacement, mask, ridge=1e-6, validation=None):
    """Ridge regression in closed form, as a Keras model with the networks' input and output.

    With X the force components that are ever nonzero, Y the displacement of the free nodes, and s the largest
    eigenvalue of X^T X, the kernel is W = (X^T X + ridge s I)^-1 X^T Y = X^T (X X^T + ridge s I)^-1 Y, by whichever
    matrix is smaller, in float64. There is no intercept: no force, no displacement.

    force: (S, nx, ny, nz, 3) or windows (S, T, nx, ny, nz, 3), mN. displacement: (S, nx, ny, nz, 3), mm.
    mask: (nx, ny, nz) bool, the free material nodes. ridge: one value or several, as a fraction of s; several cost
    one eigendecomposition, and the best on validation = (force, displacement) is kept. The model's name tells which.
    Raises InputError when all forces are zero, or several ridges come without validation.
    """
    mask = np.asarray(mask, dtype=bool)
    active = np.flatnonzero(np.any(force, axis=0))
    if active.size == 0:
        raise InputError(f"all {len(force)} training forces are zero; give samples with contact")

    def columns(force):
        return force.reshape(len(force), -1)[:, active].astype("float64")  # (S, p)

    def free_nodes(displacement):
        return displacement[:, mask].reshape(len(displacement), -1).astype("float64")  # (S, q)

    X, Y = columns(force), free_nodes(displacement)
    shown = None if validation is None else (columns(validation[0]), free_nodes(validation[1]))
    kernel, ridge = ridge_regression.fit(X, Y, ridge, shown)  # (p, q)

    position = np.zeros((*mask.shape, 3), dtype="int32")
    position[mask] = np.arange(kernel.shape[1]).reshape(-1, 3)
    inputs = keras.Input(force.shape[1:], name="force")  # (B, [T,] nx, ny, nz, 3)
    x = layers.Flatten(dtype="float32", name="force_flat")(inputs)
    x = ops.take(x, active.astype("int32"), axis=1)  # (B, p)
    dense = layers.Dense(kernel.shape[1], use_bias=False, dtype="float32", name="regression")
    x = ops.take(dense(x), position.ravel(), axis=1)  # (B, nx*ny*nz*3)
    x = layers.Reshape(position.shape, dtype="float32", name="displacement_grid")(x)  # (B, nx, ny, nz, 3)
    model = keras.Model(inputs, _displacement(x, 1.0, mask), name=f"linear_ridge_{ridge:g}")
    dense.set_weights([kernel.astype("float32")])
    return model


def float32_twin(model):
    """The same network and weights in float32, to deploy or compare a model trained under mixed precision."""
    config = re.sub(r"mixed_b?float16", "float32", json.dumps(model.get_config()))
    twin = type(model).from_config(json.loads(config))
    twin.set_weights(model.get_weights())
    return twin


def _displacement(x, scale, mask):
    """The last layer: mm, and exactly zero outside the mask (nx, ny, nz)."""
    if mask is not None:
        mask = np.asarray(mask)
        if mask.shape != x.shape[1:4]:
            raise InputError(f"mask of shape {mask.shape} on a grid of {x.shape[1:4]} nodes; give one value a node")
        scale = scale * mask[..., None].astype("float32")
    return layers.Rescaling(scale, dtype="float32", name="displacement")(x)  # (B, nx, ny, nz, 3)


def _pad(x, margins):
    """Zero-pad (B, x, y, z, C) by margins ((low, high), (low, high), (low, high)), concatenating zeros.

    Not ZeroPadding3D: TensorFlow 2.21 fuses Pad and Conv3D in graph mode and loses the padding. Each margin must be
    no wider than the grid.
    """
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


def _block_channels(units, block):
    """Channels of the block that 2 * units LSTM outputs fill; block is its (x, y, z) cells."""
    cells = math.prod(block)
    if 2 * units % cells == 0:
        return 2 * units // cells
    multiple = cells // math.gcd(2, cells)
    below = units // multiple * multiple
    fitting = f"{below} or {below + multiple}" if below else f"{multiple}"
    size = " x ".join(map(str, block))
    raise InputError(f"2 * {units} LSTM outputs do not fill a block of {size} = {cells} cells; use {fitting} units")
