"""Errors of the competitors, their intervals, the regressions and the paper's figures, on 4 x 4 x 2
cells and made-up numbers."""

import dataclasses
import json
from functools import partial
from types import SimpleNamespace

import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.files import write_text
from fem.online.regression import RegressionStepper
from unet_fem.deployment.answers import answers
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.files import save_model
from unet_fem.networks.pod import linear, predict, reduced, truncated
from unet_fem.study.dataset import headline, unseen
from unet_fem.study.measure import accuracy, statistics
from unet_fem.study.measure.judged import judged, unseen_cases, unseen_samples
from unet_fem.study.report import bars, sections
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import Fem
from unet_fem.study.steppers import Competitor, followed, networks, remembering
from unet_fem.training.depth import by_depth, normalised_depth
from unet_fem.training.samples import Samples, load_samples
from unet_fem.training.settings import InputChoice

MASK = np.zeros((3, 3, 2), bool)
MASK[1:, :, 1] = True


def made_up(count, seed, quadratic=0.0, largest=1.0, frames=2):
    """Samples on a 3 x 3 x 2 grid: an answer of rank 4 to the last two forces and to their
    squares."""
    fixed, rng = np.random.default_rng(7), np.random.default_rng(seed)
    force = np.zeros((count, frames, *MASK.shape, 3), "float32")
    force[:, :, 1, 1:, 1] = rng.uniform(-largest, largest, (count, frames, 2, 3))
    f = force[:, :, 1, 1:, 1].reshape(count, -1).astype(float)
    z = f @ fixed.normal(size=(f.shape[1], 4))
    u = z @ fixed.normal(size=(4, 18)) + quadratic * f**2 @ fixed.normal(
        size=(f.shape[1], 4)
    ) @ fixed.normal(size=(4, 18))
    displacement = np.zeros((count, *MASK.shape, 3), "float32")
    displacement[:, MASK] = u.reshape(count, -1, 3)
    return Samples(force, displacement, np.arange(count), np.zeros(count, bool), np.ones(count))


def error(model, samples):
    return np.linalg.norm(predict(model, samples.force) - samples.displacement) / np.linalg.norm(
        samples.displacement
    )


@pytest.fixture(scope="module")
def linear_case():
    train, validation = made_up(60, 1), made_up(20, 2)
    full = linear(train, validation, MASK)
    return full, *reduced(full, train, validation, 6), train, validation


def test_pod_with_all_modes_of_a_linear_response_finds_it(linear_case):
    full, reduced, _, _, _ = linear_case
    unseen = made_up(30, 3)
    assert error(full, unseen) < 1e-4 and error(reduced, unseen) < 1e-4
    assert reduced.parameters < full.parameters
    assert 0.05 < error(truncated(reduced, 2), unseen) < error(truncated(reduced, 1), unseen)


def test_pod_is_the_linear_regression_projected_on_its_modes(linear_case):
    full, reduced, _, _, validation = linear_case
    answer = predict(full, validation.force)[:, MASK].reshape(len(validation), -1)
    modes = truncated(reduced, 3).modes
    np.testing.assert_allclose(modes @ modes.T, np.eye(3), atol=1e-6)
    projected = predict(truncated(reduced, 3), validation.force)[:, MASK].reshape(
        len(validation), -1
    )
    np.testing.assert_allclose(
        projected, answer @ modes.T @ modes, atol=1e-5 * np.abs(answer).max()
    )


def test_quadratic_terms_find_a_quadratic_part_and_carry_it_beyond_the_training_forces():
    train, validation, strong = (
        made_up(200, 1, 0.1),
        made_up(60, 2, 0.1),
        made_up(40, 3, 0.1, largest=1.5),
    )
    full = linear(train, validation, MASK)
    plain, quadratic = reduced(full, train, validation, 8)
    assert plain.family == "POD" and quadratic.family == "POD + quadratic"
    assert error(quadratic, validation) < 0.1 * error(plain, validation)
    assert error(quadratic, strong) < 0.1 * error(plain, strong)


def test_no_force_moves_nothing_and_held_nodes_stay(linear_case):
    *models, _, validation = linear_case
    for model in models[:3]:
        assert not predict(model, np.zeros_like(validation.force)).any()
        assert not predict(model, validation.force)[:, ~MASK].any()


def test_a_regression_as_a_stepper_answers_as_on_whole_windows(linear_case):
    full, _, quadratic, _, validation = linear_case
    forces = validation.force[:3, 0]
    for model in (full, quadratic):
        own = Competitor("regression", model.family, partial(RegressionStepper, model))
        padded = np.concatenate([np.zeros_like(forces[:1]), forces])
        windows = np.stack([padded[:-1], padded[1:]], axis=1)
        np.testing.assert_allclose(
            answers(own.make(), forces[None]), predict(model, windows), atol=1e-6
        )


