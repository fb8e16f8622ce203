"""Pruned networks: zeros where they were asked for, and thin networks that compute what their
parents did."""

import keras
import numpy as np
import pytest

from unet_fem.deployment.pruning import magnitude_prune
from unet_fem.deployment.thinning import smaller_size, thin
from unet_fem.deployment.twins import legacy_twin
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.registry import CnnLstm, UNet
from unet_fem.networks.unet import unet

GRID = (9, 9, 5)
MASK = np.random.default_rng(0).random(GRID) > 0.3


def build(kind, size):
    scale = {"force_scale": 2.0, "displacement_scale": 0.1, "mask": MASK}
    return unet(GRID, size, **scale) if kind == "unet" else cnn_lstm(GRID, size, 2, **scale)


def options(kind, size):
    return UNet(filters=size) if kind == "unet" else CnnLstm(units=size, steps=2)


def silence(model, name, channels):
    """Make output `channels` of a convolution zero."""
    kernel, bias = model.get_layer(name).get_weights()
    kernel[..., channels], bias[channels] = 0, 0
    model.get_layer(name).set_weights([kernel, bias])


def outputs(model, seed=1):
    force = np.random.default_rng(seed).random((2, *model.input_shape[1:]), "float32")
    return np.asarray(model(force))


@pytest.mark.parametrize("kind, size", [("unet", 4), ("cnn_lstm", 8)])
def test_the_keras_2_twin_computes_the_same(kind, size):
    model = build(kind, size)
    force = np.random.default_rng(1).random((2, *model.input_shape[1:]), "float32")
    twin = legacy_twin(model, options(kind, size))
    np.testing.assert_array_equal(twin(force).numpy(), np.asarray(model(force)))
    assert type(twin).__module__.startswith("tf_keras")


def test_a_thin_unet_without_its_silent_filters_computes_the_same():
    model = build("unet", 8)
    for name in (
        "encoder_conv1",
        "encoder_conv2",
        "decoder_conv1",
        "decoder_conv2",
        "decoder_conv3",
    ):
        silence(model, name, slice(1, None, 2))
    for name in ("bottleneck_conv1", "bottleneck_conv2", "decoder_conv4"):
        silence(model, name, slice(0, None, 2))
    slim = thin(model, options("unet", 4))
    assert slim.count_params() < 0.3 * model.count_params()
    np.testing.assert_allclose(outputs(slim), outputs(model), atol=1e-8)


def test_a_thin_cnn_lstm_without_its_unread_units_computes_the_same():
    model = build("cnn_lstm", 16)  # a block of 2 x 2 x 1 cells with 8 channels
    kernel, bias = model.get_layer("decoder_conv").get_weights()
    kernel[:, :, :, ::2] = 0
    model.get_layer("decoder_conv").set_weights([kernel, bias])
    lstm, unread = model.get_layer("bilstm"), np.arange(16) % 2 == 0
    weights = lstm.get_weights()
    for recurrent in (weights[1], weights[4]):
        recurrent[unread] = 0
    lstm.set_weights(weights)
    slim = thin(model, options("cnn_lstm", 8))
    assert slim.get_layer("bilstm").forward_layer.units == 8
    np.testing.assert_allclose(outputs(slim), outputs(model), atol=1e-7)


@pytest.mark.parametrize(
    "grid, units", [((5, 5, 3), 12), ((12, 4, 3), 12)]
)  # blocks of one cell and of three
def test_a_thin_cnn_lstm_keeps_as_many_units_of_both_directions(grid, units):
    model = cnn_lstm(grid, units, 2)
    slim = thin(model, options("cnn_lstm", units // 2))
    assert slim.get_layer("bilstm").forward_layer.units == units // 2
    assert np.isfinite(outputs(slim)).all()


@pytest.mark.parametrize("grid, units", [((5, 5, 3), 64), ((17, 17, 8), 512)])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_units_are_chosen_for_the_share_of_parameters_on_any_grid(grid, units, share):
    model = cnn_lstm(grid, units, 2)
    small = cnn_lstm(grid, smaller_size(model, options("cnn_lstm", units), share), 2)
    left, whole = (network.get_layer("bilstm").count_params() for network in (small, model))
    assert left / whole == pytest.approx(1 - share, abs=0.02)


def test_filters_are_chosen_for_the_share_of_parameters():
    model = unet((17, 17, 8), 64)
    small = unet((17, 17, 8), smaller_size(model, UNet(filters=64), 0.5))
    assert small.count_params() / model.count_params() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    "kind, size, precision", [("unet", 4, "mixed_bfloat16"), ("cnn_lstm", 8, "float32")]
)
def test_magnitude_pruning_zeroes_the_share_that_was_asked_for(kind, size, precision):
    model = build(kind, size)
    rng = np.random.default_rng(2)
    force, target = (
        rng.random((8, *model.input_shape[1:]), "float32"),
        rng.random((8, *model.output_shape[1:]), "float32"),
    )
    magnitude_prune(
        model,
        options(kind, size),
        0.8,
        force,
        target,
        lambda a, b: keras.ops.mean(keras.ops.square(a - b)),
        epochs=8,
        batch_size=4,
        precision=precision,
    )
    convolutions = [layer for layer in model.layers if isinstance(layer, keras.layers.Conv3D)]
    assert len(convolutions) >= 3
    for layer in convolutions:
        kernel = layer.get_weights()[0]
        assert (kernel == 0).mean() == pytest.approx(0.8, abs=max(0.03, 1 / kernel.size)), (
            layer.name
        )
        assert np.any(kernel.view("uint32") & 0xFFFF), (
            layer.name
        )  # not rounded to bfloat16 on the way
