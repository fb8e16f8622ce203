"""The converged reference, and the FEM as a competitor at fixed latency."""

import json
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError, SolverStopped
from fem.files import save_arrays
from fem.mesh.shapes import box, refined, tumour
from fem.solver.frame_loop import SAFETY, LoopSettings, coarse_mesh, longest_step
from unet_fem.deployment.latency import time_steppers
from unet_fem.study.dataset import frame_forces, frames_between
from unet_fem.study.measure import fixed_latency, loops, reference, tuning, variants
from unet_fem.study.measure.run_time import loop_steppers
from unet_fem.study.measure.sums import relative_l2, sums_of_squares
from unet_fem.study.settings import Fem

CASE = "test", 1
FRAME = 0.05  # s, a quarter of the tiny dataset's interval


def small_study(folder, data, **fem):
    fem = {"interactions": (1,), "steps": (5, 120), "frames": (FRAME,)} | fem
    return SimpleNamespace(cache=folder, data=str(data), fem=Fem(**fem), tries=8)


@pytest.fixture(scope="module")
def dataset(unseen_dataset):
    return open_dataset(unseen_dataset)


@pytest.fixture(scope="module")
def study(tmp_path_factory, unseen_dataset):
    return small_study(tmp_path_factory.mktemp("study"), unseen_dataset)


@pytest.fixture(scope="module")
def truth(study, dataset):
    return reference.references(study, dataset)[CASE]


def distance(a, b, dataset):
    return relative_l2({"x": sums_of_squares(a, b, dataset)}, ["x"])


def test_reference_stands_still_when_its_step_is_cut_to_a_fifth(study, dataset, truth, tmp_path):
    finer = small_study(tmp_path, dataset.path, reference_safety=0.17)
    assert distance(truth, reference.references(finer, dataset)[CASE], dataset) < 3e-3


def test_dataset_is_close_to_the_reference_and_another_interaction_is_not(dataset, truth, study):
    assert distance(dataset.read("test")["displacement"][0], truth, dataset) < 0.03
    assert distance(dataset.read("validation")["displacement"][0], truth, dataset) > 0.2


def test_finished_references_are_not_computed_again(study, dataset, truth, monkeypatch):
    monkeypatch.setattr(variants, "on_all_cores", None)
    np.testing.assert_array_equal(reference.references(study, dataset)[CASE], truth)


def test_an_interaction_whose_reference_stops_is_named_and_left_out(dataset, tmp_path):
    other = small_study(tmp_path, dataset.path)
    choice = reference.converged(dataset.scene, other.fem.reference_safety)
    for case in (CASE, ("test", 2), ("hard", 1)):
        path = variants.variant_path(other, dataset, "reference", choice, case)
        save_arrays(path, stopped="inverted cell")
    result = reference.run(other)
    assert result["stopped"] == ["test 1", "test 2", "hard 1"]
    assert result["dataset"]["usual"]["relative_l2"] is None
    with pytest.raises(InputError, match="no test interaction has a reference"):
        fixed_latency.run(other)


def test_refined_mesh_keeps_shape_fixed_nodes_and_every_second_node():
    coarse = tumour()
    fine = refined(coarse)
    assert fine.n_cells == 8 * coarse.n_cells and np.isclose(fine.volume(), coarse.volume())
    np.testing.assert_allclose(
        fine.grid.to_grid(fine.points)[::2, ::2, ::2],
        coarse.grid.to_grid(coarse.points),
        atol=1e-12,
    )
    at_old_nodes = fine.grid.to_grid(fine.fixed[:, None])[::2, ::2, ::2, 0]
    np.testing.assert_array_equal(at_old_nodes, coarse.grid.to_grid(coarse.fixed[:, None])[..., 0])


def test_frames_bring_the_forces_of_the_dataset_bit_for_bit(dataset):
    forces = frame_forces(dataset, "test", 1, FRAME)
    np.testing.assert_array_equal(forces[3::4], dataset.read("test")["force"][0, 1:])


def test_frames_must_divide_the_interval_of_the_dataset(dataset):
    with pytest.raises(InputError, match="0.15 s, which does not divide the 0.2 s"):
        frames_between(dataset.scene, 0.15)


