"""The weightiest part of a network put into a smaller one of its kind.

A filter counts by the L1 norm of its weights; a channel of the LSTM's block by the norm of the
weights that read it.
"""

import math

import keras
import numpy as np


def thin_unet(model: keras.Model, small: keras.Model) -> None:
    """Give `small`, a U-Net with fewer filters, the weightiest of `model`."""
    kept = {}  # layer name -> output channels that stay

    def shrink(name, incoming):
        kernel, bias = model.get_layer(name).get_weights()
        kernel = kernel[:, :, :, incoming]
        count = small.get_layer(name).filters
        kept[name] = _largest(np.abs(kernel).sum(axis=(0, 1, 2, 3)), count)
        small.get_layer(name).set_weights([kernel[..., kept[name]], bias[kept[name]]])
        return kept[name]

    x = np.arange(3)
    for name in (
        "encoder_conv1",
        "encoder_conv2",
        "bottleneck_conv1",
        "bottleneck_conv2",
        "decoder_conv1",
        "decoder_conv2",
    ):
        x = shrink(name, x)
    # the skip connection brings the second convolution's channels behind those of the decoder's
    # second
    x = np.concatenate([x, kept["encoder_conv2"] + model.get_layer("decoder_conv2").filters])
    for name in (f"decoder_conv{n}" for n in range(3, 6)):
        x = shrink(name, x)


def thin_cnn_lstm(model: keras.Model, small: keras.Model) -> None:
    """Give `small`, a CNN-LSTM with fewer units, the weightiest of `model`."""
    channels, count = (
        model.get_layer("block").target_shape[-1],
        small.get_layer("block").target_shape[-1],
    )
    kernel, bias = model.get_layer("decoder_conv").get_weights()
    norms = np.abs(kernel).sum(axis=(0, 1, 2, 4))
    # in a block of an odd number of cells the directions meet inside a cell: keep as many channels
    # of each
    halves = 1 + math.prod(model.get_layer("block").target_shape[:-1]) % 2
    keep = np.concatenate(
        [
            n * channels // halves + _largest(part, count // halves)
            for n, part in enumerate(np.split(norms, halves))
        ]
    )
    small.get_layer("decoder_conv").set_weights([kernel[:, :, :, keep], bias])
    for name in ("first_conv", "output_conv"):
        small.get_layer(name).set_weights(model.get_layer(name).get_weights())
    lstm = model.get_layer("bilstm")
    units = lstm.forward_layer.units
    # output u of the two directions side by side is channel u mod C of the block: keep the same
    # channels in every cell
    stays = np.isin(np.arange(2 * units) % channels, keep)
    weights = []
    for direction, half in (
        (lstm.forward_layer, stays[:units]),
        (lstm.backward_layer, stays[units:]),
    ):
        rows = np.flatnonzero(half)
        columns = np.concatenate([gate * units + rows for gate in range(4)])
        kernel, recurrent, bias = direction.get_weights()
        weights += [kernel[:, columns], recurrent[np.ix_(rows, columns)], bias[columns]]
    small.get_layer("bilstm").set_weights(weights)


def _largest(norms, count):
    """Indices of the `count` largest norms, in their order."""
    return np.sort(np.argsort(norms)[-count:])
