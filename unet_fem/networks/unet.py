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
    """The authors' U-Net: force (B, nx, ny, nz, 3) in mN -> displacement (B, nx, ny, nz, 3) in mm.

    The layers are those of the code that the authors published beside arXiv 2301.04614 and of the
    paper's list for the decoder, "64, 64, 128, 64, and 3": the skip connection comes after the
    second of these, which is 2 x 2 x 2, and the last is 1 x 1 x 1 and linear. 1,697,731 parameters
    with 64 filters.

    The skip is zero-padded to even sizes at the high end of each axis, after the convolutions and
    the dropout, and what is padded is cropped before the last three convolutions.

    grid: nodes (nx, ny, nz). filters: channels of the first convolution. force_scale: mN.
    displacement_scale: mm.
    mask: (nx, ny, nz) bool, the free material nodes; None for all. lib: the Keras to build with,
    keras if None.
    """
    lib = lib or keras
    layers = lib.layers
    margins = tuple((0, n % 2) for n in grid)

    def conv(x, channels, name, kernel=3, **options):
        made = layers.Conv3D(
            channels,
            kernel,
            padding="same",
            kernel_initializer="he_normal",
            name=name,
            **{"activation": "relu"} | options,
        )
        return made(x)

    force = lib.Input((*grid, 3), name="force")  # (B, nx, ny, nz, 3)
    x = layers.Rescaling(1 / force_scale, dtype="float32", name="force_scaled")(force)
    x = conv(x, filters, "encoder_conv1")
    x = conv(x, filters, "encoder_conv2")  # (B, nx, ny, nz, f)
    x = layers.Dropout(0.5, name="dropout")(x)
    skip = pad(x, margins, lib)  # (B, X, Y, Z, f), all even
    x = layers.MaxPooling3D(2, name="pool")(skip)  # (B, X/2, Y/2, Z/2, f)
    x = conv(x, 2 * filters, "bottleneck_conv1")
    x = conv(x, 2 * filters, "bottleneck_conv2")  # (B, X/2, Y/2, Z/2, 2f)
    x = layers.UpSampling3D(2, name="upsample")(x)  # (B, X, Y, Z, 2f)
    x = conv(x, filters, "decoder_conv1")
    x = conv(x, filters, "decoder_conv2", kernel=2)
    x = layers.Concatenate(name="skip")([x, skip])  # (B, X, Y, Z, 2f)
    if any(high for _, high in margins):
        x = layers.Cropping3D(margins, name="crop")(x)  # (B, nx, ny, nz, 2f)
    x = conv(x, 2 * filters, "decoder_conv3")
    x = conv(x, filters, "decoder_conv4")
    x = conv(x, 3, "decoder_conv5", kernel=1, activation=None, dtype="float32")
    return lib.Model(force, displacement_layer(x, displacement_scale, mask, lib), name="unet")
