"""The paper's CNN-LSTM."""

import math
from types import ModuleType

import keras
import numpy as np

from unet_fem.networks.block import block_channels, coarse_block
from unet_fem.networks.layers import displacement_layer, pad, reshape


def cnn_lstm(
    grid: tuple[int, int, int] = (17, 17, 8),
    units: int = 512,
    steps: int = 2,
    *,
    force_scale: float = 1.0,
    displacement_scale: float = 1.0,
    mask: np.ndarray | None = None,
    lib: ModuleType | None = None,
) -> keras.Model:
    """CNN-LSTM: force (B, steps, nx, ny, nz, 3) in mN -> displacement of the last step (B, nx, ny,
    nz, 3) in mm.

    Each step is convolved and pooled by three, a bidirectional LSTM reads the steps, and its output
    becomes a coarse block of displacement features, upsampled by (4, 4, 3) and joined with the
    first convolution of the last step.

    Pooling and block are anchored at the loaded surface: the nz mod 3 deepest layers are not
    pooled, and the block is zero there. In x and y the pooling rounds up, and the block stands in
    the middle of the grid. Time is folded into the batch around the convolution.

    grid: nodes (nx, ny, nz). units: LSTM units per direction (the paper's N_N). steps: length of
    the window (N_t).
    force_scale: mN. displacement_scale: mm. mask: (nx, ny, nz) bool, the free material nodes; None
    for all. lib: the Keras to build with, keras if None. Raises InputError for a grid smaller than
    (4, 4, 3), and when 2 * units does not fill the block.
    """
    lib = lib or keras
    layers = lib.layers
    nx, ny, nz = grid
    block = coarse_block(grid)
    channels = block_channels(units, block)
    pooled = (math.ceil(nx / 3), math.ceil(ny / 3), nz // 3)
    deep = nz % 3

    force = lib.Input((steps, *grid, 3), name="force")  # (B, T, nx, ny, nz, 3)
    x = layers.Rescaling(1 / force_scale, dtype="float32", name="force_scaled")(force)
    x = reshape(x, (-1, *grid, 3), lib)  # (B*T, nx, ny, nz, 3)
    first = layers.Conv3D(32, 3, padding="same", activation="relu", name="first_conv")(
        x
    )  # (B*T, nx, ny, nz, 32)
    x = layers.Cropping3D(((0, 0), (0, 0), (deep, 0)), name="drop_deep")(first) if deep else first
    x = layers.MaxPooling3D(3, padding="same", name="pool")(x)  # (B*T, nx/3, ny/3, nz/3, 32)
    x = reshape(x, (-1, steps, math.prod(pooled) * 32), lib)  # (B, T, features)
    x = layers.Bidirectional(layers.LSTM(units, name="lstm"), name="bilstm")(x)  # (B, 2 units)
    x = layers.Activation("tanh", name="tanh")(x)
    x = layers.Reshape((*block, channels), name="block")(x)  # (B, nx//4, ny//4, nz//3, C)
    x = layers.UpSampling3D((4, 4, 3), name="upsample")(x)
    spare_x, spare_y = nx % 4, ny % 4
    x = pad(
        x,
        ((spare_x // 2, spare_x - spare_x // 2), (spare_y // 2, spare_y - spare_y // 2), (deep, 0)),
        lib,
    )
    x = layers.Conv3D(32, 3, padding="same", activation="relu", name="decoder_conv")(
        x
    )  # (B, nx, ny, nz, 32)

    # The last step by way of (B, T, features): a slice of a six-dimensional array cannot be
    # deployed.
    last = reshape(first, (-1, steps, math.prod(grid) * 32), lib)
    last = layers.Cropping1D((steps - 1, 0), name="last_step")(last)  # (B, 1, nx*ny*nz*32)
    last = layers.Reshape((*grid, 32), name="last_step_grid")(last)
    x = layers.Concatenate(name="skip")([x, last])  # (B, nx, ny, nz, 64)
    x = layers.Conv3D(3, 1, dtype="float32", name="output_conv")(x)  # (B, nx, ny, nz, 3)
    return lib.Model(force, displacement_layer(x, displacement_scale, mask, lib), name="cnn_lstm")
