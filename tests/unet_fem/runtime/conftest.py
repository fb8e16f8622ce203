"""A surrogate of the tiny dataset, and a constitutive network of random numbers."""

from pathlib import Path

import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.online.constitutive import save_constitutive
from fem.online.reduced_model import Block, ReducedModel
from unet_fem.deployment import tflite as lite
from unet_fem.deployment.constitutive_graph import export_constitutive
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.constitutive import ConstitutiveCell
from unet_fem.runtime.constitutive import write_constitutive
from unet_fem.runtime.surrogate_file import write_surrogate

PRONY = ((0.12, 330.0), (0.8, 11.0))
SIZES, SEEN, POINTS, COARSE, NODES, FORCED = (7, 5), (5, 4), 12, 4, 30, 9


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


@pytest.fixture(scope="session")
def make_network():
    """(folder, sides, ...) -> (cell, model, {"npz", "tflite": path}) of random numbers."""
    return _make_network


@pytest.fixture(scope="session")
def constitutive(tmp_path_factory):
    """That of a body with a mirror."""
    return _make_network(tmp_path_factory.mktemp("constitutive"), sides=2)


def _random_model(sides, prony=PRONY, per_point=False):
    """A ReducedModel of random arrays, whose step is a contraction."""
    rng = np.random.default_rng(3)

    def draw(scale, *shape):
        return (scale * rng.standard_normal(shape)).astype("float32")

    blocks = [
        Block(
            A=draw(0.05, 9 * POINTS, n),
            M=draw(0.01, R, 9 * POINTS + n),
            encoder=draw(0.3, R, 3 * FORCED),
            decoder=draw(0.3, 3 * 12, R),
            flexibility=np.eye(R, dtype="float32"),
            missing=draw(0.1, 3, 3 * FORCED),
        )
        for R, n in list(zip(SIZES, SEEN, strict=True))[:sides]
    ]
    mu = np.linspace(300, 500, sides * POINTS).tolist() if per_point else 400.0
    nu = np.linspace(0.3, 0.45, sides * POINTS).tolist() if per_point else 0.42
    law = {"kind": "neo_hooke", "mu": mu, "nu": nu, "density": 1000.0, "prony": list(prony)}
    nodes = rng.permutation(NODES)
    return ReducedModel(
        tuple(blocks),
        force=nodes[: sides * FORCED].reshape(sides, -1).astype("int32"),
        free=nodes[: sides * 12].reshape(sides, -1).astype("int32"),
        prony=np.array(prony, float).reshape(-1, 2),
        axis=0 if sides == 2 else None,
        grid=None,
        meta={"mesh": "m", "material": "t", "law": law, "nodes": NODES, "interval": 0.25},
    )


def _make_network(folder, **options):
    """(cell, model, {"npz": path, "tflite": path}) of a random network."""
    model, rng = _random_model(**options), np.random.default_rng(4)
    cell = ConstitutiveCell.of(model, COARSE)
    learned = {
        name: (value + 0.03 * rng.standard_normal(value.shape)).astype("float32")
        for name, value in cell.learned.items()
    }
    cell.learn(learned)
    learned["effort"] = np.array([1.0, 1.0])
    learned["guard"] = np.array(2 * [[0.01, 1.0, 1.0, 0.0, 100.0]])
    for b, R in enumerate(SIZES[: len(model.blocks)]):
        learned[f"V{b}"] = (0.02 * rng.standard_normal((R, R))).astype("float32")
    files = {kind: Path(folder, f"net.{kind}") for kind in ("npz", "tflite")}
    save_constitutive(files["npz"], model, learned)
    graph = export_constitutive(cell, model)
    write_constitutive(files["tflite"], graph, model.arrays() | learned)
    return cell, model, files
