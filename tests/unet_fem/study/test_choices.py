"""The best choice at every run time, and that a user can have it."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from fem.solver.frame_loop import LoopSettings
from unet_fem.study.measure.points import LONGEST, SHORTEST, best_choices, points
from unet_fem.study.report.best_choice import choices, draw
from unet_fem.study.runs import KERAS, smaller_runs
from unet_fem.study.settings import load_study
from unet_fem.training.settings import load_settings

ROOT = Path(__file__).parents[3]


def at(found, seconds):
    """The choice at a run time, None where nothing is as fast."""
    return next((one for one in found if one["from"] <= seconds < one["to"]), None)


def test_at_every_run_time_the_choice_is_the_least_error(study_of, results_of):
    study = study_of(2)
    results = results_of(study)
    for frame in study.fem.frames:
        every = points(results, frame)
        for subset in ("usual", "hard"):
            found = best_choices(study, every, subset)
            for seconds in np.geomspace(SHORTEST, 0.99 * LONGEST, 50):
                timely = [p for p in every if p["seconds"] <= seconds]
                least = min((p[subset] for p in timely), default=None)
                own = at(found, seconds)
                assert (own and own["error"]) == least
    axes = draw(study, results).axes
    assert len(axes) == 4 and all(axis.get_xscale() == axis.get_yscale() == "log" for axis in axes)


def test_what_is_faster_or_slower_than_is_asked_for_is_no_choice(study_of):
    base = {"kind": "FEM", "family": "FEM", "made": ["a line"]}
    known = {
        "far too fast": (1e-6, 0.9),
        "fast": (1e-5, 0.5),
        "slow": (1e-3, 0.1),
        "late": (9, 0.01),
    }
    every = [base | {"name": n, "seconds": s, "usual": e} for n, (s, e) in known.items()]
    found = best_choices(study_of(1), every, "usual")
    assert [one["name"] for one in found] == ["fast", "slow"]
    assert [(one["from"], one["to"]) for one in found] == [(SHORTEST, 1e-3), (1e-3, LONGEST)]


def vet(command: str) -> None:
    """Fails where what makes a choice is no command of the project, or no line that it takes."""
    if command.startswith("unet_fem.steppers.stepper("):
        settings = re.search(r"LoopSettings\(.*?\)", command)
        assert settings is None or eval(settings[0], {"LoopSettings": LoopSettings})
        return
    words = shlex.split(command)
    assert words[0] == "python", command
    if words[1] == "-m":
        module = Path(*words[2].split("."))
        assert (ROOT / module).with_suffix(".py").is_file() or (ROOT / module).is_dir(), command
        if words[2] == "unet_fem.train":
            load_settings(*words[3:4], words[4:])  # refuses unknown settings
        return
    assert (ROOT / words[1]).is_file(), command


def made_by(command: str) -> list[str]:
    """The files that a command makes."""
    words = shlex.split(command)
    if words[2] != "unet_fem.train":
        return words  # it is told
    run = load_settings(*words[3:4], words[4:]).folder
    return [str(run / "lite" / f"{form}.tflite") for form in ("float32", "float16")]


def test_networks_are_made_by_the_commands_of_their_runs(study_of, monkeypatch):
    study = study_of(2)
    thin = next(run for run in smaller_runs(study) if run.how == "thin")
    base = {"kind": "network", "family": "f", "made": [], "usual": 0.1, "seconds": 1e-3}
    for run, parent, form, last in (
        ("tiny", None, KERAS, "name=tiny"),
        ("tiny", None, "int8", "tools/quantize.py runs/tiny"),
        (thin.name, thin.parent, "int8", f"tools/prune.py runs/{thin.parent} --filters"),
    ):
        point = base | {"name": run, "run": run, "parent": parent, "form": form}
        (found,) = best_choices(study, [point], "usual")
        assert found["made"][-1].endswith(last)
        for command in found["made"]:
            vet(command)


def test_a_command_that_nobody_has_is_no_way_to_a_choice():
    for wrong in (
        "python tools/none.py",
        "python -m unet_fem.none",
        "./mine",
    ):
        with pytest.raises(AssertionError):
            vet(wrong)


def test_a_user_can_have_the_best_choice_at_every_run_time(monkeypatch):
    """Of the committed study, for usual and hard interactions at each length of frame."""
    monkeypatch.chdir(ROOT)
    study = load_study("configs/study.toml")
    names = ("reference", "accuracy", "fixed_latency", "run_time")
    results = {name: json.loads(Path(f"docs/results/{name}.json").read_text()) for name in names}
    own = choices(study, results)
    kept = json.loads(Path("docs/results/best_choice.json").read_text())
    assert json.loads(json.dumps(own)) == kept
    for of_frame in own.values():
        for found in of_frame.values():
            assert found and found[-1]["to"] == LONGEST
            ends = [one["to"] for one in found[:-1]]
            assert ends == [one["from"] for one in found[1:]]  # none is missing in between
            for one in found:
                assert one["made"], one["name"]
                for command in one["made"]:
                    vet(command)


def test_every_file_of_the_study_is_made_by_its_last_command(monkeypatch):
    monkeypatch.chdir(ROOT)
    for own in load_study("configs/study.toml").answers:
        assert bool(own.file) == bool(own.made), own.label
        for command in own.made:
            vet(command)
        if own.file:
            assert own.file in made_by(own.made[-1]), own.label