def test_a_remembering_regression_answers_a_held_force_with_more_and_more(unseen_dataset):
    dataset = open_dataset(unseen_dataset)
    found = remembering(SimpleNamespace(pod_modes=(2, 900)), dataset)
    assert list(found) == [
        "linear regression, remembered force",
        "POD + quadratic, 2 modes, remembered force",
    ]
    own = found["linear regression, remembered force"]
    assert (own.family, own.interactions) == ("linear, remembered force", 2)
    force = dataset.read("train", ("force",))["force"][0, -1:]
    answer = followed(own.make(), np.repeat(force, 5, axis=0), 0.2)
    assert (np.diff(np.square(answer).sum(axis=(1, 2, 3, 4))) > 0).all()
    scene = dataclasses.replace(dataset.scene, material=dataset.scene.material.elastic())
    elastic = dataclasses.replace(dataset, scene=scene)
    assert remembering(SimpleNamespace(pod_modes=(2,)), elastic) == {}


def test_frame_by_frame_is_the_batched_prediction(tiny_dataset, tmp_path):
    """Why the accuracy stage may predict in batches."""
    dataset = open_dataset(tiny_dataset)
    keras.utils.set_random_seed(0)
    scale = {"force_scale": 0.05, "displacement_scale": 0.05, "mask": dataset.free}
    save_model(cnn_lstm(dataset.grid, 4, 2, **scale), tmp_path / "best.keras")
    settings = SimpleNamespace(
        name="run",
        folder=tmp_path,
        input=InputChoice(),
        model=SimpleNamespace(kind="cnn_lstm", window=2),
    )
    samples = load_samples(dataset, "test", 2)
    batched = accuracy.keras_answer(tmp_path / "best.keras", samples, dataset)
    competitors = networks(settings, None, dataset)
    assert list(competitors) == [f"run: {KERAS}", "run: Keras call"]
    for competitor in competitors.values():
        one_by_one = answers(competitor.make(), dataset.read("test")["force"])
        np.testing.assert_allclose(one_by_one, batched, atol=1e-6 * np.abs(batched).max())


def test_interval_holds_the_truth_in_about_95_of_100_cases():
    rng, inside = np.random.default_rng(1), 0
    for _ in range(100):
        truth = rng.uniform(1, 3, 40)
        inside += (
            (found := statistics.interval((truth * rng.uniform(0, 0.02, 40))[None], truth))["low"]
            <= 0.1
            <= found["high"]
        )
    assert 86 <= inside <= 100


def test_a_paired_difference_is_far_surer_than_the_errors_themselves():
    rng = np.random.default_rng(2)
    truth = rng.uniform(1, 10, 50)
    base = truth * rng.lognormal(-3, 1, 50)
    better = base * rng.uniform(0.75, 0.87, 50)
    own, found = (
        statistics.interval(better[None], truth),
        statistics.difference(better[None], base[None], truth),
    )
    assert found["low"] < found["difference"] < found["high"] < 0
    assert found["high"] - found["low"] < 0.25 * (own["high"] - own["low"])
    assert found["change"] == pytest.approx(-0.1, abs=0.02)


def test_equal_models_differ_by_nothing_and_one_interaction_has_no_interval():
    truth = np.arange(1.0, 6.0)
    same = statistics.difference(truth[None] / 9, truth[None] / 9, truth)
    assert (same["difference"], same["low"], same["high"]) == (0, 0, 0)
    assert statistics.interval(np.array([[0.04]]), np.array([4.0])) == {
        "relative_l2": pytest.approx(0.1),
        "low": None,
        "high": None,
    }


def test_a_better_model_has_a_negative_difference_with_an_interval_around_it():
    truth = np.linspace(1, 2, 30)
    noise = np.random.default_rng(0).uniform(0.5, 1.5, 30)
    better = statistics.difference([0.01 * truth * noise], [0.04 * truth * noise], truth)
    assert better["low"] < better["difference"] < better["high"] < 0
    single = statistics.difference(np.array([[0.01]]), np.array([[0.04]]), np.array([1.0]))
    assert single["difference"] == pytest.approx(-0.1) and single["low"] is single["high"] is None


def test_seeds_count_by_the_mean_of_their_errors():
    truth = np.ones(10)
    seeds = np.array([0.01 * truth, 0.09 * truth])
    assert statistics.interval(seeds, truth)["relative_l2"] == pytest.approx((0.1 + 0.3) / 2)


