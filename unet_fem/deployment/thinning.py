"""Thinner networks: whole filters or units taken out, the weightiest kept.

A filter counts by the L1 norm of its weights; a channel of the LSTM's block by the norm of the
weights that read it.
"""

import math

import keras
import numpy as np

from fem.errors import InputError
from unet_fem.deployment.twins import rebuild
from unet_fem.networks.registry import Options, network


def thin(model: keras.Model, options: Options) -> keras.Model:
    """A network of `options`, of the same kind as `model` and of less size, that holds its
    weightiest part."""
    small = rebuild(model, options)
    network(options.kind).thin(model, small)
    return small


def smaller_size(model: keras.Model, options: Options, share: float) -> int:
    """The size, such as filters or units, that leaves about 1 - `share` of the parameters of
    `model`, a network of `options`. Raises InputError for a kind without one."""
    if options.kind == "cnn_lstm":
        return _fewer_units(model, share)
    row = network(options.kind)
    if row.size is None:
        raise InputError(f"a {row.label} cannot be made thinner")
    size = getattr(options, row.size)
    return max(1, round(size * math.sqrt(1 - share)))  # a layer inside holds size^2 weights


def _fewer_units(model, share):
    lstm = model.get_layer("bilstm").forward_layer
    units = lstm.units
    features = lstm.cell.kernel.shape[0] + 1  # and a bias: the LSTM has 8 N (features + N) weights
    goal = (1 - share) * units * (units + features)
    fewer = (math.sqrt(features**2 + 4 * goal) - features) / 2
    cells = math.prod(model.get_layer("block").target_shape[:-1])
    multiple = cells // math.gcd(2, cells)  # both directions' units fill the block's cells
    return max(multiple, round(fewer / multiple) * multiple)


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
    ):
        x = shrink(name, x)
    # the skip connection brings the second convolution's channels behind those of the first of the
    # decoder
    x = np.concatenate([x, kept["encoder_conv2"] + model.get_layer("decoder_conv1").filters])
    for name in (f"decoder_conv{n}" for n in range(2, 7)):
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
