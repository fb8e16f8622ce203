"""Networks on remembered forces and on the elastic answer: in Keras, in LiteRT, and from a file
alone."""

import itertools
import subprocess
import sys

import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.online.input_field import FILE
from unet_fem.deployment import tflite as lite
from unet_fem.deployment.forms import graph_stepper
from unet_fem.deployment.twins import legacy_twin, rebuild
from unet_fem.metrics import relative_l2
from unet_fem.networks.files import save_model
from unet_fem.networks.layers import seeing
from unet_fem.networks.registry import CnnLstm, UNet, network
from unet_fem.networks.stepper import KerasStepper
from unet_fem.runtime.surrogate import Surrogate
from unet_fem.runtime.surrogate_file import FORMAT, FORMAT_2, read_surrogate, write_surrogate
from unet_fem.training.inputs import input_field
from unet_fem.training.samples import windows
from unet_fem.training.settings import InputChoice

OPTIONS = {"cnn_lstm": CnnLstm(4, 3), "unet": UNet(2)}
CHOICES = [InputChoice("creep"), InputChoice("window", "elastic"), InputChoice("creep", "elastic")]
CASES = list(itertools.product(OPTIONS, CHOICES))


@pytest.fixture(scope="module")
def dataset(tiny_dataset):
    return open_dataset(tiny_dataset)


@pytest.fixture(scope="module")
def force(dataset):
    return dataset.read("train")["force"]  # (I, F, nx, ny, nz, 3)


def built(dataset, kind, choice):
    keras.utils.set_random_seed(0)
    plain = network(kind).build(dataset.grid, OPTIONS[kind], (0.05, 0.01), dataset.free)
    return plain, seeing(plain, choice.memory == "creep", choice.physics == "elastic")


def surrogate(path, model, dataset, field, variant="float32"):
    shown = np.random.default_rng(0).normal(0, 0.02, (8, *model.input_shape[1:])).astype("float32")
    data = lite.export(model, variant, shown)
    write_surrogate(path, data, **lite.surrogate_facts(dataset, field))
    return path


@pytest.mark.parametrize("kind, choice", CASES)
def test_keras_graph_and_surrogate_answer_as_in_training(kind, choice, dataset, force, tmp_path):
    _, model = built(dataset, kind, choice)
    field = input_field(choice, dataset)
    seen = windows(field.sequences(force, 0.2), OPTIONS[kind].window)
    expected = np.asarray(model(seen))
    save_model(model, tmp_path / "best.keras")
    field.save(tmp_path / FILE, dataset.free)
    path = surrogate(tmp_path / "lite.tflite", model, dataset, field)
    bodies = {
        "keras": KerasStepper.open(tmp_path / "best.keras", 0.2),
        "graph": graph_stepper(model, 0.2, field),
        "surrogate": Surrogate(path),
    }
    size = np.abs(expected).max()
    for name, body in bodies.items():
        answers = []
        for interaction in force:
            body.reset()
            answers += [body.step(frame) for frame in interaction]
        np.testing.assert_allclose(answers, expected, atol=1e-5 * size, err_msg=name)
        kept = body.state()
        after = body.step(force[0, 1])
        body.step(force[0, 2])
        body.restore(kept)
        np.testing.assert_array_equal(body.step(force[0, 1]), after, err_msg=name)


@pytest.mark.parametrize("kind, choice", CASES)
def test_weights_and_layers_with_weights_are_those_of_the_plain_network(kind, choice, dataset):
    plain, model = built(dataset, kind, choice)
    assert model.count_params() == plain.count_params()
    assert [w.shape for w in model.get_weights()] == [w.shape for w in plain.get_weights()]
    again = rebuild(model, OPTIONS[kind])
    assert again.name == model.name and len(again.layers) == len(model.layers)
    twin = legacy_twin(model, OPTIONS[kind])  # what is pruned
    x = np.random.default_rng(0).normal(size=(2, *model.input_shape[1:])).astype("float32")
    np.testing.assert_allclose(twin(x), model(x), atol=1e-5)


def test_an_untrained_correction_of_nothing_is_the_elastic_answer(dataset, force):
    choice = InputChoice("creep", "elastic")
    _, model = built(dataset, "unet", choice)
    model.set_weights([0 * w for w in model.get_weights()])
    seen = input_field(choice, dataset).sequences(force, 0.2)[0]
    np.testing.assert_array_equal(model(seen), seen)


