"""The chain from a scene file to an evaluated run, on a block of 4 x 4 x 2 cells."""

import json
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.data.scene import load_scene
from fem.errors import InputError
from fem.locks import lock
from fem.online.regression import Regression
from unet_fem import evaluate, train
from unet_fem.networks.layers import displacement_layer
from unet_fem.networks.registry import NETWORKS, Network, Options, UNet
from unet_fem.training import fit as training
from unet_fem.training import judge
from unet_fem.training import samples as data
from unet_fem.training import settings as config
from unet_fem.training.checkpoint import Checkpoint, load_model
from unet_fem.training.figures import interaction_curves
from unet_fem.training.fit import build_model, compile_model, fit
from unet_fem.training.judge import error_metrics
from unet_fem.training.losses import deformed_volume
from unet_fem.training.precision import precision
from unet_fem.training.run import (
    MESH,
    ensure_dataset,
    finished,
    open_run,
    prepare_folder,
    read_settings,
)

SCENE = """
[mesh]
kind = "box"
edge = 1e-3
cells = [{cells}]
[material]
mu = 400.0
nu = 0.42
density = 1000.0
prony = [[0.8, 11.0]]
[solver]
mass_scaling = 400.0
damping = 20.0
[frames]
count = 4
interval = 0.1
[contact]
count = 2
radius = [1.5e-3, 2e-3]
force = [0.2e-3, 1e-3]
ramp = [0.1, 0.2]
[interactions]
seed = 1
train = 4
validation = 2
test = 3
hard = [2, 2]
hard_set = 2
[health]
imbalance = 0.05
kinetic_share = 1.0
disequilibrium = 10.0
confirm = 0
"""
SETTINGS = """
name = "{name}"
scene = "scene.toml"
data = "scene.h5"
[model]
{model}
[train]
epochs = 4
batch_size = 4
learning_rate = 3e-3
"""
LSTM = 'kind = "cnn_lstm"\nunits = 8\nsteps = 2'
UNET = 'kind = "unet"\nfilters = 4'


@pytest.fixture(scope="module")
def scene_folder(tmp_path_factory):
    """A folder with a scene, its dataset, and two configurations."""
    folder = tmp_path_factory.mktemp("chain")
    (folder / "scene.toml").write_text(SCENE.format(cells="4, 4, 2"))
    (folder / "lstm.toml").write_text(SETTINGS.format(name="lstm", model=LSTM))
    (folder / "unet.toml").write_text(SETTINGS.format(name="unet", model=UNET))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        ensure_dataset(config.load_settings("lstm.toml"))
    return folder


