"""A surrogate of the tiny dataset."""

import keras
import pytest

from fem.data.dataset import open_dataset
from unet_fem.deployment import tflite as lite
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.runtime.surrogate_file import write_surrogate


@pytest.fixture(scope="session")
def tiny_surrogate(tiny_dataset, tmp_path_factory):
    """The file of an untrained CNN-LSTM in float32 on the tiny dataset's grid."""
    dataset, path = open_dataset(tiny_dataset), tmp_path_factory.mktemp("runtime") / "tiny.tflite"
    keras.utils.set_random_seed(0)
    model = cnn_lstm(
        dataset.grid, 4, 2, force_scale=0.05, displacement_scale=0.05, mask=dataset.free
    )
    write_surrogate(path, lite.export(model, "float32"), **lite.surrogate_facts(dataset))
    return path
