"""One registry of everything that answers forces call by call."""

import subprocess
import sys

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.regression import Regression, RegressionStepper
from unet_fem.networks.files import save_model
from unet_fem.networks.stepper import KerasStepper
from unet_fem.networks.unet import unet
from unet_fem.steppers import STEPPERS, _named, open_stepper, stepper

GRID = (4, 4, 3)


def regression():
    mask = np.ones(GRID, bool)
    return Regression(mask, np.arange(9), np.ones((9, 3 * mask.size), "float32"))


def test_a_file_is_opened_by_its_kind(tmp_path):
    regression().save(tmp_path / "regression.npz")
    save_model(unet(GRID, 1), tmp_path / "best.keras")
    assert isinstance(open_stepper(tmp_path / "regression.npz"), RegressionStepper)
    body = open_stepper(tmp_path / "best.keras", interval=0.25)
    assert isinstance(body, KerasStepper) and body.interval == 0.25
    for name in ("best.h5", "folder"):
        with pytest.raises(InputError, match=r"\.keras \(Keras\), \.tflite \(LiteRT\), \.npz"):
            open_stepper(tmp_path / name)


def test_an_object_is_taken_by_its_kind():
    assert isinstance(stepper("regression", regression()), RegressionStepper)
    assert isinstance(stepper("keras", unet(GRID, 1)), KerasStepper)
    known = "keras, litert, regression, reduced, elastic, fem"
    with pytest.raises(InputError, match=f"'modal' is not one of {known}"):
        stepper("modal")


def test_every_row_names_what_exists():
    for kind in STEPPERS.values():
        assert callable(_named(kind.make)) and kind.label
        assert kind.opener is None or callable(_named(kind.opener))


def test_the_registry_is_read_without_anything_heavy():
    heavy = "{'keras', 'scipy', 'h5py', 'ai_edge_litert'}"
    code = f"import sys, unet_fem.steppers; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