def test_error_falls_to_that_of_the_ramped_load_as_steps_grow(study, dataset, truth):
    competitor = lambda steps: LoopSettings("full", False, FRAME, steps, damping=0.1)  # noqa: E731
    verdicts = [loops.judge(study, dataset, competitor(steps), CASE) for steps in (5, 20, 120)]
    errors = [relative_l2({"x": verdict["sums"]}, ["x"]) for verdict in verdicts]
    assert errors[0] > 1.5 * errors[1] > 1.5 * errors[2] and errors[2] < 0.02
    assert (
        verdicts[0]["mass_scaling"] > verdicts[1]["mass_scaling"] > verdicts[2]["mass_scaling"] == 1
    )


def test_mass_scaling_makes_the_steps_of_a_frame_just_stable(dataset):
    competitor = LoopSettings("reduced", False, FRAME, 5)
    loop = loops.loop(dataset, competitor)
    assert np.isclose(SAFETY * loop.solver.critical_step, FRAME / 5, rtol=1e-2)
    assert np.isclose(
        np.sqrt(loop.mass_scaling),
        FRAME / 5 / longest_step(dataset.fem_mesh, dataset.scene.material, competitor),
    )


def test_a_frame_action_is_the_loop_that_was_judged(study, dataset, truth):
    competitor = LoopSettings("reduced", True, FRAME, 5)
    verdict = loops.judge(study, dataset, competitor, CASE)
    loop, answer = loops.loop(dataset, competitor), np.zeros_like(truth)
    for k, force in enumerate(frame_forces(dataset, "test", 1, FRAME), 1):
        answer[-(-k // 4)] = loop.step(force)  # the last of every four stays
    assert sums_of_squares(answer, truth, dataset) == verdict["sums"]


def test_a_timed_loop_goes_on_for_ever_and_does_not_creep_from_round_to_round(dataset):
    stepper = loops.loop(dataset, LoopSettings("full", False, FRAME, 5))
    forces, seen, step = frame_forces(dataset, "test", 1, FRAME), [], stepper.step

    def recorded(force, dt=None):
        seen.append(np.abs(answer := step(force, dt)).max())
        return answer

    stepper.step = recorded
    rounds = 4 * 2 * len(forces)  # four times to and fro
    time_steppers({"loop": stepper}, {"loop": forces}, rounds, warm_up=0)
    peaks = np.reshape(seen, (4, -1)).max(axis=1)
    assert np.ptp(peaks[1:]) < 1e-3 * peaks[0]


def test_a_run_that_stops_is_named_and_is_no_number(study, dataset, truth, monkeypatch):
    forces = 40 * frame_forces(dataset, "test", 1, FRAME)
    monkeypatch.setattr(loops, "frame_forces", lambda *_: forces)
    competitor = LoopSettings("full", False, FRAME, 7)
    verdict = loops.judge(study, dataset, competitor, CASE)
    assert verdict["stopped"] in ("crushed cell", "diverged") and "sums" not in verdict
    point = fixed_latency.point(competitor, {CASE: verdict}, study, dataset)
    assert point["usual"]["relative_l2"] is None and point["stopped"][0]["case"] == "test 1"


def test_coarse_mesh_takes_linear_fields_and_total_forces_over_exactly():
    fine = box((8, 6, 4), 1e-3)
    coarse, A = coarse_mesh(fine)
    assert coarse.n_cells == 4 * 3 * 2 and coarse.congruent
    slope = np.random.default_rng(0).normal(size=(3, 3))
    np.testing.assert_allclose(A @ (coarse.points @ slope), fine.points @ slope, atol=1e-12)
    force = np.random.default_rng(1).normal(size=(fine.n_nodes, 3))
    np.testing.assert_allclose((A.T @ force).sum(axis=0), force.sum(axis=0))


def test_coarse_tumour_has_the_volume_and_the_free_surface_of_the_fine_one():
    fine = tumour()
    coarse, _ = coarse_mesh(fine)
    cell = coarse.volume() / coarse.n_cells
    assert abs(coarse.volume() - fine.volume()) <= cell
    assert np.isclose(coarse.points[~coarse.fixed, 2].max(), fine.points[:, 2].max())


def test_a_solver_that_stopped_crosses_from_a_worker_process(study):
    stop = pickle.loads(pickle.dumps(SolverStopped("diverged", "lower the load")))
    assert (stop.reason, str(stop)) == ("diverged", "lower the load")


def test_the_reference_is_closer_to_half_its_step_than_to_a_finer_mesh(study, dataset, truth):
    result = json.loads(json.dumps(reference.run(study), allow_nan=False))
    assert result["subsets"] == {"usual": ["test 1"], "hard": ["test 2", "hard 1"]}
    own = distance(dataset.read("test")["displacement"][0], truth, dataset)
    assert result["dataset"]["usual"]["relative_l2"] == own
    assert list(result["dataset"]["sums"]) == ["test 1", "test 2", "hard 1"]
    assert result["dataset"]["hard"]["count"] == 2
    assert 0 < result["half_step"]["relative_l2"] < 2e-3
    refined = result["refined"]
    assert 0.02 < refined["relative_l2"] < 0.5 and refined["stopped"] == []
    own, dilatation = (refined["tissue"][name] for name in ("full", "mean_dilatation"))
    assert own["cases"] == dilatation["cases"] and len(refined["tissue"]) == 3
    assert 0 < dilatation["relative_l2"] < own["relative_l2"]


@pytest.mark.slow
def test_every_tuned_loop_is_judged_and_can_be_timed(study, dataset, truth):
    result = json.loads(json.dumps(fixed_latency.run(study), allow_nan=False))
    points = result["points"]
    assert {(p["element"], p["coarse"]) for p in points} >= {
        ("full", False),
        ("reduced", False),
    } and any(p["coarse"] for p in points)
    for point in points:
        assert (point["mass_scaling"] > 1) == (point["steps"] == 5)  # 120 need none
        own = {case: np.sqrt(np.divide(*pair)) for case, pair in point["sums"].items()}
        assert list(own) == ["test 1", "test 2", "hard 1"]
        assert point["usual"]["relative_l2"] == pytest.approx(own["test 1"])
        assert point["usual"]["count"] == 1 and point["hard"]["count"] == 2
        assert point["hard"]["median"] == pytest.approx((own["test 2"] + own["hard 1"]) / 2)
    assert max(result["tries"].values()) <= study.tries and set(result["tries"]) == {
        point["name"] for point in points
    }
    begin = tuning.score(
        study, dataset, LoopSettings("full", False, FRAME, 5, damping=0.1, rise=0.5)
    )
    end = tuning.score(
        study,
        dataset,
        LoopSettings("full", False, FRAME, 5, damping=points[0]["damping"], rise=points[0]["rise"]),
    )
    assert end <= begin  # tuning never ends worse than it began
    steppers = loop_steppers(study, dataset)
    assert set(steppers) == {p["name"] for p in points}
    force = frame_forces(dataset, "test", 1, FRAME)[-1]
    assert all(np.abs(stepper.step(force)).max() > 0 for stepper in steppers.values())


def test_no_loop_is_tuned_beyond_its_budget(study, dataset, monkeypatch):
    """The walk would go on for ever: each setting errs less than the one before."""
    errors = iter(np.geomspace(1, 1e-9, 60))
    judgements = []
    monkeypatch.setattr(tuning, "score", lambda *own: judgements.append(own[-1]) or next(errors))
    full = LoopSettings("full", False, FRAME, 5)
    few = SimpleNamespace(tries=4, fem=Fem((1,), steps=(5,)))
    ((_, tries),) = tuning._chain(few, dataset, full, FRAME)
    assert tries == 4 and len(set(judgements)) == 3  # one for the element, which is chosen before


def test_a_chain_ends_where_more_steps_help_no_more(dataset, monkeypatch):
    errors = {1: 0.5, 2: 0.1, 5: 0.0999, 11: 0.01}
    monkeypatch.setattr(tuning, "score", lambda study, dataset, own: errors[own.steps])
    study = SimpleNamespace(tries=2, fem=Fem((1,), steps=(1, 2, 5, 11)))
    chain = tuning._chain(study, dataset, LoopSettings("full", False, FRAME, 1), FRAME)
    assert [settings.steps for settings, _ in chain] == [1, 2, 5]
