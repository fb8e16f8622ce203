"""A run of a constitutive network, from a scene file to a comparison with those beside it."""

import io
import json
import runpy
import shutil
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.locks import lock
from fem.settings import dump_toml
from unet_fem import evaluate, open_stepper, train
from unet_fem.deployment import constitutive_run
from unet_fem.deployment.answers import muted
from unet_fem.deployment.comparison import unseen
from unet_fem.training import judge
from unet_fem.training.run import ensure_dataset, finished, read_settings
from unet_fem.training.settings import LossChoice, SampleChoice, Settings, load_settings

ROOT = Path(__file__).parents[3]
SCENE = {
    "mesh": {"kind": "box", "edge": 1e-3, "cells": [4, 4, 2]},
    "material": {"mu": 400.0, "nu": 0.42, "density": 1000.0, "prony": [[0.12, 330.0], [0.8, 11.0]]},
    "solver": {"kind": "quasistatic", "precision": "float32"},
    "frames": {"count": 4, "interval": 0.25},
    "contact": {
        **{"count": 2, "radius": [1.2e-3, 1.5e-3], "force": [0.1e-3, 0.6e-3]},
        **{"travel": [0.0, 1e-3], "ramp": [0.1, 0.2], "hold": [0.05, 0.1], "onset": [0.0, 0.1]},
    },
    "interactions": {
        **{"seed": 1, "train": 16, "validation": 1, "test": 2, "hard": [2, 2]},
        **{"hard_force": [1.1, 1.2], "hard_set": 3},
    },
    "health": {"confirm": 0},
}
SETTINGS = {
    "name": "tiny",
    "scene": "scene.toml",
    "data": "scene.h5",
    "samples": {"hard": 2},
    "model": {
        "kind": "constitutive",
        "modes": 40,
        "inputs": 20,
        "points": 24,
        "coarse": 4,
        "steps": 0,
    },
}
BESIDE = [
    {"model": {"kind": "linear"}},
    {"model": {"kind": "cnn_lstm", "units": 8}, "train": {"epochs": 1}},
]


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A folder with a scene, its dataset, and the settings of a run."""
    folder = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("scene.toml").write_text(dump_toml(SCENE))
        Path("run.toml").write_text(dump_toml(SETTINGS | {"beside": BESIDE}))
        ensure_dataset(load_settings("run.toml"))
    return folder


@pytest.fixture(scope="module")
def trained(scenes, tmp_path_factory):
    """(a folder with the finished run, what the command printed, its metrics)."""
    folder = tmp_path_factory.mktemp("trained")
    shutil.copytree(scenes, folder, dirs_exist_ok=True)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as said:
        patch.chdir(folder)
        metrics = train.main(["run.toml"])
    return folder, said.getvalue(), metrics


@pytest.fixture
def folder(scenes, tmp_path, monkeypatch):
    """A fresh copy of it, as the working directory."""
    shutil.copytree(scenes, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("UNET_FEM_CACHE", str(tmp_path / "cache"))
    return tmp_path


@pytest.fixture
def made(trained, tmp_path, monkeypatch):
    """(what the command printed, its metrics), in a copy of its folder."""
    shutil.copytree(trained[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return trained[1:]


def refused(arguments, capsys, *words):
    """`train.main(arguments)` ends in one line that holds all words."""
    with pytest.raises(SystemExit) as stop:
        train.main(arguments)
    message = capsys.readouterr().err.strip()
    assert stop.value.code == 2 and "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.slow
def test_one_command_makes_the_reduced_model_and_the_network_and_judges_it(made, monkeypatch):
    said, metrics = made
    run = Path("runs/tiny")
    for name in ("reduced.npz", "lite/network.npz", "lite/float32.tflite", "lite/float16.tflite"):
        assert (run / name).stat().st_size > 1000
    assert not list(run.glob(".partial*"))
    # metrics.json is what the file answers, interaction by interaction from rest
    dataset, stepper = open_dataset("scene.h5"), open_stepper(run / "lite/float32.tflite")
    wrong = size = 0.0
    for number in (1, 2):
        one = dataset.sequence("test", number)
        stepper.reset()
        with muted():
            answer = np.stack([stepper.step(force, 0.25) for force in one.force])
        wrong += np.sum((answer - one.displacement) ** 2)
        size += np.sum(one.displacement**2)
    error = metrics["constitutive"]["test"]["relative_l2"]
    assert error == pytest.approx(np.sqrt(wrong / size), rel=1e-4) and error < 0.1
    assert 'next: unet_fem.open_stepper("runs/tiny/lite/float32.tflite")' in said
    monkeypatch.setattr(judge.figures, "draw_all", lambda *given: None)
    evaluate.main(["runs/tiny"])
    assert json.loads((run / "metrics.json").read_text()) == metrics


@pytest.mark.slow
def test_models_beside_it_learn_from_the_same_and_are_compared_on_unseen_tests(made, capsys):
    said, _ = made
    rows = json.loads(Path("runs/tiny/comparison.json").read_text())
    assert list(rows) == ["constitutive network", "linear regression", "CNN-LSTM"]
    for name, row in rows.items():
        assert row["error"].keys() == {"usual", "hard"}
        assert 0 < row["p50"] <= row["p99"] and row["megabytes"] > 0
        line = next(line for line in said.splitlines() if line.startswith(name + " "))
        assert f"{100 * row['error']['hard']:.2f}" in line
    metrics = json.loads(Path("runs/tiny_linear/metrics.json").read_text())
    found = rows["linear regression"]["error"]
    assert found["hard"] == pytest.approx(metrics["linear"]["hard"]["relative_l2"], rel=1e-5)
    assert rows["constitutive network"]["error"]["usual"] < found["usual"]
    assert unseen(open_dataset("scene.h5")) == {"usual": [("test", 1)], "hard": [("test", 2)]}
    assert Path("runs/tiny/figures/comparison.png").stat().st_size > 10_000
    assert said.count("relative L2 %") == 0  # one table
    for number, what in enumerate(["data", "constitutive", "linear", "CNN-LSTM", "comparison"], 1):
        assert f"[{number}/5, after " in said and f"s] {what}" in said
    for run in load_settings("run.toml").others:
        assert finished(run) and run.samples == SampleChoice(hard=2)
        assert read_settings(run.folder) == run
    refused(["run.toml"], capsys, "runs/tiny", "finished")


@pytest.mark.slow
def test_an_interrupted_run_goes_on_and_ends_as_if_never_stopped(made, monkeypatch, capsys):
    whole = Path("runs/tiny/lite/network.npz").read_bytes()
    shutil.rmtree("runs/tiny/lite")
    for name in ("metrics.json", "comparison.json"):
        Path("runs/tiny", name).unlink()

    def stopped(*arguments):
        Path(arguments[2], "float32.tflite").write_text("begun")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(SystemExit) as stop:
        patch.setattr(constitutive_run, "make_network", stopped)
        train.main(["run.toml"])
    assert stop.value.code == 130 and "same command again" in capsys.readouterr().err
    assert not list(Path("runs/tiny").rglob("*.tflite"))
    Path("runs/tiny/.partial-killed").mkdir()
    monkeypatch.setattr(constitutive_run, "reduce", None)  # the reduced model is there already
    monkeypatch.setattr(train, "begun", None)  # and so are the runs beside it
    monkeypatch.setattr(judge.figures, "draw_all", lambda *given: None)
    before = Path("runs/tiny_cnn_lstm/metrics.json").stat().st_mtime_ns
    train.main(["run.toml"])
    assert Path("runs/tiny/lite/network.npz").read_bytes() == whole
    assert not list(Path("runs/tiny").glob(".partial*"))
    assert Path("runs/tiny_cnn_lstm/metrics.json").stat().st_mtime_ns == before
    assert finished(load_settings("run.toml"))


@pytest.mark.slow
def test_what_is_missing_alone_is_made_again(made, monkeypatch):
    Path("runs/tiny/comparison.json").unlink()
    shutil.rmtree("runs/tiny_linear")
    monkeypatch.setattr(constitutive_run, "make_network", None)
    monkeypatch.setattr(judge.figures, "draw_all", lambda *given: None)
    train.main(["run.toml", "--resume"])
    assert finished(load_settings("run.toml")) and Path("runs/tiny_linear/metrics.json").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["quantize", "prune", "benchmark"])
def test_tools_for_keras_models_name_the_files_that_are_there(made, capsys, tool):
    namespace = runpy.run_path(str(ROOT / f"tools/{tool}.py"))
    with pytest.raises(SystemExit):
        namespace["main"](["runs/tiny"])
    message = capsys.readouterr().err.strip()
    assert "runs/tiny/lite/float32.tflite" in message and "--beside" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "change",
    [
        *("loss.volume_weight=0.2", "input.memory='creep'", "input.physics='elastic'"),
        *("samples.each=2", "samples.split='frames'", "samples.seed=1"),
        *("train.epochs=3", "train.precision='mixed_bfloat16'", "model.units=8"),
    ],
)
def test_what_has_no_meaning_is_refused_by_name(folder, capsys, change):
    refused(["run.toml", change], capsys, change.partition("=")[0], "no meaning", "leave it out")
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    "change, words",
    [
        ("samples.hard=4", ("samples.hard = 4", "has 3 hard")),
        ("model.inputs=41", ("model.inputs = 41", "model.modes = 40")),
        ("model.points=0", ("model.points = 0",)),
        ("beside=3", ("beside = 3", "[[beside]]")),
        ("beside=[{model={kind='constitutive'}}]", ("beside", "'constitutive'", "one of each")),
        ("beside=[{model={kind='linear'},train={epochs=3}}]", ("train.epochs = 3", "'linear'")),
        ("beside=[{model={kind='unet',units=3}}]", ("model.units", "no meaning")),
        ("beside=[{modle={}}]", ("modle", "model")),
    ],
)
def test_settings_that_do_not_serve_are_refused_before_anything_is_made(
    folder, capsys, change, words
):
    refused(["run.toml", change], capsys, *words)
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    "table, own, word",
    [
        ("material", {"kind": "mooney_rivlin", "c10": 100.0, "c01": 100.0, "nu": 0.42}, "neo-Hook"),
        ("solver", {"mass_scaling": 4.0, "element": "reduced"}, "element = 'reduced'"),
        ("mesh", {"kind": "box", "edge": 1e-3, "cells": [4, 4, 2], "grid": [6, 6, 4]}, "grid"),
    ],
)
def test_a_scene_that_cannot_be_reduced_is_refused_before_it_is_simulated(
    folder, capsys, table, own, word
):
    own = own if table != "material" else own | {"density": 1000.0}
    Path("other.toml").write_text(dump_toml(SCENE | {table: own}))
    refused(["run.toml", "scene=other.toml", "data=other.h5"], capsys, word)
    assert not Path("other.h5").exists() and not Path("runs").exists()


@pytest.mark.slow
def test_elastic_tissue_is_served(folder):
    """Bug: a law without Prony terms had its points put in order too."""
    material = {name: value for name, value in SCENE["material"].items() if name != "prony"}
    Path("elastic.toml").write_text(dump_toml(SCENE | {"material": material}))
    words = ["run.toml", "scene=elastic.toml", "data=elastic.h5", "beside=[]"]
    metrics = train.main(words)
    assert metrics["constitutive"]["test"]["relative_l2"] < 0.1


def test_a_run_that_is_being_made_is_left_alone(folder, capsys):
    with lock(Path("runs/tiny")):
        refused(["run.toml"], capsys, "runs/tiny", "being written")


def test_python_builds_the_same_settings():
    own = load_settings(ROOT / "configs/constitutive.toml")
    again = Settings(own.name, own.scene, own.data, model=own.model, samples=own.samples)
    assert own == again
    with pytest.raises(InputError, match="loss.volume_weight = 1.0 has no meaning"):
        Settings("a", "b", "c", model=own.model, loss=LossChoice(1.0))
