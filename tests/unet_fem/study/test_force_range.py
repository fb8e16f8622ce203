"""The stability map: multiplied forces, runs that stop, and a table that says where a competitor
holds."""

import json
import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import SolverStopped
from fem.online.grid import NodeGrid
from fem.online.window import WindowStepper
from fem.solver.frame_loop import LoopSettings
from unet_fem.study.measure import force_range, multiplied
from unet_fem.study.measure.force_range import run
from unet_fem.study.measure.loops import loop_name
from unet_fem.study.measure.multiplied import (
    frames,
    simulate_loop,
    simulate_offline,
    simulated,
)
from unet_fem.study.report.force_range import draw
from unet_fem.study.steppers import Competitor


@pytest.fixture(scope="module")
def dataset(tiny_dataset):
    return open_dataset(tiny_dataset)


LOOP = LoopSettings("reduced", coarse=False, frame=0.01, steps=44)


def arrays(simulate, *arguments):
    """The arrays that a simulation leaves."""
    with tempfile.TemporaryDirectory() as folder:
        simulate(*arguments, path := Path(folder, "one.npz"))
        with np.load(path) as file:
            return dict(file)


def test_at_factor_one_the_truth_is_the_dataset_and_the_others_are_near(dataset):
    own = dataset.read("test")["displacement"][0]
    found = arrays(simulate_offline, dataset, 1, 1.0) | arrays(simulate_loop, dataset, 1, 1.0, LOOP)
    np.testing.assert_allclose(found["truth"], own, rtol=1e-5, atol=1e-7)
    for name, near in (
        ("elastic FEM", 0.3),
        (loop_name(LOOP), 0.6),
    ):  # two reduced cells are a coarse tissue
        assert (
            found[f"{name}:stopped"] == ""
            and 1e-3 < np.linalg.norm(found[name] - own) / np.linalg.norm(own) < near
        ), name


def test_tenth_of_the_force_moves_about_a_tenth(dataset):
    own = dataset.read("test")["displacement"][0]
    for found in (
        arrays(simulate_offline, dataset, 1, 0.1)["truth"],
        arrays(simulate_loop, dataset, 1, 0.1, LOOP)[loop_name(LOOP)],
    ):
        assert 0.05 < np.linalg.norm(found) / np.linalg.norm(own) < 0.15


def test_a_force_that_crushes_the_tissue_ends_the_truth_before_its_last_frame(dataset):
    found = arrays(simulate_offline, dataset, 1, 20.0) | arrays(
        simulate_loop, dataset, 1, 20.0, LOOP
    )
    assert 1 <= len(found["truth"]) < len(dataset.time) and found["truth:stopped"] != ""
    assert all(np.isfinite(field).all() for name, field in found.items() if ":" not in name)


def test_a_truth_that_no_dataset_would_take_is_none(dataset):
    """The mass is scaled so high that inertia carries the load, and no cell is crushed."""
    heavy = replace(dataset.scene, solver=replace(dataset.scene.solver, mass_scaling=1024.0))
    found = arrays(simulate_offline, replace(dataset, scene=heavy), 1, 0.5)
    assert len(found["truth"]) < len(dataset.time)
    assert found["truth:stopped"] == "disequilibrium"


def test_frames_end_where_a_run_stops_or_is_not_finite():
    def step(frame):
        if frame == 2:
            raise SolverStopped("diverged", "no longer finite")
        return np.ones(3)

    fields, reason = frames(step, (4, 3))
    assert fields.tolist() == [[0, 0, 0], [1, 1, 1]] and reason == "diverged"
    assert frames(lambda frame: np.full(3, np.nan), (4, 3))[1] == "not finite"
    assert [
        len(frames(lambda frame: np.ones(3), (4, 3))[0]),
        frames(lambda frame: np.ones(3), (4, 3))[1],
    ] == [4, ""]