def test_error_by_depth_is_that_of_the_layer(tiny_dataset):
    dataset = open_dataset(tiny_dataset)
    truth = load_samples(dataset, "test", None).displacement
    wrong = truth.copy()
    top = dataset.free.copy()
    top[:, :, :-1] = False
    wrong[:, top] += np.array([0.3, 0.0, 0.4], "float32")
    found = by_depth(dataset, wrong, truth)
    assert found["depth"][0] == 0 and found["mean_mm"][0] == pytest.approx(0.5, rel=1e-5)
    assert found["mean_mm"][1:] == pytest.approx([0] * (len(found["depth"]) - 1))


def test_depth_begins_at_the_loaded_surface_whatever_is_void_above_it():
    """Bug: on the published mesh, whose grid has a void layer above, it began at 1/7."""
    mask = np.ones((3, 3, 8), bool)
    mask[:, :, 7] = False
    free = mask.copy()
    free[:, :, 0] = False
    depth = normalised_depth(SimpleNamespace(mask=mask, free=free, grid=mask.shape))
    np.testing.assert_allclose(np.unique(depth.round(6)), np.arange(6) / 6, atol=1e-6)


def test_judged_sums_give_the_errors_and_a_bad_answer_is_refused(unseen_dataset):
    """Each error is of its own interactions alone: usual ones 10 % off, the hard test 30 %, the one
    of the hard set 50 %."""
    dataset = open_dataset(unseen_dataset)
    samples, frames = unseen_samples(dataset), len(dataset.time)
    assert unseen_cases(dataset) == [("test", 1), ("test", 2), ("hard", 1)]
    off = np.repeat([0.1, 0.3, 0.5], frames).astype("float32").reshape(-1, 1, 1, 1, 1)
    truth = samples.displacement
    found = judged((1 + off) * truth, dataset, samples, {("test", 1): truth[:frames] * 1.2})
    assert found["usual"]["relative_l2"] == pytest.approx(0.1, rel=1e-4)
    assert found["usual"]["count"] == 1 and found["usual"]["low"] is None
    assert found["hard"]["count"] == 2 and found["hard"]["median"] == pytest.approx(0.4, rel=1e-4)
    squares = np.array([found["sums"][case] for case in ("test 2", "hard 1")]).sum(axis=0)
    assert found["hard"]["relative_l2"] == pytest.approx(np.sqrt(squares[0] / squares[1]))
    assert 0.3 < found["hard"]["relative_l2"] < 0.5
    assert np.sqrt(np.divide(*found["reference"]["test 1"])) == pytest.approx(0.1 / 1.2, rel=1e-4)
    depth = np.array(found["depth"]["relative_l2"], float)
    assert depth[~np.isnan(depth)] == pytest.approx(0.1, rel=1e-3)  # of the usual ones alone
    assert list(found["violation"]) == ["test 1", "test 2", "hard 1"]
    json.dumps(found, allow_nan=False)
    with pytest.raises(InputError, match="not finite"):
        judged(np.full_like(truth, np.nan), dataset, samples, {})


def test_usual_and_hard_are_disjoint_and_hold_all_that_is_unseen(unseen_dataset):
    """Bug: "unseen" held the hard ones, and the headline number 80."""
    dataset = open_dataset(unseen_dataset)
    subsets = unseen(dataset)
    assert subsets == {"usual": [("test", 1)], "hard": [("test", 2), ("hard", 1)]}
    study = SimpleNamespace(fem=Fem((1,), hard=1))
    assert headline(study, dataset) == {"usual": [("test", 1)], "hard": [("test", 2)]}
    for numbers, remedy in (((1, 2), "has 2, a hard one"), ((5,), "no test interaction 5")):
        with pytest.raises(InputError, match=remedy):
            headline(SimpleNamespace(fem=Fem(numbers)), dataset)


def test_errors_are_of_their_subsets_with_a_median_and_intervals():
    sums = {f"test {n}": [0.01 * n, float(n)] for n in range(1, 31)} | {"hard 1": [9.0, 9.0]}
    sums["test 30"] = [30.0, 30.0]  # one that rules the whole
    subsets = {"usual": [f"test {n}" for n in range(1, 31)], "hard": ["hard 1", "hard 2"]}
    found = statistics.errors(sums, subsets)
    usual = found["usual"]
    assert usual["median"] == pytest.approx(0.1) and usual["relative_l2"] > 0.25
    assert usual["median_low"] == usual["median_high"] == pytest.approx(0.1)
    assert usual["low"] < usual["relative_l2"] < usual["high"] and usual["count"] == 30
    hard = found["hard"]
    assert (hard["relative_l2"], hard["count"], hard["low"]) == (1.0, 1, None)
    assert statistics.errors({}, subsets)["usual"]["relative_l2"] is None


