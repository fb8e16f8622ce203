"""The paper's U-Net."""

from types import ModuleType

import keras
import numpy as np

from unet_fem.networks.layers import displacement_layer, pad


def unet(
    grid: tuple[int, int, int] = (17, 17, 8),
    filters: int = 64,
    *,
    force_scale: float = 1.0,
    displacement_scale: float = 1.0,
    mask: np.ndarray | None = None,
    lib: ModuleType | None = None,
) -> keras.Model:
    """U-Net: force (B, nx, ny, nz, 3) in mN -> displacement (B, nx, ny, nz, 3) in mm.

    The paper counts six convolutions in the decoder and lists five (64, 64, 128, 64, 3). Here the
    sixth directly follows the upsampling, as in the original U-Net, and the five listed ones follow
    the skip connection: 1,780,611 parameters with 64 filters.

    The grid is zero-padded to even sizes, x and y at the high end, z at the deep one, so that the
    pooling starts at the loaded surface.

    grid: nodes (nx, ny, nz). filters: channels of the first convolution. force_scale: mN.
    displacement_scale: mm.
    mask: (nx, ny, nz) bool, the free material nodes; None for all. lib: the Keras to build with,
    keras if None.
    """
    lib = lib or keras
    layers = lib.layers
    odd_x, odd_y, odd_z = (n % 2 for n in grid)
    margins = ((0, odd_x), (0, odd_y), (odd_z, 0))

    def conv(x, channels, name):
        return layers.Conv3D(channels, 3, padding="same", activation="relu", name=name)(x)

    force = lib.Input((*grid, 3), name="force")  # (B, nx, ny, nz, 3)
    x = layers.Rescaling(1 / force_scale, dtype="float32", name="force_scaled")(force)
    x = pad(x, margins, lib)  # (B, X, Y, Z, 3), all even
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
    x = layers.Conv3D(3, 3, padding="same", dtype="float32", name="decoder_conv6")(
        x
    )  # (B, X, Y, Z, 3)
    if any((odd_x, odd_y, odd_z)):
        x = layers.Cropping3D(margins, dtype="float32", name="crop")(x)  # (B, nx, ny, nz, 3)
    return lib.Model(force, displacement_layer(x, displacement_scale, mask, lib), name="unet")
