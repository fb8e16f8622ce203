"""Time dependence: what `judge` calls memory is memory, and the elastic answer is the dataset's
tissue without it."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import keras
import numpy as np
import pytest

from fem import settings as config
from fem.data.build import generate
from fem.data.dataset import open_dataset
from fem.data.scene import Scene
from fem.errors import InputError, SolverStopped
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.files import save_model
from unet_fem.networks.unet import unet
from unet_fem.study import dataset as interactions
from unet_fem.study.measure import elastic as measure
from unet_fem.study.measure.creep import judge
from unet_fem.study.measure.elastic import elastic_answers
from unet_fem.study.measure.time_dependence import elastic_factor, run
from unet_fem.study.report.time_dependence import draw
from unet_fem.study.settings import Arm, Fem, Long, Main, Network, Stability, Study


@pytest.fixture
def made_up():
    """(time, truth, elastic): 3 interactions of 5 frames that creep at different times, the first
    frame at rest."""
    rng = np.random.default_rng(0)
    elastic = rng.normal(size=(3, 5, 60))
    elastic[:, 0] = 0
    creep = 1 + rng.uniform(0.1, 1.5, (3, 5, 1))
    return np.arange(5) * 0.25, creep * elastic + 0.02 * elastic[..., ::-1], elastic


def judged(made_up, answer):
    return judge(*made_up, {"answer": ("an answer", answer)})["answers"]["answer"]


def test_elastic_answer_is_all_lack_of_memory(made_up):
    _, truth, elastic = made_up
    found = judged(made_up, elastic)
    assert found["overall"] == pytest.approx(
        {"along": 1, "common": 1, "missed": 1, "creep": 1, "followed": 0}
        | {"relative_l2": found["overall"]["relative_l2"]}
    )
    assert found["overall"]["relative_l2"] == pytest.approx(
        np.linalg.norm(truth - elastic) / np.linalg.norm(truth)
    )
    assert judge(*made_up, {})["time_dependence"] == pytest.approx(found["overall"]["relative_l2"])


def test_truth_has_no_error_and_follows_itself(made_up):
    found = judged(made_up, made_up[1])
    assert found["overall"]["relative_l2"] == 0 and found["overall"]["along"] is None
    assert found["overall"]["missed"] == pytest.approx(0) and found["overall"][
        "followed"
    ] == pytest.approx(1)
    assert found["relative_l2"][0] is None and found["creep"][0] is None  # nothing has moved yet


def test_half_of_the_memory_is_half_missed(made_up):
    _, truth, elastic = made_up
    found = judged(made_up, elastic + 0.5 * (truth - elastic))
    assert found["missed"][1:] == pytest.approx([0.5] * 4) and found["common"][1:] == pytest.approx(
        [1] * 4
    )
    assert found["overall"]["followed"] == pytest.approx(0.5)


def test_an_error_across_the_time_dependence_is_not_counted_as_it(made_up):
    _, truth, elastic = made_up
    d, other = truth - elastic, np.random.default_rng(1).normal(size=truth.shape)
    other -= (
        np.divide(
            np.sum(other * d, -1, keepdims=True),
            np.sum(d * d, -1, keepdims=True),
            where=d.any(-1, keepdims=True),
            out=np.zeros((3, 5, 1)),
        )
        * d
    )
    found = judged(made_up, truth + 0.3 * other)["overall"]
    assert (
        found["relative_l2"] > 0.1
        and found["along"] < 1e-12
        and found["common"] < 1e-12
        and abs(found["missed"]) < 1e-6
    )


def test_errors_of_size_without_order_are_between_the_bounds(made_up):
    """Sizes wrong by chance lie along the time dependence, yet are no common lack of it: common <
    along."""
    _, truth, elastic = made_up
    signs = np.array([1, -1, 1])[:, None, None]
    found = judged(made_up, truth + 0.3 * signs * (truth - elastic))["overall"]
    assert found["along"] == pytest.approx(1) and found["common"] < 0.5


@pytest.fixture
def study(tiny, unseen_dataset, tmp_path, monkeypatch):
    """A study of untrained networks on the tiny scene, its files in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    scene = config.merge(tiny, {"interactions": {"test": 2, "hard": [2, 2], "hard_set": 1}})
    (tmp_path / "scene.toml").write_text(config.dump_toml(scene))
    shutil.copy(unseen_dataset, "tiny.h5")
    (tmp_path / "run.toml").write_text(
        'name = "run"\nscene = "scene.toml"\ndata = "tiny.h5"\n[model]\nunits = 4\n'
        "[train]\nepochs = 1\n"
    )
    dataset = open_dataset("tiny.h5")
    keras.utils.set_random_seed(0)
    networks = (
        Network("lstm", "run.toml"),
        Network("lstm_3", "run.toml", ("model.steps=3",)),
        Network("unet", "run.toml", ("model.kind=unet", "model.filters=2")),
    )
    scale = {"force_scale": 0.05, "displacement_scale": 0.05, "mask": dataset.free}
    for network in networks:
        steps = network.settings.model.window
        folder = tmp_path / network.settings.folder
        folder.mkdir(parents=True)
        (folder / "metrics.json").write_text("{}")
        (folder / "config.toml").write_text(network.settings.toml())
        save_model(
            cnn_lstm(dataset.grid, 4, steps, **scale) if steps else unet(dataset.grid, 2, **scale),
            folder / "best.keras",
        )
    return Study(
        name="study",
        networks=networks,
        main=(Main("CNN-LSTM", "lstm"), Main("U-Net", "unet")),
        configurations=("lstm",),
        deployed=("lstm",),
        physics=(Arm("a", ("lstm",)),),
        learning_rate=("lstm", "lstm_3"),
        window=("lstm", "lstm_3"),
        fem=Fem((1,)),
        stability=Stability((1,)),
        long=(Long("scene.toml", "tiny.h5"),),
    )


