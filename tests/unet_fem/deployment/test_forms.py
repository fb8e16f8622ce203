"""The forms of a run: each a stepper, and all of one answer."""

import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.online.stepper import Stepper
from unet_fem.deployment.exported import lite_file
from unet_fem.deployment.forms import CALL, GRAPH, forms
from unet_fem.deployment.tflite import export, surrogate_facts
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.registry import CnnLstm
from unet_fem.runtime.surrogate_file import write_surrogate
from unet_fem.training.settings import Settings, TrainChoice


def test_every_form_of_a_run_is_a_stepper_and_all_answer_alike(tiny_dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dataset = open_dataset(tiny_dataset)
    settings = Settings("tiny", "", str(tiny_dataset), TrainChoice(1), CnnLstm(units=8, steps=2))
    scaled = {"force_scale": 0.05, "displacement_scale": 0.05, "mask": dataset.free}
    model = cnn_lstm(dataset.grid, 8, 2, **scaled)
    settings.folder.mkdir(parents=True)
    with pytest.raises(InputError, match="no model"):
        forms(settings, dataset)
    keras.saving.save_model(model, settings.folder / "best.keras")
    with pytest.raises(InputError, match="holds no .tflite files"):
        forms(settings, dataset)
    path = lite_file(settings, "float32")
    write_surrogate(path, export(model, "float32"), **surrogate_facts(dataset))

    steppers = {form: make() for form, make in forms(settings, dataset).items()}
    assert list(steppers) == [CALL, GRAPH, "float32"]
    answers = {}
    for form, stepper in steppers.items():
        assert isinstance(stepper, Stepper) and stepper.interval == 0.2
        answers[form] = [stepper.step(field) for field in dataset.read("train")["force"][0]]
    for form in (GRAPH, "float32"):
        largest = np.abs(answers[CALL]).max()
        np.testing.assert_allclose(answers[form], answers[CALL], atol=1e-5 * largest)
