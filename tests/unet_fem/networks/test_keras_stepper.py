"""A Keras network, called force by force, answers as it does to whole windows."""

import keras
import numpy as np
import pytest

from fem.errors import InputError
from fem.online.grid import NodeGrid
from fem.online.stepper import Stepper
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.files import save_model
from unet_fem.networks.stepper import KerasStepper
from unet_fem.networks.unet import unet
from unet_fem.training.samples import windows

GRID = (5, 4, 3)
FORCE = np.random.default_rng(0).normal(size=(6, *GRID, 3)).astype("float32")


@pytest.mark.parametrize("steps", [None, 3])
def test_steps_are_the_answers_to_the_windows(steps, tmp_path):
    keras.utils.set_random_seed(0)
    model = unet(GRID, 2) if steps is None else cnn_lstm(GRID, 4, steps)
    save_model(model, tmp_path / "model.keras")
    body = KerasStepper.open(tmp_path / "model.keras", interval=0.25)
    assert isinstance(body, Stepper)
    answers = [body.step(force, 0.25) for force in FORCE]
    np.testing.assert_allclose(answers, model(windows(FORCE[None], steps)), atol=1e-6)
    with pytest.raises(InputError, match="0.25 s between calls"):
        body.step(FORCE[0], 0.01)
    body.reset()
    np.testing.assert_array_equal(body.step(FORCE[0]), answers[0])


def test_forces_at_the_nodes_of_a_mesh_are_answered_there():
    index = np.array([3, 7, 50])
    body = KerasStepper(unet(GRID, 2), grid=NodeGrid(GRID, index))
    force = np.ones((3, 3))
    answer = body.step(force)
    whole = body.step(body.grid.to_grid(force))
    np.testing.assert_array_equal(answer, whole.reshape(-1, 3)[index])
