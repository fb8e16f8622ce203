"""The choice of what a model sees: as settings, as samples, and through a whole run."""

import dataclasses
import json

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.online.creep import Creep
from fem.online.input_field import FILE
from fem.online.regression import Regression, RegressionStepper
from unet_fem import evaluate, open_stepper, train
from unet_fem.deployment.quantize import quantize
from unet_fem.networks.registry import Elastic, Linear
from unet_fem.training import inputs
from unet_fem.training.inputs import input_field, run_input
from unet_fem.training.regressions import fit_regression
from unet_fem.training.run import open_run
from unet_fem.training.samples import load_samples, scales, training_samples
from unet_fem.training.settings import InputChoice, from_tree
from unet_fem.training.settings import Settings as RunSettings

TREE = {
    "name": "net",
    "scene": "scene.toml",
    "data": "tiny.h5",
    "model": {"kind": "unet", "filters": 2},
    "train": {"epochs": 2, "batch_size": 4},
}
CHOICES = [InputChoice("creep"), InputChoice("window", "elastic"), InputChoice("creep", "elastic")]


@pytest.fixture
def dataset(tiny_dataset):
    return open_dataset(tiny_dataset)


@pytest.fixture
def folder(dataset, tmp_path, monkeypatch):
    """A working directory with the tiny dataset and its scene."""
    (tmp_path / "scene.toml").write_text(dataset.scene.toml())
    (tmp_path / "tiny.h5").symlink_to(dataset.path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def settings(**tables):
    return from_tree(TREE | tables)


def test_plain_settings_are_written_as_before_and_others_are_read_again():
    assert "input" not in settings().toml()
    chosen = settings(input={"memory": "creep", "physics": "elastic"})
    assert 'memory = "creep"' in chosen.toml() and chosen.input == CHOICES[2]
    with pytest.raises(InputError, match="memory = 'creeps'|input.memory"):
        settings(input={"memory": "creeps"})
    with pytest.raises(InputError, match="no meaning for model.kind = 'linear'"):
        settings(model={"kind": "linear"}, input={"physics": "elastic"})


def test_a_plain_run_pays_nothing(dataset, folder, monkeypatch):
    monkeypatch.setattr(inputs, "input_field", lambda *_: pytest.fail("made an input"))
    assert run_input(settings(), dataset) is None
    samples = load_samples(dataset, "train", 2)
    assert samples.seen is None and samples.input is samples.force


@pytest.mark.parametrize("memory", ["window", "creep"])
def test_elastic_tissue_builds_no_memory(dataset, memory):
    material = dataclasses.replace(dataset.scene.material, prony=())
    scene = dataclasses.replace(dataset.scene, material=material)
    elastic = dataclasses.replace(dataset, scene=scene)
    assert input_field(InputChoice(memory), elastic) is None
    assert input_field(InputChoice(memory, "elastic"), elastic).state() == {}


@pytest.mark.parametrize("choice", CHOICES)
def test_samples_are_windows_of_the_field_beside_the_last_forces(dataset, choice):
    field = input_field(choice, dataset)
    samples, plain = (load_samples(dataset, "train", 2, own) for own in (field, None))
    np.testing.assert_array_equal(samples.last_force, plain.last_force)
    seen = field.sequences(dataset.read("train")["force"], 0.2)
    np.testing.assert_array_equal(samples.last_input, seen.reshape(-1, *seen.shape[2:]))
    some = samples.select(slice(2))
    assert some.input.shape == (2, 2, *dataset.grid, 3) and len(some.force) == 2
    size = scales(samples, corrects=field.corrects)[1]
    rest = samples.displacement - samples.last_input * field.corrects
    assert size == pytest.approx(np.sqrt(np.mean(rest[rest != 0].astype(float) ** 2)))


def test_a_fitted_regression_carries_its_memory(dataset, tmp_path):
    field = input_field(InputChoice("creep"), dataset)
    model = fit_regression(dataset, Linear(), field=field)
    np.testing.assert_array_equal(model.creep, Creep.of(dataset.scene.material.prony).array)
    samples = training_samples(dataset, None, field)[0]
    model.save(tmp_path / "regression.npz")
    body = RegressionStepper.open(tmp_path / "regression.npz")
    answers = []
    for interaction in dataset.read("train")["force"]:
        body.reset()
        answers += [body.step(frame) for frame in interaction]
    size = np.abs(samples.displacement).max()
    np.testing.assert_allclose(answers, model(samples.input), atol=1e-5 * size)
    assert fit_regression(dataset, Elastic()).creep is None


@pytest.mark.slow
@pytest.mark.parametrize("choice", CHOICES)
def test_a_network_goes_from_training_to_a_surrogate(choice, folder, dataset):
    table = {"memory": choice.memory, "physics": choice.physics}
    chosen = settings(input=table)
    metrics = train(chosen)
    other = "elastic answer" if choice.physics == "elastic" else "linear regression"
    assert {"unet", other, "FEM", "extremes"} == set(metrics)
    run = folder / "runs/net"
    assert (run / FILE).is_file() and evaluate(run) == json.loads(json.dumps(metrics))
    (run / FILE).unlink()  # made again from the dataset
    assert evaluate(run)["unet"]["test"] == pytest.approx(metrics["unet"]["test"], rel=1e-5)
    opened, data = open_run(run)
    quantize(opened, data, count=4)
    force = dataset.read("test")["force"][0]
    bodies = [
        open_stepper(run / "best.keras", interval=0.2),
        open_stepper(run / "lite/float32.tflite"),
    ]
    answers = [np.array([body.step(frame) for frame in force]) for body in bodies]
    np.testing.assert_allclose(*answers, atol=1e-5 * np.abs(answers[0]).max())
    found = json.loads((run / "quantization.json").read_text())
    assert found["float32"]["keras_relative_l2"] < 1e-5
    assert found["keras"]["fem_relative_l2"] == pytest.approx(
        metrics["unet"]["test"]["relative_l2"], rel=1e-4
    )


@pytest.mark.slow
def test_regressions_and_the_elastic_answer_are_runs(folder, dataset):
    fitted = {"input": {"memory": "creep"}, "train": {}}  # in closed form: it has no epochs
    linear = settings(model={"kind": "linear"}, name="lin", **fitted)
    elastic = settings(model={"kind": "elastic"}, name="el", **fitted)
    assert "linear" in train(linear) and "elastic" in train(elastic)
    for name in ("lin", "el"):
        made = Regression.load(f"runs/{name}/regression.npz")
        assert made.creep is not None and made.elastic == (name == "el")
        assert open_stepper(f"runs/{name}/regression.npz").memory is not None
        assert not (folder / "runs" / name / FILE).exists()
    assert isinstance(linear, RunSettings) and linear.fitted and elastic.fitted
