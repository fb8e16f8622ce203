"""The networks: the paper's sizes, where they look, and that they compute the same wherever they
run."""

import subprocess
import sys

import keras
import numpy as np
import pytest
import tf_keras

from fem.errors import InputError
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.layers import float32_twin
from unet_fem.networks.registry import NETWORKS, network, resolve
from unet_fem.networks.unet import unet

SMALL = (9, 9, 5)


def forces(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape).astype("float32")


def small_mask(grid=SMALL, seed=1):
    return np.random.default_rng(seed).random(grid) > 0.4


def build(name, grid=SMALL, **options):
    """A network with random biases, so that what padding adds shows, and its forces for a batch of
    two."""
    keras.utils.set_random_seed(0)
    if name == "unet":
        model, x = unet(grid, 4, **options), forces(2, *grid, 3)
    else:
        cells = (grid[0] // 4) * (grid[1] // 4) * (grid[2] // 3)
        model, x = cnn_lstm(grid, 2 * cells, 3, **options), forces(2, 3, *grid, 3)
    model.set_weights(
        [w + 0.1 * forces(*w.shape, seed=n) for n, w in enumerate(model.get_weights())]
    )
    return model, x


@pytest.fixture
def bfloat16():
    keras.config.set_dtype_policy("mixed_bfloat16")
    yield
    keras.config.set_dtype_policy("float32")


@pytest.mark.parametrize(
    "units, steps, parameters",
    [
        (64, 2, 1_219_235),
        (128, 2, 2_501_155),
        (256, 2, 5_261_603),
        (512, 2, 11_568_931),
        (1024, 2, 27_329_315),
        (512, 3, 11_568_931),
        (512, 4, 11_568_931),
    ],
)
def test_cnn_lstm_has_the_papers_parameters(units, steps, parameters):
    with keras.StatelessScope(initialize_variables=False):  # counts without allocating
        model = cnn_lstm(units=units, steps=steps)
    assert model.count_params() == parameters
    assert model.input_shape == (None, steps, 17, 17, 8, 3)
    assert model.output_shape == (None, 17, 17, 8, 3)


AUTHORS_UNET = [  # the layers of the authors' code in their order: kernel and channels, or the name
    (3, 64),
    (3, 64),
    "Dropout",
    "MaxPooling3D",
    (3, 128),
    (3, 128),
    "UpSampling3D",
    (3, 64),
    (2, 64),
    "Concatenate",
    "Cropping3D",
    (3, 128),
    (3, 64),
    (1, 3),
]


def test_unet_is_the_authors_layer_by_layer():
    """A count of parameters sees neither padding nor order, so the list of layers is tested too."""
    model = unet()
    assert model.count_params() == 1_697_731
    assert model.input_shape == model.output_shape == (None, 17, 17, 8, 3)
    found = []
    for layer in model.layers:
        if isinstance(layer, keras.layers.Conv3D):
            size = set(layer.kernel_size)
            last = layer.filters == 3
            assert len(size) == 1 and layer.padding == "same" and set(layer.strides) == {1}
            assert layer.activation.__name__ == ("linear" if last else "relu")
            assert type(layer.kernel_initializer).__name__ == "HeNormal"
            found.append((size.pop(), layer.filters))
        elif type(layer).__name__ in AUTHORS_UNET and not layer.name.startswith("pad_"):
            found.append(type(layer).__name__)
    assert found == AUTHORS_UNET
    assert model.get_layer("dropout").rate == 0.5
    assert model.get_layer("pool").input.shape == (None, 18, 18, 8, 64)
    skip = model.get_layer("skip")
    assert [x.shape[-1] for x in skip.input] == [64, 64]
    assert skip.input[1] is model.get_layer("pool").input


def test_unet_pads_the_high_end_of_each_axis_after_the_dropout():
    model, x = build("unet", (9, 8, 7))
    padded = keras.Model(model.inputs, model.get_layer("pool").input)(x)
    plain = keras.Model(model.inputs, model.get_layer("dropout").output)(x)
    np.testing.assert_array_equal(padded[:, :9, :8, :7], plain)
    assert padded.shape[1:4] == (10, 8, 8)
    assert not np.any(padded[:, 9:]) and not np.any(padded[:, :, :, 7:])


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
@pytest.mark.parametrize("grid", [(9, 9, 5), (13, 11, 7), (8, 8, 6), (7, 10, 4)])
def test_graph_mode_equals_eager_on_any_grid(name, grid):
    model, x = build(name, grid)
    eager = keras.ops.convert_to_numpy(model(x))
    assert eager.shape == (2, *grid, 3)
    np.testing.assert_allclose(model.predict(x, verbose=0), eager, atol=1e-5)


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
def test_paper_grid_in_graph_mode_equals_eager(name):
    model, x = build(name, (17, 17, 8))
    np.testing.assert_allclose(model.predict(x, verbose=0), model(x), atol=1e-5)


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
def test_saved_model_is_whole(name, tmp_path):
    model, x = build(name, mask=small_mask(), force_scale=0.3, displacement_scale=1.7)
    model.save(tmp_path / "model.keras")
    loaded = keras.models.load_model(tmp_path / "model.keras")
    np.testing.assert_array_equal(loaded(x), model(x))


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
def test_layer_names_do_not_depend_on_what_was_built_before(name):
    first, second = build(name)[0], build(name)[0]
    assert [layer.name for layer in first.layers] == [layer.name for layer in second.layers]
    assert first.layers[-1].name == "displacement"


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
def test_fixed_and_void_nodes_are_exactly_zero(name):
    mask = small_mask()
    model, x = build(name, mask=mask)
    y = keras.ops.convert_to_numpy(model(x))
    assert np.all(y[:, ~mask] == 0)
    assert np.all(np.any(y[:, mask] != 0, axis=-1))


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
def test_scales_are_those_of_force_and_displacement(name):
    plain, x = build(name)
    scaled, _ = build(name, force_scale=4.0, displacement_scale=0.5)
    np.testing.assert_allclose(scaled(4 * x), 0.5 * plain(x), rtol=1e-5, atol=1e-6)


def test_mask_of_another_grid_is_refused():
    with pytest.raises(InputError, match=r"\(9, 9, 4\).*\(9, 9, 5\)"):
        unet(SMALL, 4, mask=np.ones((9, 9, 4)))


def layer_output(model, x, name):
    return keras.ops.convert_to_numpy(keras.Model(model.input, model.get_layer(name).output)(x))


def test_pooling_is_anchored_at_the_loaded_surface():
    """Of 8 layers the top six are pooled. The convolution reaches one layer further: only the
    deepest is unseen."""
    model, x = build("cnn_lstm", (17, 17, 8))
    rest = layer_output(model, x, "pool")
    changed = []
    for k in range(8):
        pushed = x.copy()
        pushed[:, :, :, :, k] += 1
        changed.append(
            np.any(layer_output(model, pushed, "pool") != rest, axis=(0, 1, 2, 4)).tolist()
        )
    assert changed[0] == [False, False]
    assert changed[1] == [True, False]  # by the convolution at layer 2
    assert changed[2:4] == [[True, False]] * 2
    assert changed[4:6] == [[True, True]] * 2  # neighbours across the cut between 2..4 and 5..7
    assert changed[6:8] == [[False, True]] * 2


def test_upsampled_block_is_anchored_at_the_loaded_surface():
    model, x = build("cnn_lstm", (17, 17, 8))
    block = layer_output(model, x, "pad_z")
    assert block.shape == (2, 17, 17, 8, 4)
    assert np.all(block[:, :, :, :2] == 0)
    assert np.all(block[:, :16, :16, 2:] != 0)


def test_unet_pools_the_loaded_surface_of_an_odd_depth_with_the_padding():
    """Of 5 layers the top one is pooled with the padding above it; two convolutions bring in the
    two below it, not the deepest."""
    model, x = build("unet")
    top = layer_output(model, x, "pool")[:, :, :, -1]
    for k in range(5):
        pushed = x.copy()
        pushed[:, :, :, k] += 1
        assert np.any(layer_output(model, pushed, "pool")[:, :, :, -1] != top) == (k >= 2)


def test_displacement_is_that_of_the_last_step():
    """The skip connection carries the last step: with the LSTM silenced no other step matters."""
    model, x = build("cnn_lstm")
    model.get_layer("bilstm").set_weights([0 * w for w in model.get_layer("bilstm").get_weights()])
    earlier, last = x.copy(), x.copy()
    earlier[:, :-1] += 1
    last[:, -1] += 1
    np.testing.assert_array_equal(model(earlier), model(x))
    assert np.any(np.not_equal(model(last), model(x)))


def test_units_that_do_not_fill_the_block_name_those_that_do():
    with pytest.raises(InputError, match=r"2 \* 500 .* 4 x 4 x 2 = 32 cells; use 496 or 512 units"):
        cnn_lstm(units=500)
    with pytest.raises(InputError, match="use 9 units"):
        cnn_lstm((12, 12, 5), units=8)
    with pytest.raises(InputError, match="3 x 17 x 8 is too small"):
        cnn_lstm((3, 17, 8))


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
def test_mixed_precision_ends_in_float32_and_has_a_float32_twin(name, bfloat16):
    mixed, x = build(name, mask=small_mask())
    convolutions = [layer.compute_dtype for layer in mixed.layers if "conv" in layer.name]
    assert convolutions[0] == "bfloat16" and convolutions[-1] == "float32"
    assert mixed(x).dtype == "float32"
    twin = float32_twin(mixed)
    assert {layer.compute_dtype for layer in twin.layers[1:]} == {"float32"}  # after the input
    keras.config.set_dtype_policy("float32")
    rebuilt, _ = build(name, mask=small_mask())
    np.testing.assert_array_equal(twin(x), rebuilt(x))
    assert np.abs(mixed(x) - twin(x)).max() < 0.05 * max(1, np.abs(twin(x)).max())


@pytest.mark.parametrize("name", ["unet", "cnn_lstm"])
def test_the_same_code_builds_a_model_of_keras_2(name):
    model, x = build(name, mask=small_mask(), force_scale=0.3, displacement_scale=1.7)
    row = NETWORKS[name]
    options = row.options(4) if name == "unet" else row.options(2 * 2 * 2, 3)
    twin = row.build(SMALL, options, (0.3, 1.7), small_mask(), lib=tf_keras)
    assert isinstance(twin, tf_keras.Model)
    twin.set_weights(model.get_weights())
    np.testing.assert_allclose(twin(x), model(x), atol=1e-5)


def test_every_row_names_functions_and_settings_that_exist():
    for kind, row in NETWORKS.items():
        options = row.options()
        assert options.kind == kind and row.label
        for reference in (row.builder, row.fitter, row.maker, row.stepper, row.thinner):
            assert reference is None or callable(resolve(reference))
        assert row.size is None or row.size in options.own()
        assert sum(map(bool, (row.builder, row.fitter, row.maker, row.stepper))) == 1
        assert row.fitted == bool(row.fitter or row.maker)


def test_a_row_builds_its_network_and_knows_what_fits():
    options = network("cnn_lstm").options(units=8, steps=3)
    built = network("cnn_lstm").build(SMALL, options, (0.3, 1.7))
    assert built.input_shape == (None, 3, *SMALL, 3) and options.window == 3
    assert built.get_layer("displacement").scale == 1.7
    with pytest.raises(InputError, match="use 2 or 4 units"):
        network("cnn_lstm").options(units=3).check(SMALL)
    with pytest.raises(InputError, match="units = 0"):
        network("cnn_lstm").options(units=0)
    with pytest.raises(
        InputError, match="resnet.*cnn_lstm, unet, linear, pod, constitutive, elastic"
    ):
        network("resnet")
    with pytest.raises(InputError, match="fitted, not trained"):
        network("linear").build(SMALL, network("linear").options())


def test_the_table_is_read_without_keras():
    code = (
        "import sys, unet_fem.networks.registry; assert not {'keras', 'scipy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
