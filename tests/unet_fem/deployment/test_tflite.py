"""The exported networks: that they are what Keras trained, in operators that a CPU runs fast."""

import keras
import numpy as np
import pytest
import tensorflow as tf
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError
from unet_fem.deployment import tflite as lite
from unet_fem.deployment.tflite_graph import audit
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.layers import float32_twin
from unet_fem.networks.unet import unet

SMALL = (9, 9, 5)


def forces(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape).astype("float32")


def build(name, grid=SMALL):
    """A small network with random biases, scales and mask, and its force windows for a batch of
    eight."""
    keras.utils.set_random_seed(0)
    mask = np.random.default_rng(1).random(grid) > 0.4
    scaled = {"force_scale": 0.5, "displacement_scale": 0.3, "mask": mask}
    if name == "unet":
        model, x = unet(grid, 4, **scaled), forces(8, *grid, 3)
    else:
        cells = (grid[0] // 4) * (grid[1] // 4) * (grid[2] // 3)
        model, x = cnn_lstm(grid, 2 * cells, 3, **scaled), forces(8, 3, *grid, 3)
    model.set_weights(
        [w + 0.1 * forces(*w.shape, seed=n) for n, w in enumerate(model.get_weights())]
    )
    return model, x


def run(data, windows):
    net = Interpreter(model_content=data)
    net.allocate_tensors()
    answers = []
    for window in windows:
        net.set_tensor(net.get_input_details()[0]["index"], window[None])
        net.invoke()
        answers.append(net.get_tensor(net.get_output_details()[0]["index"])[0])
    return np.array(answers)


def worst(values, reference):
    """Largest error, as a fraction of the largest displacement."""
    reference = np.asarray(reference)
    return np.abs(values - reference).max() / np.abs(reference).max()


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
@pytest.mark.parametrize("grid", [(9, 9, 5), (8, 8, 6), (7, 10, 4)])
def test_float32_equals_keras_on_any_grid(name, grid):
    model, x = build(name, grid)
    assert worst(run(lite.export(model, "float32"), x), model(x)) < 1e-5


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
@pytest.mark.parametrize("variant, limit", [("float16", 2e-3), ("dynamic", 8e-2), ("int8", 8e-2)])
def test_smaller_variants_stay_close_to_keras(name, variant, limit):
    model, x = build(name)
    data = lite.export(model, variant, lite.calibration_windows(x, margin=1.0))
    answer, keras_answer = run(data, x), np.asarray(model(x))
    assert worst(answer, keras_answer) < limit
    assert not answer[:, ~np.any(keras_answer, axis=(0, -1))].any()  # the mask is exact


@pytest.mark.slow
def test_paper_cnn_lstm_is_a_quarter_in_int8_weights_and_close_to_keras():
    keras.utils.set_random_seed(0)
    model, x = cnn_lstm(), forces(2, 2, 17, 17, 8, 3)
    data = lite.export(model, "dynamic")
    assert len(data) < 1.05 * model.count_params()
    assert worst(run(data, x), model(x)) < 3e-2


def test_mixed_precision_model_is_exported_in_float32():
    keras.config.set_dtype_policy("mixed_bfloat16")
    try:
        model, x = build("unet")
    finally:
        keras.config.set_dtype_policy("float32")
    assert worst(run(lite.export(model, "float32"), x), float32_twin(model)(x)) < 1e-5


def test_export_leaves_the_model_as_it_was():
    model, x = build("cnn_lstm")
    before, layers = np.asarray(model(x)), [layer.output.shape for layer in model.layers]
    lite.export(model, "float32")
    np.testing.assert_array_equal(model(x), before)
    assert [layer.output.shape for layer in model.layers] == layers


def test_int8_with_margin_does_not_clip_forces_beyond_training():
    model, x = build("unet")
    error = {}
    for margin in (1.0, 1.5):
        data = lite.export(model, "int8", lite.calibration_windows(x, margin=margin))
        error[margin] = worst(run(data, 1.4 * x), model(1.4 * x))
    assert error[1.5] < 0.5 * error[1.0]


def naive(model, *ops):
    converter = tf.lite.TFLiteConverter.from_keras_model(model)
    converter.target_spec.supported_ops = [tf.lite.OpsSet.TFLITE_BUILTINS, *ops]
    return converter.convert()


def test_audit_catches_conv_3d_and_flex():
    inputs = keras.Input((6, 6, 6, 2), batch_size=1)
    conv = keras.Model(inputs, keras.layers.Conv3D(2, 3, padding="same")(inputs))
    with pytest.raises(InputError, match="int8: operator CONV_3D stays float32"):
        audit(naive(conv), "int8")
    pool = keras.Model(inputs, keras.layers.MaxPooling3D(2)(inputs))
    with pytest.raises(InputError, match="float32: operator FlexMaxPool3D is not builtin"):
        audit(naive(pool, tf.lite.OpsSet.SELECT_TF_OPS), "float32")


def test_audit_catches_float_weights_and_activations():
    model, _ = build("unet")
    with pytest.raises(InputError, match="dynamic: CONV_2D '.*' has no int8 weights"):
        audit(lite.export(model, "float32"), "dynamic")
    with pytest.raises(InputError, match="int8: CONV_2D '.*' has no int8 activations"):
        audit(lite.export(model, "dynamic"), "int8")


def test_what_cannot_be_exported_is_named():
    inputs = keras.Input((6, 6, 6, 2))
    strided = keras.Model(
        inputs, keras.layers.Conv3D(2, 3, strides=2, padding="same", name="odd")(inputs)
    )
    with pytest.raises(InputError, match="layer odd"):
        lite.export(strided, "float32")
    with pytest.raises(InputError, match="variant 'int4' is not one of float32"):
        lite.export(strided, "int4")
    with pytest.raises(InputError, match="calibrated on force windows"):
        lite.export(strided, "int8", np.zeros((4, 6, 6, 6, 2)))
