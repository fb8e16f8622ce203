"""Competitors that join by configuration: what steps is judged and timed at every length of
frame."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError, SolverStopped, Stop
from fem.online.grid import NodeGrid
from fem.online.regression import RegressionStepper
from fem.online.window import WindowStepper
from unet_fem import steppers as kinds
from unet_fem.networks.pod import linear
from unet_fem.study.measure import accuracy, duties, run_time
from unet_fem.study.measure.duties import dutiful
from unet_fem.study.measure.judged import unseen_samples
from unet_fem.study.measure.points import points
from unet_fem.study.settings import Answer, Fem, load_study
from unet_fem.study.steppers import answering, followed, linear_regressions
from unet_fem.training.samples import load_samples

FRAME = 0.05  # s, a quarter of the dataset's interval


class Held:
    """A stepper for any interval: it answers `size` mm/mN times the force, and more the longer the
    force has been there."""

    interval = None

    def __init__(self, mesh, material, size=1.0):
        self.size = size
        self.reset()

    def reset(self):
        self.time = 0.0

    def step(self, force, dt=None):
        self.time += dt
        return (self.size * self.time * np.asarray(force)).astype("float32")


@pytest.fixture
def dataset(unseen_dataset):
    return open_dataset(unseen_dataset)


@pytest.fixture
def study(dataset, tmp_path, monkeypatch):
    """Two answers: one of a kind, which takes any interval, and one from a file, which does not."""
    own = kinds.Kind("held", f"{__name__}:Held")
    monkeypatch.setitem(kinds.STEPPERS, "held", own)
    path = tmp_path / "linear.npz"
    train = load_samples(dataset, "train", None)
    interval = dataset.scene.frames.interval
    dataclasses.replace(linear(train, train, dataset.free), interval=interval).save(path)
    return SimpleNamespace(
        cache=tmp_path,
        fem=Fem((1,), frames=(FRAME, 0.2)),
        answers=(
            Answer("held", "solver", stepper="held", options={"size": 0.5}),
            Answer("from a file", "regression", file=str(path), interactions=99, hard=True),
            Answer("gone", "regression", file=str(tmp_path / "gone.npz")),
        ),
    )


def test_what_takes_any_interval_is_a_competitor_for_each_frame(study, dataset):
    found = answering(study, dataset)
    assert list(found) == ["held / 50 ms", "held / 200 ms", "from a file"]
    held, file = found["held / 50 ms"], found["from a file"]
    assert (held.kind, held.frame, held.interactions) == ("FEM", FRAME, 0)
    assert (file.kind, file.frame) == ("answer", None)
    assert file.facts()["interactions"] == 99 and file.facts()["hard_in_training"] is True
    assert isinstance(file.make(), RegressionStepper) and held.make().size == 0.5


def test_an_answer_is_judged_at_its_own_frames(study, dataset):
    """At 50 ms the stepper sees the forces between two frames of the dataset as well."""
    samples = unseen_samples(dataset)
    truth = {("test", 1): samples.displacement[: len(dataset.time)]}
    own = answering(study, dataset)
    for name, cases in (("held / 50 ms", 3), ("held / 200 ms", 3), ("from a file", 3)):
        found = accuracy._answer(study, name, own[name], dataset, samples, truth)
        assert len(found["sums"]) == cases and list(found["reference"]) == ["test 1"]
        assert found["frame"] == own[name].frame
    # a frame's answer goes with the time that has passed, however many calls that were; at 200 ms
    # the first call is that of the first frame, at rest, so that it is one frame ahead
    short, long = (
        accuracy._answer(study, name, own[name], dataset, samples, truth)["sums"]["test 1"]
        for name in ("held / 50 ms", "held / 200 ms")
    )
    assert short[1] == long[1] and short[0] != long[0]


def test_an_answer_that_stops_is_named_and_is_no_point(study, dataset, monkeypatch):
    samples = unseen_samples(dataset)
    truth = {("test", 1): samples.displacement[: len(dataset.time)]}
    hard = np.abs(samples.force[_rows_of(dataset, 2)]).max()

    def step(self, force, dt=None):
        if np.abs(force).max() == hard:
            raise SolverStopped.because(Stop.DIVERGED, "no equilibrium")
        return np.zeros_like(force)

    monkeypatch.setattr(Held, "step", step)
    own = answering(study, dataset)["held / 200 ms"]
    found = accuracy._answer(study, "held", own, dataset, samples, truth)
    assert found["stopped"] == [{"case": "hard 1", "reason": "diverged"}]
    assert list(found["sums"]) == ["test 1", "test 2"] and found["hard"]["count"] == 1
    results = {
        "run_time": {"seconds": {"held": {"p50": 1.0}}},
        "accuracy": {"models": {"held": found | {"headline": {}}}},
        "fixed_latency": {"points": []},
    }
    assert points(results, 0.2) == []


def _rows_of(dataset, place):
    frames = len(dataset.time)
    return slice(place * frames, (place + 1) * frames)


def test_following_gives_the_interval_to_those_who_ask(dataset):
    forces = dataset.read("test")["force"][0]
    answer = followed(Held(None, None), forces, 0.2)
    np.testing.assert_allclose(answer[2], 0.6 * forces[2], rtol=1e-6)
    (linear,) = linear_regressions(dataset, [1]).values()
    np.testing.assert_allclose(
        followed(linear.make(), forces, 0.2), followed(linear.make(), forces, 0.3)
    )


def test_an_answer_is_a_file_or_a_kind_and_within_its_budget():
    for own in ({}, {"file": "a.npz", "stepper": "fem"}):
        with pytest.raises(InputError, match="give one of the two"):
            Answer("a", "b", **own)
    study = load_study("configs/study_quick.toml")
    twice = (Answer("a", "b", file="x.npz"),) * 2
    with pytest.raises(InputError, match="two have the same label"):
        dataclasses.replace(study, answers=twice)


def grid_stepper(dataset, answer):
    grid = NodeGrid(dataset.grid, np.arange(dataset.mask.size))
    return WindowStepper(lambda force: answer(force), grid, None, 0.2)


def test_every_stepper_has_the_same_duties(dataset):
    """Bug: networks were timed with checks and alarm, regressions and the FEM without."""
    force = load_samples(dataset, "train", None).last_force[2]
    points = dataset.points * dataset.free[..., None]
    out = dutiful(grid_stepper(dataset, lambda f: 0.3 * points[None].astype("float32")), dataset)
    still = dutiful(grid_stepper(dataset, lambda f: 0.0 * f[None][0]), dataset)
    out.step(force)
    still.step(force)
    assert out.volume_alarm and not still.volume_alarm
    assert not still.outside_training_range
    still.step(9 * force)
    assert still.outside_training_range
    with pytest.raises(InputError, match="not finite"):
        still.step(np.full_like(force, np.nan))
    assert dutiful(out, dataset) is out  # has them already
    assert isinstance(still, duties.Dutiful) and still.interval == 0.2


def test_a_p99_has_a_thousand_calls_behind_it(monkeypatch):
    calls = []
    turns = {name: lambda name=name: calls.append(name) for name in ("a", "b")}
    times = run_time.time_calls(turns, 3)
    assert {name: len(values) for name, values in times.items()} == {"a": 30, "b": 30}
    assert calls[:10] == ["a"] * 10 and calls[10:20] == ["b"] * 10  # they take turns
    few, many = (run_time.distribution(np.full(n, 1e-3)) for n in (999, 1000))
    assert few["p99"] is None and many["p99"] == 1e-3 and many["calls"] == 1000
    study = load_study("configs/study.toml")
    assert study.rounds * run_time.CALLS >= run_time.ENOUGH


def test_timed_calls_start_from_rest_again_when_all_forces_have_been(dataset):
    stepper = Held(None, None)
    forces = dataset.read("test")["force"][0]
    own = run_time.Calls(stepper, forces, 0.2)
    for _ in range(2 * len(forces) + 1):
        own.prepare()
        own()
    assert stepper.time == pytest.approx(0.2)
    np.testing.assert_array_equal(own.force, forces[0])
