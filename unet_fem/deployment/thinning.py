"""Thinner networks: whole filters or units taken out, the weightiest kept."""

import math

import keras

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
