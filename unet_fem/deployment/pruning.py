"""Two ways to make a trained network smaller: zeros inside its convolutions, and fewer filters or
units.

`magnitude_prune` is the paper's way, by the TensorFlow Model Optimization toolkit: it works on
Keras 2 models only and switches its process to them, so keep it in a process of its own
(tools/prune.py). `thin` removes whole filters.
"""

import math
import sys
import types

import numpy as np

from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.unet import unet


def magnitude_prune(
    model,
    sparsity,
    inputs,
    targets,
    loss,
    *,
    epochs,
    batch_size=16,
    learning_rate=1e-4,
    precision="float32",
):
    """Fine-tune `model` while a polynomial schedule drives `sparsity` (0-1) of its convolutions'
    weights to zero.

    inputs, targets: training samples as `model.fit` takes them; loss(y_true, y_pred). The schedule
    ends at half of the epochs, and the rest recovers. precision: Keras's policy for the
    fine-tuning. Changes the weights of `model` in place.
    """
    import tensorflow_model_optimization as tfmot
    import tf_keras

    steps = -(-len(inputs) // batch_size) * epochs
    schedule = tfmot.sparsity.keras.PolynomialDecay(
        0.0, sparsity, 0, max(1, steps // 2), frequency=max(1, steps // 100)
    )

    def wrap(layer):
        if isinstance(layer, tf_keras.layers.Conv3D):
            # float32: masks and weights; under a mixed policy the wrapper would round the weights
            # in every step
            return tfmot.sparsity.keras.prune_low_magnitude(
                layer, pruning_schedule=schedule, dtype="float32"
            )
        return layer

    policy = tf_keras.mixed_precision.global_policy()
    tf_keras.mixed_precision.set_global_policy(precision)
    try:
        legacy = legacy_twin(model)
        twin = tf_keras.models.clone_model(legacy, clone_function=wrap)
        rate = tf_keras.optimizers.schedules.CosineDecay(learning_rate, steps)
        twin.compile(tf_keras.optimizers.Adam(rate, epsilon=1e-12), loss)
        tfmot.sparsity.keras.strip_pruning(twin).set_weights(
            legacy.get_weights()
        )  # clone_model copies the architecture alone
        twin.fit(
            inputs,
            targets,
            batch_size=batch_size,
            epochs=epochs,
            verbose=2,
            callbacks=[tfmot.sparsity.keras.UpdatePruningStep()],
        )
        model.set_weights(tfmot.sparsity.keras.strip_pruning(twin).get_weights())
    finally:
        tf_keras.mixed_precision.set_global_policy(policy)


def legacy_twin(model):
    """The same network and weights as a Keras 2 model (tf_keras), built by the same code."""
    import tensorflow
    import tf_keras

    modules = [sys.modules[f"unet_fem.networks.{name}"] for name in ("unet", "cnn_lstm", "layers")]
    legacy = {
        "keras": tf_keras,
        "layers": tf_keras.layers,
        "ops": types.SimpleNamespace(reshape=tensorflow.reshape),
    }
    saved = [
        {name: getattr(module, name) for name in legacy if hasattr(module, name)}
        for module in modules
    ]
    try:
        for module, names in zip(modules, saved):
            vars(module).update({name: legacy[name] for name in names})
        twin = rebuild(model)
    finally:
        for module, names in zip(modules, saved):
            vars(module).update(names)
    twin.set_weights(model.get_weights())
    return twin


def rebuild(model, filters=None, units=None):
    """A network like `model` with its scales and mask, and other `filters` (U-Net) or `units`
    (CNN-LSTM) if given."""
    scale = np.asarray(model.get_layer("displacement").scale, "float32")
    displacement_scale = float(np.abs(scale).max())
    common = {
        "force_scale": 1 / float(model.get_layer("force_scaled").scale),
        "displacement_scale": displacement_scale,
        "mask": scale[..., 0] != 0 if scale.ndim else None,
    }
    shape = model.input_shape[1:]
    if model.name == "unet":
        return unet(shape[:3], filters or model.get_layer("encoder_conv1").filters, **common)
    return cnn_lstm(
        shape[1:4], units or model.get_layer("bilstm").forward_layer.units, shape[0], **common
    )


def thin(model, size):
    """`model` with fewer filters (U-Net: `size` in the first convolution) or units (CNN-LSTM),
    keeping the weightiest.

    A filter counts by the L1 norm of its weights; a channel of the LSTM's block by the norm of the
    weights that read it.
    """
    small = rebuild(model, filters=size, units=size)
    (_thin_unet if model.name == "unet" else _thin_cnn_lstm)(model, small)
    return small


def _thin_unet(model, small):
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


def _thin_cnn_lstm(model, small):
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