def test_run_judges_networks_beside_the_elastic_tissue_and_draws(study):
    """From networks and a scene to plain JSON without NaN and a figure; the elastic answers are
    simulated once."""
    result = run(study)
    json.dumps(result, allow_nan=False)
    short, long = result["parts"]
    for part in (short, long):
        assert set(part["answers"]) == {
            "elastic",
            "scaled",
            "lstm",
            "linear 2",
            "lstm_3",
            "linear 3",
            "unet",
            "linear 1",
        }
        assert part["creep"][-1] > 1.005  # half a second of creep
        assert (
            part["answers"]["elastic"]["overall"]["relative_l2"]
            < 0.2
            < part["answers"]["unet"]["overall"]["relative_l2"]
        )
    kept = {path: path.stat().st_mtime_ns for path in (study.cache / "elastic").iterdir()}
    # the usual test, the long ones, and what the factor is fitted to
    assert {path.name.rsplit("-", 1)[0] for path in kept} == {
        "test-0001",
        "test-0002",
        "validation-0001",
    }
    assert short["cases"] == ["test 1"] and short["solver"] == "explicit"
    elastic_answers(study, open_dataset("tiny.h5"), [("test", 1)])
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    figure = draw(json.loads(json.dumps(result)))
    assert len(figure.axes) == 6


def test_interaction_that_the_elastic_tissue_cannot_bear_is_left_out_and_named(
    tiny_dataset, tmp_path, monkeypatch
):
    dataset, study = open_dataset(tiny_dataset), SimpleNamespace(cache=tmp_path)

    def stop(*arguments):
        raise SolverStopped("inverted cell", "turned inside out")

    monkeypatch.setattr(interactions, "simulate", stop)
    monkeypatch.setattr(
        measure, "on_all_cores", lambda function, tasks, title: [function(*task) for task in tasks]
    )
    with pytest.raises(
        InputError, match="stops in every interaction asked of .*tiny.h5; lower contact.force"
    ):
        elastic_answers(study, dataset, [("test", 1)])
    (path,) = (study.cache / "elastic").iterdir()
    assert str(np.load(path)["stopped"]) == "inverted cell"


def test_long_scene_with_other_frames_is_refused(study, tiny, tmp_path):
    other = config.merge(tiny, {"frames": {"interval": 0.1}})
    (tmp_path / "other.toml").write_text(config.dump_toml(other))
    generate(config.build(Scene, other), tmp_path / "other.h5", workers=1)
    with pytest.raises(
        InputError, match="0.1 s apart.*give it the mesh and frames.interval of scene.toml"
    ):
        run(replace(study, long=(Long("other.toml", "other.h5"),)))


def test_the_factor_of_the_elastic_answer_is_fitted_to_validation_interactions(study, monkeypatch):
    """Bug: it was fitted to the very tests that it was judged on."""
    dataset, asked = open_dataset("tiny.h5"), []
    elastic = dataset.read("validation")["displacement"][0] / 1.5

    def answers(study, dataset, cases):
        asked.extend(cases)
        return {case: elastic for case in cases}, {}

    monkeypatch.setattr("unet_fem.study.measure.time_dependence.elastic_answers", answers)
    assert elastic_factor(study, dataset) == pytest.approx(1.5, rel=1e-5)
    assert asked == [("validation", 1)]


def test_an_untrained_network_is_left_out_and_its_window_with_it(study):
    (study.network("lstm_3").folder / "metrics.json").unlink()
    short = run(study)["parts"][0]
    assert "lstm_3" not in short["answers"] and "lstm" in short["answers"]
    assert short["window"] is None