@pytest.fixture
def folder(scene_folder, tmp_path, monkeypatch):
    """A fresh copy of the scene folder, as the working directory."""
    shutil.copytree(scene_folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def unjudged(monkeypatch):
    """Training ends without an evaluation, which takes longer than it."""
    monkeypatch.setattr(training, "evaluate", lambda settings, dataset, quiet: {})


def stops_with(main, arguments, capsys, *words):
    """`main(arguments)` ends with exit code 2 and one line on stderr that holds all `words`."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    message = capsys.readouterr().err.strip()
    assert stop.value.code == 2
    assert message.startswith("error: ") and "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("kind", ["lstm", "unet"])
def test_one_command_leaves_a_run_with_model_metrics_and_figures(folder, capsys, kind):
    metrics = train.main([f"{kind}.toml"])
    run, printed = folder / "runs" / kind, capsys.readouterr().out
    for name in (
        "config.toml",
        "history.json",
        "best.keras",
        "linear.npz",
        "checkpoint.npz",
        "metrics.json",
        "tensorboard",
    ):
        assert (run / name).exists(), name
    for name in ("error_vs_depth", "bland_altman", "test_interactions", "fields"):
        assert (run / "figures" / f"{name}.png").stat().st_size > 10_000
    assert not list(run.glob(".partial*"))
    for name in (
        "linear regression",
        "hard (1 interactions)",
        "hard set (2 interactions)",
        "next: ",
    ):
        assert name in printed
    assert metrics["FEM"].keys() == {"validation", "test", "hard", "hard set"}
    assert metrics[{"lstm": "cnn_lstm"}.get(kind, kind)]["hard set"]["relative_l2"] > 0
    history = json.loads((run / "history.json").read_text())
    assert (
        len(history["gate_open"]) == 4
        and history["relative_error"][-1] < history["relative_error"][0]
    )
    before = json.loads((run / "metrics.json").read_text())
    evaluate.main([str(run)])
    assert json.loads((run / "metrics.json").read_text()) == before == metrics


def test_a_scene_without_hard_interactions_is_judged_without_them(folder, capsys):
    text = Path("scene.toml").read_text().replace("hard = [2, 2]\nhard_set = 2\n", "")
    Path("soft.toml").write_text(text)
    metrics = train.main(
        ["lstm.toml", "model.kind=linear", "name=soft", "scene=soft.toml", "data=soft.h5"]
    )
    assert metrics["FEM"].keys() == {"validation", "test"}
    assert "hard" not in capsys.readouterr().out


def test_metrics_agree_with_their_definitions(folder):
    dataset = open_dataset("scene.h5")
    samples = data.load_samples(dataset, "test", None)
    shift = samples.displacement + np.where(dataset.free[..., None], [0.3, 0.4, 0.0], 0).astype(
        "float32"
    )
    metrics = error_metrics(shift, samples, dataset, samples.volume)
    for name in ("mean_mm", "p95_mm", "worst_mm"):
        assert metrics[name] == pytest.approx(0.5, rel=1e-5)
    size = np.sqrt(np.mean(np.sum(samples.displacement[:, dataset.free] ** 2, axis=-1)))
    assert metrics["relative_l2"] == pytest.approx(0.5 / size, rel=1e-5)
    assert metrics["volume_violation_max"] == pytest.approx(
        np.abs(samples.volume / 32.0 - 1).max(), rel=1e-9
    )  # 4 x 4 x 2 mm3


def test_volume_of_the_loss_is_the_volume_of_the_fem(folder):
    dataset = open_dataset("scene.h5")
    samples = data.load_samples(dataset, "test", None)
    faces = dataset.mesh.grid.index[dataset.mesh.boundary_faces]
    volume = np.asarray(deformed_volume(samples.displacement, dataset.points.reshape(-1, 3), faces))
    assert volume == pytest.approx(samples.volume, rel=1e-6)
    assert np.abs(samples.volume - 32).max() > 0.05  # it does change


@pytest.mark.slow
def test_an_interrupted_run_goes_on_by_the_same_command_and_ends_as_if_never_stopped(
    folder, monkeypatch, capsys, unjudged
):
    train.main(["lstm.toml", "name=whole"])

    def killed(self, batch, logs=None):
        if self.model.optimizer.iterations == 2 * self.steps_per_epoch + 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(SystemExit) as stop:
        patch.setattr(Checkpoint, "on_train_batch_end", killed)
        train.main(["lstm.toml", "name=cut"])
    assert stop.value.code == 130
    assert len(json.loads((folder / "runs/cut/history.json").read_text())["loss"]) == 2
    assert "give the same command again to go on" in capsys.readouterr().err
    train.main(["lstm.toml", "name=cut"])
    assert "going on after 2 of 4 epochs" in capsys.readouterr().out
    whole, cut = (
        json.loads((folder / f"runs/{name}/history.json").read_text()) for name in ("whole", "cut")
    )
    assert cut["loss"] == pytest.approx(whole["loss"], rel=1e-4)
    weights = [load_model(f"runs/{name}/best.keras").get_weights() for name in ("whole", "cut")]
    for a, b in zip(*weights, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)


def test_wrong_settings_are_one_line_with_the_remedy(folder, capsys):
    stops_with(train.main, ["lstm.toml", "train.epoch=3"], capsys, "train.epoch", "train.epochs")
    stops_with(
        train.main,
        ["lstm.toml", "train.epochs=many"],
        capsys,
        "train.epochs",
        "many",
        "whole number",
    )
    stops_with(train.main, ["lstm.toml", "model.kind=resnet"], capsys, "resnet", "cnn_lstm")
    stops_with(train.main, ["nowhere.toml"], capsys, "nowhere.toml", "lstm.toml")
    stops_with(train.main, ["lstm.toml", "unet.toml"], capsys, "one configuration file")
    stops_with(train.main, ["lstm.toml", "--resume"], capsys, "runs/lstm", "resume")
    stops_with(train.main, ["lstm.toml", "model.filters=8"], capsys, "model.filters", "unet")
    stops_with(train.main, ["unet.toml", "model.units=8"], capsys, "model.units", "cnn_lstm")
    stops_with(evaluate.main, ["runs/none"], capsys, "runs/none", "unet_fem.train")


def test_an_existing_run_is_neither_overwritten_nor_resumed_with_other_settings(folder, capsys):
    settings = config.load_settings("lstm.toml")
    prepare_folder(settings, open_dataset("scene.h5"))
    for resume in ([], ["--resume"]):
        stops_with(train.main, ["lstm.toml", "train.epochs=9", *resume], capsys, "other settings")
    stops_with(evaluate.main, ["runs/lstm"], capsys, "no model runs/lstm/best.keras")
    (folder / "runs/lstm/metrics.json").write_text("{}")
    (folder / "runs/lstm/history.json").write_text('{"loss": [1.0, 1.0, 1.0]}')
    assert not finished(settings)  # judged on the way
    (folder / "runs/lstm/history.json").write_text('{"loss": [1.0, 1.0, 1.0, 1.0]}')
    stops_with(train.main, ["lstm.toml"], capsys, "runs/lstm", "finished", "unet_fem.evaluate")


def test_a_run_of_another_mesh_is_refused_for_all_but_reading_its_settings(folder, capsys):
    """A run whose dataset was made again on another mesh, or that does not say on which it was
    trained, is neither resumed nor judged."""
    settings = config.load_settings("lstm.toml")
    prepare_folder(settings, open_dataset("scene.h5"))
    record = folder / "runs/lstm" / MESH
    assert record.read_text().strip() == open_dataset("scene.h5").mesh_digest
    assert open_run("runs/lstm")[0] == settings
    for text, word in (("0" * 64, "trained on another mesh"), (None, "before version 0.2")):
        record.unlink() if text is None else record.write_text(text)
        stops_with(train.main, ["lstm.toml", "--resume"], capsys, "runs/lstm", word)
        stops_with(evaluate.main, ["runs/lstm"], capsys, "runs/lstm", word)
        assert read_settings("runs/lstm") == settings


@pytest.mark.parametrize("old", ["first format", "another mesh"])
def test_a_dataset_for_reading_alone_is_not_learned_from(folder, capsys, old):
    """A file of the first format, or of this format and another mesh, opens; training, resuming
    and judging refuse it in one line."""
    prepare_folder(config.load_settings("lstm.toml"), open_dataset("scene.h5"))
    with h5py.File("scene.h5", "r+") as file:
        if old == "first format":
            file.attrs["format"] = "unet-fem dataset 1"
        else:
            file["mesh/points"][0, 0] -= 1e-10
            del file.attrs["mesh_digest"]  # as in files of before: it is no damage
    assert open_dataset("scene.h5").read("test", ("volume",))["number"].size == 3
    for arguments in (["unet.toml"], ["lstm.toml"], ["lstm.toml", "--resume"]):
        stops_with(train.main, arguments, capsys, "scene.h5", "reading only", "generate it again")
    stops_with(evaluate.main, ["runs/lstm"], capsys, "scene.h5", "reading only")


@pytest.mark.parametrize("damage", ["truncated", "other scene", "nan", "not hdf5"])
def test_a_dataset_that_does_not_serve_is_refused(folder, capsys, damage):
    path = folder / "scene.h5"
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:-20_000])
        words = ["scene.h5", "delete it"]
    elif damage == "not hdf5":
        path.write_text("nothing")
        words = ["scene.h5", "HDF5"]
    elif damage == "nan":
        with h5py.File(path, "r+") as file:
            file["displacement"][0, 1, 0, 0, 0] = np.nan
        words = ["scene.h5", "not finite", "displacement"]
    else:
        (folder / "scene.toml").write_text(
            SCENE.format(cells="4, 4, 2").replace("nu = 0.42", "nu = 0.40")
        )
        words = ["another scene", "scene.toml"]
    stops_with(train.main, ["lstm.toml"], capsys, *words)
    assert not (folder / "runs").exists()


def test_a_checkpoint_of_another_model_is_refused(folder, capsys, unjudged):
    train.main(["lstm.toml", "train.epochs=1"])
    train.main(["unet.toml", "train.epochs=1"])
    capsys.readouterr()
    shutil.copy("runs/unet/checkpoint.npz", "runs/lstm/checkpoint.npz")
    words = "checkpoint.npz", "does not fit"
    stops_with(train.main, ["lstm.toml", "train.epochs=1"], capsys, *words)


def test_a_model_of_another_grid_is_refused(folder):
    dataset = open_dataset("scene.h5")
    model = keras.Sequential([keras.Input((6, 5, 3, 3)), keras.layers.Rescaling(0.1)])
    with pytest.raises(InputError, match="trained on another grid or window"):
        judge.predict(model, data.load_samples(dataset, "test", None), dataset)


def test_shipped_configurations_are_the_papers(request):
    root = request.config.rootpath
    scene = load_scene(root / "configs/tumour.toml")
    assert (scene.interactions.train + scene.interactions.validation) * scene.frames.count == 1512
    assert scene.interactions.train * scene.frames.count == 1218 and scene.interactions.test == 100
    assert scene.interactions.hard == (78, 85) and scene.interactions.hard_force == (1.3, 1.6)
    assert scene.interactions.hard_set == 32
    for name in ("quick", "paper"):
        settings = config.load_settings(root / f"configs/{name}.toml")
        assert settings.loss == config.LossChoice(0.1, 0.07)
        load_scene(root / settings.scene)
    assert (settings.model.units, settings.model.steps) == (512, 2)


def test_a_run_that_is_being_trained_is_left_alone(folder, capsys):
    settings = config.load_settings("lstm.toml")
    with lock(settings.folder):
        stops_with(train.main, ["lstm.toml"], capsys, "runs/lstm", "being written")


def test_direction_term_trains_when_it_is_switched_on(folder, unjudged):
    train.main(["unet.toml", "name=directed", "loss.direction_weight=1e-3", "train.epochs=1"])
    history = json.loads((folder / "runs/directed/history.json").read_text())
    assert np.isfinite(history["loss"][0]) and history["loss"][0] > 1e-5


@pytest.mark.parametrize(
    "wrong, word",
    [("scene=nowhere.toml", "nowhere.toml"), ("data=nothing.h5", "HDF5")],
)
def test_a_refused_command_leaves_nothing_behind(folder, capsys, wrong, word):
    (folder / "nothing.h5").write_text("nothing")
    stops_with(train.main, ["lstm.toml", wrong], capsys, word)
    assert not (folder / "runs").exists()


def test_units_that_do_not_fit_are_refused_before_the_dataset_is_simulated(folder, capsys):
    (folder / "wide.toml").write_text(SCENE.format(cells="12, 8, 5"))
    wide = ["lstm.toml", "scene=wide.toml", "data=wide.h5"]
    stops_with(train.main, wide, capsys, "2 * 8 LSTM outputs", "3 x 2 x 2", "use 6 or 12 units")
    assert not (folder / "wide.h5").exists() and not (folder / "runs").exists()


@pytest.mark.slow
def test_regressions_are_runs_of_their_own(folder, capsys):
    linear = train(config.load_settings("lstm.toml", ["model.kind=linear", "name=linear"]))
    pod = train.main(["lstm.toml", "model.kind=pod", "model.modes=3", "model.steps=2", "name=pod"])
    assert set(linear) == {"linear", "FEM", "extremes"}
    assert set(pod) == {"pod", "linear regression", "FEM", "extremes"}
    assert read_settings("runs/linear").toml() == (folder / "runs/linear/config.toml").read_text()
    before = json.loads((folder / "runs/pod/metrics.json").read_text())
    evaluate.main(["runs/pod"])
    assert json.loads((folder / "runs/pod/metrics.json").read_text()) == before
    found = Regression.load("runs/pod/regression.npz")
    assert found.family == "POD + quadratic" and len(found.modes) == 3 and found.steps == 2
    assert found.interval == 0.1
    train.main(["lstm.toml", "train.epochs=1"])
    metrics = json.loads((folder / "runs/lstm/metrics.json").read_text())
    assert metrics["linear regression"]["test"] == pod["linear regression"]["test"]


@pytest.mark.slow
def test_a_linear_regression_that_an_old_run_lacks_is_fitted_again(folder):
    before = train.main(["unet.toml", "train.epochs=1"])
    (folder / "runs/unet/linear.npz").unlink()
    evaluate.main(["runs/unet"])
    after = json.loads((folder / "runs/unet/metrics.json").read_text())
    assert after["linear regression"] == before["linear regression"]


def test_a_first_epoch_without_a_finite_error_does_not_hide_the_best_model(folder):
    model = keras.Sequential([keras.Input((2,)), keras.layers.Dense(1)])
    model.compile("adam", "mse")
    checkpoint = Checkpoint(folder / "runs/nan", 1)
    checkpoint.set_model(model)
    for error in (np.nan, 0.5, 0.7, 0.4, np.nan):
        checkpoint.on_epoch_begin(0)
        checkpoint.on_epoch_end(0, {"val_relative_error": error})
        assert (folder / "runs/nan/best.keras").exists() == (len(checkpoint.history["seconds"]) > 1)
    assert checkpoint.best == 3


def test_training_that_diverges_says_so(folder, capsys):
    settings = config.load_settings("unet.toml", ["train.epochs=1"])
    dataset = open_dataset("scene.h5")
    samples = data.load_samples(dataset, "train", None)
    model = build_model(settings, dataset, *data.scales(samples))
    compile_model(model, settings, dataset, 1)
    model.set_weights([np.nan * w for w in model.get_weights()])
    with pytest.raises(InputError, match="diverged.*train.learning_rate = 0.003"):
        fit(model, settings, samples, samples)


def test_equal_settings_are_equal_however_they_were_built():
    assert config.TrainChoice(1, learning_rate=np.float64(1e-3)) == config.TrainChoice(1)
    assert config.LossChoice(volume_threshold=1) == config.LossChoice(volume_threshold=1.0)
    with pytest.raises(InputError, match="filters = 2.5 must be a whole number"):
        UNet(filters=2.5)


def test_volumes_are_taken_of_a_batch_at_a_time(folder, monkeypatch):
    dataset = open_dataset("scene.h5")
    samples = data.load_samples(dataset, "test", None)
    sizes = []

    def counted(field, *surface):
        sizes.append(len(field))
        return deformed_volume(field, *surface)

    monkeypatch.setattr(judge, "deformed_volume", counted)
    monkeypatch.setattr(judge, "BATCH", 5)
    model = keras.Sequential([keras.Input((*dataset.grid, 3)), keras.layers.Rescaling(0.1)])
    field, volume = judge.predict(model, samples, dataset)
    assert sizes == [5, 5, 2] and len(field) == len(volume) == len(samples)


def test_precision_is_restored():
    with pytest.raises(KeyError), precision("mixed_bfloat16"):
        assert keras.config.dtype_policy().name == "mixed_bfloat16"
        raise KeyError
    assert keras.config.dtype_policy().name == "float32"


def test_runs_of_before_are_opened_and_hold_their_own_options_alone(request):
    for path in sorted(request.config.rootpath.glob("docs/runs/*/config.toml")):
        settings = read_settings(path.parent)
        tree = tomllib.loads(path.read_text())["model"]
        assert settings.model.own().items() <= tree.items()
        assert ("filters" in settings.toml()) == (settings.model.kind == "unet")


def test_an_option_of_an_old_run_that_was_never_the_kinds_own_is_refused(folder):
    run = folder / "runs/old"
    run.mkdir(parents=True)
    text = SETTINGS.format(name="old", model=UNET + "\nunits = 512\nsteps = {}")
    (run / "config.toml").write_text(text.replace("{}", "2"))
    assert read_settings(run).model == UNet(filters=4)
    (run / "config.toml").write_text(text.replace("{}", "3"))
    with pytest.raises(InputError, match="model.steps = 3 .* leave it out"):
        read_settings(run)


def test_a_network_of_ones_own_is_a_row(folder, monkeypatch):
    @dataclass(frozen=True)
    class Plain(Options):
        kind: str = field(default="plain", init=False)
        width: int = 2

    def plain(grid, width, *, force_scale, displacement_scale, mask, lib):
        force = keras.Input((*grid, 3))
        x = keras.layers.Rescaling(1 / force_scale)(force)
        x = keras.layers.Conv3D(width, 3, padding="same")(x)
        x = keras.layers.Conv3D(3, 3, padding="same")(x)
        return keras.Model(force, displacement_layer(x, displacement_scale, mask), name="plain")

    monkeypatch.setitem(NETWORKS, "plain", Network("plain", Plain, builder=plain))
    metrics = train.main(["lstm.toml", "model.kind=plain", "model.width=3", "name=own"])
    assert metrics["plain"]["test"]["relative_l2"] < 1.5


def test_help_and_refusals_do_not_wait_for_keras():
    code = """
import sys
from unet_fem import evaluate, train
for main, words in ((train.main, ["nowhere.toml"]), (train.main, ["--help"]),
                    (evaluate.main, ["runs/none"]), (evaluate.main, ["--help"])):
    try:
        main(words)
    except SystemExit:
        pass
print({"keras", "tensorflow", "matplotlib"} & set(sys.modules))
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.endswith("set()\n")


def test_importing_the_figures_changes_neither_backend_nor_style():
    code = """
import matplotlib
before = matplotlib.rcParams["font.size"]
import unet_fem.training.figures, sys
assert matplotlib.rcParams["font.size"] == before and "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_gate_that_is_drawn_is_the_runs_own():
    line = np.array([1, 2])
    figure = interaction_curves(line, line[:1], line, {"FEM": 0.01 * line}, gate=0.025)
    assert "2.5 % gate" in [text.get_text() for text in figure.legends[0].get_texts()]