def test_int8_rounds_the_correction_and_not_the_elastic_answer(dataset, force, tmp_path):
    choice = InputChoice("creep", "elastic")
    _, model = built(dataset, "unet", choice)
    field = input_field(choice, dataset)
    exact, rounded = (
        Surrogate(surrogate(tmp_path / f"{variant}.tflite", model, dataset, field, variant))
        for variant in ("float32", "int8")
    )
    answers = [np.array([body.step(frame) for frame in force[0]]) for body in (exact, rounded)]
    elastic = field.sequences(force, 0.2)[0]
    of_correction = relative_l2(answers[1] - elastic, answers[0] - elastic)
    assert 0 < relative_l2(answers[1], answers[0]) < of_correction


def test_at_a_rate_the_memory_goes_by_its_calls(dataset, tmp_path):
    """Five calls in an interval: the memory is of all of them, the window of every fifth."""
    choice = InputChoice("creep")
    _, model = built(dataset, "cnn_lstm", choice)
    field = input_field(choice, dataset)
    body = Surrogate(surrogate(tmp_path / "lite.tflite", model, dataset, field), rate=25.0)
    calls = np.random.default_rng(0).normal(0, 0.01, (12, *dataset.grid, 3)).astype("float32")
    answers = [body.step(call) for call in calls]
    seen = field.sequences(calls[None], 0.04)[0]
    past = np.concatenate([np.zeros_like(seen[:10]), seen])
    window = np.stack([past[:12], past[5:17], past[10:]], axis=1)
    expected = np.asarray(model(window))
    np.testing.assert_allclose(answers, expected, atol=1e-5 * np.abs(expected).max())


def test_a_refused_force_leaves_window_and_memory_alone(dataset, force, tmp_path):
    choice = InputChoice("creep", "elastic")
    _, model = built(dataset, "unet", choice)
    path = surrogate(tmp_path / "a.tflite", model, dataset, input_field(choice, dataset))
    body, other = Surrogate(path), Surrogate(path)
    for each in (body, other):
        each.step(force[0, 1])
    deep = np.zeros_like(force[0, 1])
    deep[2, 2, 1] = 1e-3  # a free node inside
    for wrong in (deep, np.full_like(deep, np.nan)):
        with pytest.raises(InputError, match="contact surface|finite"):
            body.step(wrong)
    np.testing.assert_array_equal(body.step(force[0, 2]), other.step(force[0, 2]))
    with pytest.raises(InputError, match="not the state of a surrogate"):
        body.restore({"forces": other.state()["forces"]})


def test_a_model_without_its_field_is_refused(dataset, tmp_path):
    choice = InputChoice("creep", "elastic")
    plain, model = built(dataset, "unet", choice)
    save_model(model, tmp_path / "best.keras")
    for wrong in (
        lambda: KerasStepper.open(tmp_path / "best.keras"),
        lambda: KerasStepper(model, field=input_field(InputChoice("creep"), dataset)),
        lambda: KerasStepper(plain, field=input_field(choice, dataset)),
        lambda: graph_stepper(model),
    ):
        with pytest.raises(InputError, match="sees another input.*input.npz"):
            wrong()


def test_a_plain_surrogate_is_of_the_format_before(dataset, force, tmp_path):
    plain, model = built(dataset, "unet", CHOICES[0])
    body = Surrogate(surrogate(tmp_path / "a.tflite", plain, dataset, None))
    about = read_surrogate(tmp_path / "a.tflite")
    assert str(about["format"]) == FORMAT_2 and "input_creep" not in about
    assert body._field is None and body.state().keys() == {"forces"}
    field = input_field(CHOICES[0], dataset)
    path = surrogate(tmp_path / "b.tflite", model, dataset, field)
    assert str(read_surrogate(path)["format"]) == FORMAT


def test_its_runtime_needs_numpy_and_litert_alone(dataset, tmp_path):
    choice = InputChoice("creep", "elastic")
    _, model = built(dataset, "cnn_lstm", choice)
    path = surrogate(tmp_path / "a.tflite", model, dataset, input_field(choice, dataset))
    code = """
import sys
for name in "h5py keras scipy tensorflow".split():
    sys.modules[name] = None
import numpy as np
from unet_fem.runtime import Surrogate
body = Surrogate(sys.argv[1], rate=100.0)
print(body.step(np.zeros((*body.grid, 3))).shape == (*body.grid, 3))
"""
    run = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True)
    assert run.stdout.strip() == "True", run.stderr
