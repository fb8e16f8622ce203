"""A stage is measured again when what it depends on has changed, and only then."""

import dataclasses
import os
from pathlib import Path

import pytest

from fem.errors import InputError
from unet_fem.study import stages
from unet_fem.study.runs import CommandFailed, command, smaller_runs
from unet_fem.study.settings import Answer, load_study
from unet_fem.study.stages import STAGES, run_stage, stage_key

ROOT = Path(__file__).parents[3]


@pytest.fixture
def study(tmp_path, monkeypatch):
    """The quick study in a folder where its networks and data are files of a few letters."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    study = load_study("configs/study_quick.toml")
    pruned = [(run.name, "pruned", run.parent) for run in smaller_runs(study)]
    for name, done, parent in [
        *((network.name, "metrics.json", network.name) for network in study.networks),
        *pruned,
    ]:
        settings = dataclasses.replace(study.network(parent), name=name)
        (settings.folder / "lite").mkdir(parents=True)
        (settings.folder / "config.toml").write_text(settings.toml())
        for file in (done, "best.keras", "history.json", "lite/int8.tflite"):
            (settings.folder / file).write_text(f"{name} {file}")
    Path("data").mkdir()
    Path(study.data).write_text("interactions")
    return study


@pytest.fixture
def measured(monkeypatch):
    """The names of the stages that were measured, as they are."""
    names = []
    monkeypatch.setattr(stages, "_apart", lambda study, name: names.append(name) or {"x": 1})
    return names


def run_all(study):
    for name in STAGES:
        run_stage(study, name)


def test_data_of_an_edited_scene_make_every_stage_run_again(study, measured):
    """Bug: keys held names and paths, so that other data under the same path left all of them
    fresh."""
    run_all(study)
    run_all(study)
    assert measured == list(STAGES)
    Path(study.data).write_text("other interactions")
    run_all(study)
    assert measured == list(STAGES) * 2


def test_a_file_that_is_only_touched_changes_nothing(study, measured):
    run_all(study)
    os.utime(study.data, (1, 1))
    os.utime("runs/tiny/best.keras", (1, 1))
    run_all(study)
    assert measured == list(STAGES)


@pytest.mark.parametrize(
    ("file", "stale"),
    [
        ("runs/tiny/best.keras", set(STAGES) - {"reference", "fixed_latency"}),
        ("runs/tiny_other/best.keras", {"accuracy", "time_dependence"}),
        ("runs/tiny_unet/lite/int8.tflite", set(STAGES) - {"reference", "fixed_latency"}),
        ("runs/tiny_thin50/best.keras", {"accuracy", "run_time"}),
    ],
)
def test_a_run_that_was_made_again_concerns_the_stages_that_read_it(study, measured, file, stale):
    run_all(study)
    measured.clear()
    Path(file).write_text("made again")
    run_all(study)
    assert set(measured) == stale


def test_other_main_networks_and_arms_are_judged_again(study, measured):
    """Bug: "accuracy" knew neither the main networks nor the arms, whose fields it keeps."""
    keys = {name: stage_key(study, name) for name in STAGES}
    less = dataclasses.replace(study, main=study.main[:1], order=(), paper_latency={})
    arms = dataclasses.replace(study, physics=study.physics[:1])
    changed = {name for name in STAGES if stage_key(less, name) != keys[name]}
    assert changed == set(STAGES) - {"reference", "fixed_latency"}
    assert {name for name in STAGES if stage_key(arms, name) != keys[name]} == {"accuracy"}
    said = dataclasses.replace(study, order=(), paper_latency={})  # of the page, not of a stage
    assert {name: stage_key(said, name) for name in STAGES} == keys


def test_an_answer_concerns_the_stages_that_show_it(study):
    """What it has cost concerns the accuracy stage alone; what is not shown, the stages that judge
    and time everything."""
    own = Answer("solver", "FEM", stepper="quasistatic")
    base = dataclasses.replace(study, answers=(own,))
    keys = {name: stage_key(base, name) for name in STAGES}
    for change, stale in (
        ({"training": 9.0, "tries": 3, "simulated": 5}, {"accuracy"}),
        ({"options": {"precision": "float64"}}, {"accuracy", "run_time"}),
        ({"shown": True}, {"accuracy", "time_dependence", "force_range", "extremes"}),
    ):
        other = dataclasses.replace(base, answers=(dataclasses.replace(own, **change),))
        assert {name for name in STAGES if stage_key(other, name) != keys[name]} == stale


def test_a_raised_version_reaches_the_stages_that_build_on_it(study, monkeypatch):
    keys = {name: stage_key(study, name) for name in STAGES}
    newer = dataclasses.replace(STAGES["reference"], version=9)
    monkeypatch.setitem(STAGES, "reference", newer)
    changed = {name for name in STAGES if stage_key(study, name) != keys[name]}
    assert changed == {"reference", "fixed_latency", "accuracy", "force_range", "run_time"}


def test_results_lie_under_the_cache_root_and_again_measures_once_more(
    study, measured, monkeypatch, tmp_path
):
    monkeypatch.setenv("UNET_FEM_CACHE", str(tmp_path / "elsewhere"))
    with pytest.raises(InputError, match="without --draw"):
        run_stage(study, "reference", only_read=True)
    run_stage(study, "reference")
    assert (tmp_path / "elsewhere/study_quick/reference.json").is_file()
    run_stage(study, "reference", again=True)
    assert measured == ["reference"] * 2
    Path(study.data).write_text("other interactions")
    assert run_stage(study, "reference", only_read=True) == {"x": 1}
    (tmp_path / "elsewhere/study_quick/reference.json").write_text("{")
    with pytest.raises(InputError, match="damaged"):
        run_stage(study, "reference", only_read=True)


def test_pruned_runs_know_the_run_that_they_come_from(study):
    parents = {run.name: run.parent for run in smaller_runs(study)}
    assert parents == {
        "tiny_thin50": "tiny",
        "tiny_pruned50": "tiny",
        "tiny_unet_thin50": "tiny_unet",
        "tiny_unet_pruned50": "tiny_unet",
    }


def test_a_command_that_fails_ends_the_study_and_not_the_process(capfd):
    with pytest.raises(CommandFailed, match="give the same command again") as failed:
        command("-c", "raise SystemExit(3)")
    assert failed.value.code == 3
