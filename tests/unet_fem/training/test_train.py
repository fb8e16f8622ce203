"""The chain from a scene file to an evaluated run, on a block of 4 x 4 x 2 cells."""

import json
import shutil

import h5py
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.data.scene import load_scene
from fem.errors import InputError
from unet_fem import evaluate, train
from unet_fem.training import samples as data
from unet_fem.training import settings as config
from unet_fem.training.judge import error_metrics
from unet_fem.training.run import ensure_dataset, prepare_folder

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
[health]
kinetic_share = 1.0
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


def stops_with(main, arguments, capsys, *words):
    """`main(arguments)` ends with exit code 2 and one line on stderr that holds all `words`."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    message = capsys.readouterr().err.strip()
    assert stop.value.code == 2
    assert message.startswith("error: ") and "\n" not in message
    for word in words:
        assert word in message


def test_windows_end_at_their_frame_and_begin_at_rest():
    force = (
        np.arange(2 * 3, dtype=float).reshape(2, 3, 1, 1, 1, 1) + 1
    )  # interactions 1 2 3 and 4 5 6
    assert data.windows(force, 2).reshape(6, 2).tolist() == [
        [0, 1],
        [1, 2],
        [2, 3],
        [0, 4],
        [4, 5],
        [5, 6],
    ]
    assert data.windows(force, None).ravel().tolist() == [1, 2, 3, 4, 5, 6]
    assert data.windows(force, 4).reshape(6, 4)[2].tolist() == [0, 1, 2, 3]


def test_batches_hold_every_sample_once_an_epoch_in_an_order_that_a_resumed_run_repeats():
    x = np.arange(10)
    stream = data.batches(x, x, 4, seed=3)
    epochs = [np.concatenate([next(stream)[0] for _ in range(3)]) for _ in range(3)]
    assert all(sorted(epoch) == list(x) for epoch in epochs)
    assert not np.array_equal(epochs[0], epochs[1])
    resumed = data.batches(x, x, 4, seed=3, first_epoch=2)
    assert np.array_equal(np.concatenate([next(resumed)[0] for _ in range(3)]), epochs[2])


@pytest.mark.parametrize("kind", ["lstm", "unet"])
def test_one_command_leaves_a_run_with_model_metrics_and_figures(folder, capsys, kind):
    metrics = train.main([f"{kind}.toml"])
    run, printed = folder / "runs" / kind, capsys.readouterr().out
    for name in (
        "config.toml",
        "history.json",
        "best.keras",
        "linear.keras",
        "checkpoint.weights.h5",
        "metrics.json",
        "tensorboard",
    ):
        assert (run / name).exists(), name
    for name in ("error_vs_depth", "bland_altman", "test_interactions", "fields"):
        assert (run / "figures" / f"{name}.png").stat().st_size > 10_000
    assert not list(run.glob(".partial*"))
    for name in ("linear regression", "hard (1 interactions)", "relative L2 %", "next: "):
        assert name in printed
    history = json.loads((run / "history.json").read_text())
    assert (
        len(history["gate_open"]) == 4
        and history["relative_error"][-1] < history["relative_error"][0]
    )
    before = json.loads((run / "metrics.json").read_text())
    evaluate.main([str(run)])
    assert json.loads((run / "metrics.json").read_text()) == before == metrics


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
    from unet_fem.training.losses import deformed_volume

    dataset = open_dataset("scene.h5")
    samples = data.load_samples(dataset, "test", None)
    faces = dataset.mesh.grid.index[dataset.mesh.boundary_faces]
    volume = np.asarray(deformed_volume(samples.displacement, dataset.points.reshape(-1, 3), faces))
    assert volume == pytest.approx(samples.volume, rel=1e-6)
    assert np.abs(samples.volume - 32).max() > 0.05  # it does change


def test_a_run_killed_in_an_epoch_and_resumed_ends_as_if_never_stopped(folder, monkeypatch):
    from unet_fem.training.checkpoint import Checkpoint, load_model

    train.main(["lstm.toml", "name=whole"])

    def killed(self, batch, logs=None):
        if self.model.optimizer.iterations == 2 * self.steps_per_epoch + 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(SystemExit) as stop:
        patch.setattr(Checkpoint, "on_train_batch_end", killed)
        train.main(["lstm.toml", "name=cut"])
    assert stop.value.code == 130
    assert len(json.loads((folder / "runs/cut/history.json").read_text())["loss"]) == 2
    train.main(["lstm.toml", "name=cut", "--resume"])
    whole, cut = (
        json.loads((folder / f"runs/{name}/history.json").read_text()) for name in ("whole", "cut")
    )
    assert cut["loss"] == pytest.approx(whole["loss"], rel=1e-4)
    pairs = zip(*(load_model(f"runs/{name}/best.keras").get_weights() for name in ("whole", "cut")))
    for a, b in pairs:
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
    stops_with(evaluate.main, ["runs/none"], capsys, "runs/none", "unet_fem.train")


def test_an_existing_run_is_neither_overwritten_nor_resumed_with_other_settings(folder, capsys):
    settings = config.load_settings("lstm.toml")
    prepare_folder(settings, resume=False)
    stops_with(train.main, ["lstm.toml"], capsys, "runs/lstm exists", "--resume")
    stops_with(train.main, ["lstm.toml", "train.epochs=9", "--resume"], capsys, "other settings")


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


def test_a_checkpoint_or_a_dataset_of_another_model_is_refused(folder, capsys):
    train.main(["lstm.toml", "train.epochs=1"])
    train.main(["unet.toml", "train.epochs=1"])
    capsys.readouterr()
    shutil.copy("runs/unet/checkpoint.weights.h5", "runs/lstm/checkpoint.weights.h5")
    stops_with(
        train.main,
        ["lstm.toml", "train.epochs=1", "--resume"],
        capsys,
        "checkpoint.weights.h5",
        "does not fit",
    )
    (folder / "scene.toml").write_text(SCENE.format(cells="5, 4, 2"))
    (folder / "scene.h5").unlink()
    ensure_dataset(config.load_settings("lstm.toml"))
    capsys.readouterr()
    stops_with(evaluate.main, ["runs/lstm"], capsys, "another grid")


def test_shipped_configurations_are_the_papers(request):
    root = request.config.rootpath
    scene = load_scene(root / "configs/tumour.toml")
    assert (scene.interactions.train + scene.interactions.validation) * scene.frames.count == 1512
    assert scene.interactions.train * scene.frames.count == 1218 and scene.interactions.test == 100
    assert scene.interactions.hard == (78, 85) and scene.interactions.hard_force == (1.3, 1.6)
    for name in ("quick", "paper"):
        settings = config.load_settings(root / f"configs/{name}.toml")
        assert settings.loss == config.LossChoice(0.1, 0.07, 0.0)
        load_scene(root / settings.scene)
    assert (settings.model.units, settings.model.steps) == (512, 2)


def test_direction_term_trains_when_it_is_switched_on(folder):
    train.main(["unet.toml", "name=directed", "loss.direction_weight=1e-3", "train.epochs=1"])
    history = json.loads((folder / "runs/directed/history.json").read_text())
    assert np.isfinite(history["loss"][0]) and history["loss"][0] > 1e-5


def test_forces_that_are_all_zero_are_named():
    nothing = np.zeros((2, 3, 3, 3, 3), "float32")
    with pytest.raises(InputError, match="contact.force"):
        data.scales(data.Samples(nothing, nothing, np.zeros(2), np.zeros(2, bool), np.ones(2)))