@pytest.fixture
def judged(dataset, monkeypatch):
    """The result of `run` on two interactions and two factors with known answers; at factor 2 the
    truth of the second ends early."""
    own = dataset.read("train")  # two interactions within the training range
    study = SimpleNamespace(stability=SimpleNamespace(interactions=(1, 2), factors=(1.0, 2.0)))

    def parts(study, dataset, loop):
        for number in (1, 2):
            for factor in (1.0, 2.0):
                truth = factor * own["displacement"][number - 1]
                early = (number, factor) == (2, 2.0)
                answers = {
                    "truth": truth[:2] if early else truth,
                    "stopping": truth[:1] if factor == 2 else truth,
                }
                yield (
                    (number, factor),
                    (
                        factor * own["force"][number - 1],
                        answers,
                        {"truth": "crushed cell" if early else "", "stopping": ""},
                    ),
                )

    blown_up = (
        0.2 * dataset.points * dataset.free[..., None]
    )  # the bottom and sides stay, the inside and the top leave
    networks = {
        "5 % off": lambda force: scale(force, own, 1.05),
        "out of band": lambda force: scale(force, own, 1.0) + blown_up.astype("float32"),
    }
    shown = {name: of_one_force(dataset, answer) for name, answer in networks.items()}
    monkeypatch.setattr(force_range, "study_dataset", lambda study: dataset)
    monkeypatch.setattr(force_range, "simulated", parts)
    monkeypatch.setattr(force_range, "real_time", lambda study, dataset: LOOP)
    monkeypatch.setattr(force_range, "shown_competitors", lambda study, dataset: shown)
    return run(study)


def of_one_force(dataset, answer):
    """A competitor whose stepper gives answer(force (nx, ny, nz, 3))."""
    grid = NodeGrid(dataset.grid, np.arange(dataset.mask.size))
    interval = dataset.scene.frames.interval
    return Competitor(
        "network",
        "made up",
        lambda: WindowStepper(lambda force: answer(force[0])[None], grid, None, interval),
    )


def scale(force, own, by):
    """`by` times the truth of the force field `force`, found among the training data."""
    for i, frame in np.ndindex(own["force"].shape[:2]):
        for factor in (1.0, 2.0):
            if np.array_equal(force, factor * own["force"][i, frame]):
                return (by * factor * own["displacement"][i, frame]).astype("float32")


def test_tables_tell_error_stops_and_forces_beyond_training(judged):
    json.dumps(judged, allow_nan=False)
    error = judged["competitors"]["5 % off"]["relative_l2"]
    assert error[0][0] is None  # at rest
    assert [value for row in error for value in row[1:]] == pytest.approx([0.05] * 4, rel=1e-3)
    assert judged["alive"] == [[2, 2, 2], [2, 2, 1]]
    stopping = judged["competitors"]["stopping"]
    assert (
        stopping["stopped"] == [[0, 0, 0], [0, 2, 1]]
        and stopping["relative_l2"][1] == [None] * 3
        and stopping["volume"][1][1] is None
    )
    assert judged["stops"] == [
        {
            "what": "truth",
            "number": 2,
            "factor": 2.0,
            "after": pytest.approx(0.2),
            "reason": "crushed cell",
        }
    ]
    assert judged["flag"][0] == [0, 0, 0] and max(judged["flag"][1]) > 0


def test_volume_is_judged_beside_error(judged):
    volume = {
        name: np.array(found["volume"][0], float) for name, found in judged["competitors"].items()
    }
    assert (volume["out of band"] > judged["band"]).all() and (
        volume["truth"] < judged["band"]
    ).all()


def test_drawing_has_a_panel_for_each_competitor_and_not_for_the_truth(judged):
    titles = [axis.get_title() for axis in draw(json.loads(json.dumps(judged))).axes]
    assert [title for title in titles if title] == ["stopping", "5 % off", "out of band"]


def test_simulated_runs_are_kept(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(
        multiplied,
        "on_all_cores",
        lambda function, tasks, title: [function(*task) for task in tasks],
    )
    study = SimpleNamespace(
        cache=tmp_path, stability=SimpleNamespace(interactions=(1,), factors=(0.5,))
    )
    ((which, (force, answers, reasons)),) = simulated(study, dataset, LOOP)
    np.testing.assert_array_equal(force, 0.5 * dataset.read("test")["force"][0])
    assert which == (1, 0.5) and set(answers) == set(reasons) == {
        "truth",
        "elastic FEM",
        loop_name(LOOP),
    }
    monkeypatch.setattr(
        multiplied, "on_all_cores", lambda *arguments: pytest.fail("simulated again")
    )
    ((_, (_, again, _)),) = simulated(study, dataset, LOOP)
    np.testing.assert_array_equal(answers["truth"], again["truth"])
