"""The small install of the runtime, in a virtual environment of its own that has never seen
TensorFlow."""

import shutil
import subprocess
import sys
import tomllib
from configparser import ConfigParser
from pathlib import Path

import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from unet_fem.deployment import tflite as lite
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.runtime.surrogate_file import write_surrogate
from unet_fem.training.samples import windows

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "runtime/pyproject.toml").read_text())

STEP = """
import importlib.util, sys, time
start = time.process_time()
from unet_fem.runtime import Surrogate
spent = time.process_time() - start
import numpy as np
force, answer = (np.load(name) for name in ("force.npy", "answer.npy"))
surrogate = Surrogate("model.tflite")
found = np.array([surrogate.step(field) for field in force])
np.testing.assert_allclose(found, answer, atol=1e-5 * np.abs(answer).max())
present = [name for name in ("tensorflow", "keras", "tf_keras", "scipy", "h5py", "matplotlib") if importlib.util.find_spec(name)]
print(spent, present or "small", sys.modules["unet_fem"].__file__)
"""


def test_the_runtime_asks_for_what_the_whole_project_asks_for():
    whole = ConfigParser()
    whole.read(ROOT / "setup.cfg")
    lines = whole["options"]["install_requires"].strip().splitlines()
    project = PROJECT["project"]
    assert {*project["dependencies"], *project["optional-dependencies"]["replay"]} <= set(lines)
    assert (project["version"], project["requires-python"]) == (
        whole["metadata"]["version"],
        whole["options"]["python_requires"],
    )


def test_the_runtime_installs_without_tensorflow_and_steps_as_keras_does(tiny_dataset, tmp_path):
    dataset = open_dataset(tiny_dataset)
    keras.utils.set_random_seed(0)
    model = cnn_lstm(
        dataset.grid, 4, 2, force_scale=0.05, displacement_scale=0.05, mask=dataset.free
    )
    write_surrogate(
        tmp_path / "model.tflite", lite.export(model, "float32"), **lite.surrogate_facts(dataset)
    )
    force = dataset.read("train")["force"][:1]
    np.save(tmp_path / "force.npy", force[0])
    np.save(tmp_path / "answer.npy", model(windows(force, 2)))

    for name in ("fem", "unet_fem", "runtime"):  # a copy, for building leaves files behind
        shutil.copytree(
            ROOT / name,
            tmp_path / "project" / name,
            ignore=shutil.ignore_patterns("__pycache__", "build"),
        )
    environment = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    python = environment / "bin/python"
    pip = [python, "-m", "pip", "install", "-q", "--retries", "1", "--timeout", "15"]
    fetched = subprocess.run(
        [*pip, *PROJECT["project"]["dependencies"], *PROJECT["build-system"]["requires"]],
        capture_output=True,
        text=True,
    )
    if fetched.returncode:
        pytest.skip(f"pip reaches no index: {fetched.stderr.strip().splitlines()[-1]}")
    subprocess.run(
        [*pip, "--no-index", "--no-build-isolation", tmp_path / "project/runtime"], check=True
    )  # nothing else is needed
    subprocess.run([python, "-m", "pip", "check"], check=True)
    runs = [
        subprocess.run([python, "-c", STEP], cwd=tmp_path, capture_output=True, text=True)
        for _ in range(3)
    ]
    assert not any(run.returncode for run in runs), runs[0].stderr
    words = [run.stdout.split() for run in runs]
    assert {run[1] for run in words} == {"small"}
    assert all(run[2].startswith(str(environment)) for run in words)  # not this checkout
    assert min(float(run[0]) for run in words) < 0.5
