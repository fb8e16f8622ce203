"""The measurements of a study, in order. Each leaves its figures as JSON, and one that is there is
not taken again unless what it depends on has changed."""

import importlib
import json
import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from fem.cache import once
from fem.errors import InputError
from unet_fem.study.keys import key
from unet_fem.study.runs import deployed_runs, run_files, trained_runs
from unet_fem.study.settings import Study


@dataclass(frozen=True)
class Stage:
    """What the figures of a stage depend on besides the study's dataset.

    fields: of the study; files: those that it reads; uses: stages whose simulations it takes over;
    version: to be raised when its code gives other figures.
    """

    fields: tuple[str, ...]
    files: Callable[[Study], Iterable[Path | str]] = lambda study: ()
    uses: tuple[str, ...] = ()
    version: int = 1


def _files_of(runs: Iterable[str], study: Study) -> list[Path]:
    return [path for name in dict.fromkeys(runs) for path in run_files(study.network(name))]


def _main_files(study: Study) -> list[Path]:
    return _files_of((main.run for main in study.main), study)


def _window_files(study: Study) -> list[Path | str]:
    runs = (*(main.run for main in study.main), *study.window)
    long = [path for own in study.long for path in (own.scene, own.data)]
    return [*long, *_files_of(runs, study)]


def _all_files(study: Study) -> list[Path]:
    return [path for settings, _ in trained_runs(study).values() for path in run_files(settings)]


def _deployed_files(study: Study) -> list[Path]:
    return [path for settings, _ in deployed_runs(study).values() for path in run_files(settings)]


def _answer_files(study: Study, shown: bool = False) -> list[str]:
    return [own.file for own in study.answers if own.file and (own.shown or not shown)]


def _shown_files(study: Study) -> list[Path | str]:
    return [*_main_files(study), *_answer_files(study, shown=True)]


STAGES = {  # a stage is the module of unet_fem.study.measure with run(study)
    "reference": Stage(("fem",), version=2),
    "fixed_latency": Stage(("fem", "tries"), uses=("reference",), version=2),
    "accuracy": Stage(
        ("networks", "main", "physics", "prune", "pod_modes", "fem", "answers"),
        lambda study: [*_all_files(study), *_answer_files(study)],
        ("reference",),
        version=2,
    ),
    "time_dependence": Stage(
        ("networks", "main", "window", "fem", "answers", "long"),
        lambda study: [*_window_files(study), *_answer_files(study, shown=True)],
        version=3,
    ),
    "force_range": Stage(
        ("networks", "main", "stability", "fem", "answers"),
        _shown_files,
        ("reference", "fixed_latency"),
        version=2,
    ),
    "extremes": Stage(("networks", "main", "answers"), _shown_files),
    "run_time": Stage(
        ("networks", "main", "deployed", "prune", "pod_modes", "fem", "rounds", "answers"),
        lambda study: [*_deployed_files(study), *_answer_files(study)],
        ("reference", "fixed_latency"),
        version=3,
    ),
}

NEEDED = ("reference", "fixed_latency", "accuracy", "run_time")


def stage_key(study: Study, name: str) -> str:
    """Of all that the figures of stage `name` depend on."""
    stage = STAGES[name]
    settings = {field: getattr(study, field) for field in stage.fields}
    if "networks" in settings:  # what their files say now, not the files' names
        settings["networks"] = [network.settings for network in study.networks]
    if "main" in settings:  # pruned networks are read from their files
        settings["main"] = [(main.label, main.run) for main in study.main]
    if "answers" in settings and name != "accuracy":  # which also tells what they have cost
        settings["answers"] = [
            (own.label, own.family, own.stepper, own.options, own.scene)
            for own in study.answers
            if own.shown or name == "run_time"
        ]
    versions = [STAGES[used].version for used in (*stage.uses, name)]
    return key((name, settings), [study.data, *stage.files(study)], versions)


def check_needed(results: dict[str, dict]) -> None:
    """Raises InputError where a stage is missing that no page can do without."""
    for name in NEEDED:
        if name not in results:
            raise InputError(
                f"stage '{name}' is not measured, and no page can do without it;"
                " run the command without --draw"
            )


def stage_file(study: Study, name: str) -> Path:
    """Where the figures of stage `name` are kept."""
    return study.cache / f"{name}.json"


def run_stage(study: Study, name: str, again: bool = False, only_read: bool = False) -> dict:
    """The figures of stage `name`: read if they are there and nothing that they depend on has
    changed, otherwise measured now.

    again: measure in any case; only_read: read what is there, whatever it depends on. Raises
    InputError where there is nothing to read.
    """
    path = stage_file(study, name)
    if only_read:
        if not path.is_file():
            raise InputError(f"there is no {path} to draw from; run this command without --draw")
        try:
            return json.loads(path.read_text())["result"]
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{path} is damaged; delete it") from None
    if again:
        path.unlink(missing_ok=True)
    return once(path, stage_key(study, name), lambda: _apart(study, name))


def _apart(study, name):
    """Stage `name` in a process of its own: TensorFlow's threads, precision and memory are settled
    once a process."""
    print(f"\nmeasuring: {name}", flush=True)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_run, name, study).result()


def _run(name, study):
    return importlib.import_module(f"unet_fem.study.measure.{name}").run(study)
