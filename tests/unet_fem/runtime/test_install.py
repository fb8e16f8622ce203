"""The base and the extra [runtime], as a wheel in a virtual environment of its own that has never
seen TensorFlow."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
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
HEAVY = "tensorflow keras tf_keras scipy h5py meshio matplotlib".split()
PROGRAM = f"""
import importlib.metadata, importlib.util, json
from pathlib import Path
import numpy as np
import fem, unet_fem

force, answer = (np.load(name) for name in ("force.npy", "answer.npy"))
surrogate = unet_fem.Surrogate("model.tflite")
assert isinstance(surrogate, fem.Stepper)
found = np.array([surrogate.step(field) for field in force])
np.testing.assert_allclose(found, answer, atol=1e-5 * np.abs(answer).max())
try:
    hint = fem.Solver
except ImportError as error:
    hint = str(error)
print(json.dumps({{
    "present": [name for name in {HEAVY} if importlib.util.find_spec(name)],
    "requires": importlib.metadata.requires("unet-fem"),
    "hint": hint,
    "files": [str(path) for path in importlib.metadata.files("unet-fem")],
    "folder": unet_fem.__file__,
}}))
"""


def quiet(*command, **options):
    """Run a command without this checkout on its path."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(command, capture_output=True, text=True, env=environment, **options)


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of a clean environment with the wheel of this checkout and [runtime]."""
    folder = tmp_path_factory.mktemp("install")
    project = folder / "project"  # a copy, for building leaves files behind
    for name in ("fem", "unet_fem"):
        shutil.copytree(
            ROOT / name, project / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
        )
    for name in ("setup.cfg", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, project)
    quiet(sys.executable, "-m", "venv", folder / "venv", check=True)
    python = folder / "venv/bin/python"
    pip = python, "-m", "pip"
    needs = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    fetched = quiet(*pip, "install", "-q", "--retries", "1", "--timeout", "15", "wheel", *needs)
    if fetched.returncode:
        pytest.skip(f"pip reaches no index: {fetched.stderr.strip().splitlines()[-1]}")
    build = "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder / "dist", project
    built = quiet(*pip, *build)
    assert not built.returncode, built.stderr
    (wheel,) = (folder / "dist").glob("unet_fem-*.whl")
    installed = quiet(*pip, "install", "-q", f"{wheel}[runtime]")
    assert not installed.returncode, installed.stderr
    quiet(*pip, "check", check=True)
    return python


@pytest.mark.slow
def test_the_runtime_installs_without_tensorflow_and_steps_as_keras_does(
    python, tiny_dataset, tmp_path
):
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

    run = quiet(python, "-c", PROGRAM, cwd=tmp_path)
    assert not run.returncode, run.stderr
    found = json.loads(run.stdout)
    assert found["present"] == []
    assert found["folder"].startswith(str(python.parents[1]))  # not this checkout
    assert found["hint"] == "fem.Solver needs scipy; pip install 'unet-fem[fem]'"
    for name in ("fem/py.typed", "fem/__init__.pyi", "unet_fem/py.typed", "unet_fem/__init__.pyi"):
        assert name in found["files"]
    assert not [name for name in found["files"] if name.startswith(("tests/", "tools/"))]
    plain = [line for line in found["requires"] if "extra ==" not in line]
    assert [line.split("<")[0].split(">")[0].strip() for line in plain] == ["numpy"]


@pytest.mark.timing
def test_the_runtime_imports_in_half_a_second(python):
    program = (
        "import time; start = time.process_time(); from unet_fem.runtime import Surrogate;"
        " print(time.process_time() - start)"
    )
    spent = [float(quiet(python, "-c", program, check=True).stdout) for _ in range(3)]
    assert min(spent) < 0.5
