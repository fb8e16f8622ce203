"""The command lines that make a run smaller, export it and time it, from end to end on an untrained
network of 5 x 5 x 3 nodes."""

import json
import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.reduce import main as reduce
from unet_fem.deployment import tflite as lite
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.runtime.surrogate import Surrogate
from unet_fem.training import settings as config
from unet_fem.training.checkpoint import load_model
from unet_fem.training.run import MESH

TOOLS = Path(__file__).parents[2] / "tools"
SETTINGS = """
name = "tiny"
scene = "tiny.toml"
data = "tiny.h5"
[model]
units = 64
steps = 2
[train]
epochs = 1
batch_size = 2
"""


@pytest.fixture(scope="module")
def folder(tiny_dataset, tmp_path_factory):
    """A working directory with the run runs/tiny."""
    folder = tmp_path_factory.mktemp("tools")
    run = folder / "runs/tiny"
    run.mkdir(parents=True)
    shutil.copy(tiny_dataset, folder / "tiny.h5")
    keras.utils.set_random_seed(0)
    cnn_lstm((5, 5, 3), 64, 2, force_scale=0.05, displacement_scale=0.05).save(run / "best.keras")
    (run / "config.toml").write_text(SETTINGS)
    (run / MESH).write_text(open_dataset(tiny_dataset).mesh_digest)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


def main(tool):
    return runpy.run_path(str(TOOLS / tool))["main"]


def alone(tool, *arguments):
    """Run the tool in a process of its own and return what it printed."""
    result = subprocess.run(
        [sys.executable, str(TOOLS / tool), *arguments],
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def parameters(run):
    return load_model(f"runs/{run}/best.keras").count_params()


@pytest.fixture(scope="module")
def quantized(folder):
    # the tiny test pushes twice as hard as the tiny training
    main("quantize.py")(["runs/tiny", "--windows", "6", "--margin", "3", "--layers"])
    return folder / "runs/tiny/lite"


def test_quantize_writes_four_surrogates_and_their_errors(quantized):
    figures = json.loads((quantized.parent / "quantization.json").read_text())
    assert {path.name for path in quantized.iterdir()} == {f"{v}.tflite" for v in lite.VARIANTS}
    assert figures["float32"]["keras_worst"] < 1e-5
    assert figures["int8"]["keras_relative_l2"] < 0.1
    assert figures["int8"]["fem_relative_l2"] == pytest.approx(
        figures["keras"]["fem_relative_l2"], rel=0.05
    )


def test_the_loss_by_layer_names_the_networks_layers(quantized):
    figures = json.loads((quantized.parent / "quantization.json").read_text())
    for variant in ("dynamic", "int8"):
        layers = figures[variant]["layers"]
        assert list(layers) == [
            "first_conv",
            "bilstm",
            "bilstm 2",
            "bilstm 3",
            "decoder_conv",
            "output_conv",
        ]
        assert all(0 < error < 0.1 for error in layers.values())


@pytest.mark.slow
def test_removing_units_leaves_a_smaller_run_that_every_tool_reads_and_is_made_once(folder, capsys):
    arguments = ["runs/tiny", "--filters", "--sparsity", "0.5", "--epochs", "2", "--rounds", "3"]
    main("prune.py")(arguments)
    assert parameters("tiny_thin50") < 0.6 * parameters("tiny")
    assert config.load_settings("runs/tiny_thin50/config.toml").model.units < 64
    figures = json.loads(Path("runs/tiny/pruning_filters.json").read_text())
    assert list(figures) == ["tiny", "tiny_thin50"] and figures["tiny"]["int8_speed-up"] == 1
    assert all(np.isfinite(value) for row in figures.values() for value in row.values())
    for variant in ("float32", "int8"):
        surrogate = Surrogate(f"runs/tiny_thin50/lite/{variant}.tflite")
        assert np.isfinite(surrogate.step(np.zeros((5, 5, 3, 3)))).all()
    made = Path("runs/tiny_thin50/best.keras").stat().st_mtime_ns
    capsys.readouterr()
    main("prune.py")(arguments)
    assert "done already" in capsys.readouterr().out
    assert Path("runs/tiny_thin50/best.keras").stat().st_mtime_ns == made
    Path("runs/tiny_thin50/pruned").write_text("of another")  # as if runs/tiny were trained again
    with pytest.raises(SystemExit):
        main("prune.py")(arguments)
    assert "of an older runs/tiny; delete it" in capsys.readouterr().err


@pytest.mark.slow
def test_zeros_reach_the_share_of_the_convolutions_that_was_asked_for(folder):
    printed = alone(
        "prune.py", "runs/tiny", "--sparsity", "0.8", "--epochs", "4", "--rounds", "3"
    )  # switches its process to Keras 2
    figures = json.loads(Path("runs/tiny/pruning_weights.json").read_text())
    assert figures["tiny"]["zeros"] < 0.01 and figures["tiny_pruned80"]["zeros"] == pytest.approx(
        0.8, abs=0.02
    )
    assert parameters("tiny_pruned80") == parameters("tiny")
    assert "| tiny_pruned80 |" in printed and "| 80 |" in printed


@pytest.mark.slow
def test_benchmark_times_every_form_of_a_run_with_the_same_threads(quantized, folder):
    sizes = ["--modes", "6", "--inputs", "6", "--points", "8"]
    reduce(["tiny.h5", *sizes, "--out", "reduced.npz"])
    beside = ["--beside", "reduced.npz", "runs/tiny/lite/int8.tflite"]
    options = ["--rounds", "3", "--soak", "200", "--out", "bench"]
    printed = alone("benchmark.py", "runs/tiny", *beside, *options)
    result = json.loads(Path("bench.json").read_text())
    variants = ["Keras call", "tf.function", *sorted(lite.VARIANTS)]
    expected = {
        *(f"tiny: {v}" for v in variants),
        *(f"tiny: {v}, graph alone" for v in lite.VARIANTS),
        "FEM: full float32, 10 ms",
        "FEM: reduced float32, 10 ms",
        "beside: reduced.npz",
        "beside: int8.tflite",
    }
    assert set(result["latency_ms"]) == expected
    assert all(
        0 < figures["p50"] <= figures["worst"] < 1e4 for figures in result["latency_ms"].values()
    )
    assert result["threads"] == result["machine"]["tensorflow_threads"] == 1
    assert result["latency_ms"]["tiny: tf.function"]["speed_up"] == 1
    assert 10 < result["latency_ms"]["tiny: int8"]["memory_MB"] < 500
    assert result["soak_ms"]["tiny: int8"]["steps"] == 200
    text = Path("bench.md").read_text()
    assert all(f"| {name} |" in text and f"| {name} |" in printed for name in expected)
    assert "Soak of tiny: int8, 200 steps" in text