def made_up_accuracy(numbers=12):
    """Results of the accuracy stage for one arm without and one with, where the second is 10 %
    better."""
    rng = np.random.default_rng(3)
    truth, error = rng.uniform(1, 9, numbers), rng.uniform(0.01, 0.03, (2, numbers))
    cases = [f"test {n}" for n in range(1, numbers + 1)]
    model = {"violation": dict.fromkeys(cases, 0.01), "violation_mean": 0.005, "gate_open": 0.25}

    def sums(error):
        return {"sums": dict(zip(cases, np.stack([error * truth, truth], 1).tolist(), strict=True))}

    models = {f"a{n}: {KERAS}": model | sums(error[n]) for n in range(2)}
    models |= {f"b{n}: {KERAS}": model | sums(0.81 * error[n]) for n in range(2)}
    runs = {
        name.split(":")[0]: {
            "threshold": 0.02,
            "volume_scale": 1e3,
            "train_gate_open": 0.5,
            "validation_gate_open": None,
        }
        for name in models
    }
    violation = dict(zip(cases, [0.01] * 9 + [0.03] * 3, strict=True))
    return {
        "models": models,
        "runs": runs,
        "subsets": {"usual": [cases[0], *cases[3:]], "hard": cases[1:3]},
        "force": dict(zip(cases, np.arange(1.0, numbers + 1), strict=True)),
        "fem_violation": violation,
    }


def test_the_arms_of_the_volume_term_are_compared_in_pairs():
    arms = [
        SimpleNamespace(label=label, runs=runs)
        for label, runs in (
            ("without", ("a0", "a1")),
            ("with", ("b0", "b1", "lost")),
            ("none", ("x",)),
        )
    ]
    found = statistics.physics(
        SimpleNamespace(physics=arms), json.loads(json.dumps(made_up_accuracy()))
    )
    assert [arm["label"] for arm in found] == [
        "without",
        "with",
    ] and "usual_difference" not in found[0]
    for which in ("usual", "strong", "hard"):
        assert found[1][f"{which}_difference"]["change"] == pytest.approx(-0.1, rel=1e-6)
        assert found[1][f"{which}_difference"]["high"] < 0
        assert np.mean(found[1]["seeds"][which]) == pytest.approx(found[1][which]["relative_l2"])
    assert (
        found[0]["volume_scale"] == 1e3
        and found[0]["train_gate_open"] == 0.5
        and found[0]["validation_gate_open"] is None
    )
    assert statistics.subsets(made_up_accuracy())["strong"] == ["test 11", "test 12"]
    assert len(bars.physics(found, "network").axes) == 3


def test_an_answer_is_kept_until_its_model_changes(tmp_path, tiny_dataset, monkeypatch):
    """Its threshold of the volume loss is part of what is kept, too."""
    dataset, judgements = open_dataset(tiny_dataset), []
    monkeypatch.setattr(accuracy, "keras_answer", lambda *arguments: None)
    monkeypatch.setattr(accuracy, "unseen_samples", lambda *arguments: None)
    monkeypatch.setattr(accuracy, "keep_field", lambda path, *others: write_text(path, ""))
    monkeypatch.setattr(
        accuracy, "judged", lambda *own, **_: judgements.append(own[-1]) or {"x": 1}
    )
    study = SimpleNamespace(
        cache=tmp_path,
        fem=SimpleNamespace(reference_safety=0.85),
        main=[SimpleNamespace(run="run")],
        physics=[],
    )
    source = tmp_path / "best.keras"
    for text, threshold in (("one", 0.07), ("one", 0.07), ("other", 0.07), ("other", 0.01)):
        source.write_text(text)
        settings = SimpleNamespace(
            name="run",
            folder=tmp_path,
            input=InputChoice(),
            model=SimpleNamespace(window=2),
            loss=SimpleNamespace(volume_threshold=threshold, volume_of="all"),
        )
        competitor = Competitor("network", "CNN-LSTM", None, run="run", form=KERAS)
        found = accuracy._network(study, settings, "run", competitor, dataset, None, {})
        assert found["x"] == 1 and (tmp_path / found["field"]).is_file()
    assert judgements == [0.07, 0.07, 0.01]


def test_fields_side_by_side_show_a_hard_interaction(tiny_dataset):
    dataset = open_dataset(tiny_dataset)
    test = load_samples(dataset, "test", None)
    figure = sections.side_by_side(
        dataset, test, {"half": 0.5 * test.displacement, "exact": test.displacement}
    )
    titles = [axis.get_title() for axis in figure.axes]
    assert any("relative L2 50 %" in title for title in titles) and any(
        "relative L2 0 %" in title for title in titles
    )
