"""Test interactions with their forces times a factor, by the dataset's own solver, by the elastic
tissue and by the FEM in real time."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.data.fit import fit_frames
from fem.errors import SolverStopped, Stop
from fem.files import save_arrays
from fem.solver.frame_loop import LoopSettings
from fem.workers import on_all_cores
from unet_fem.study.dataset import frame_forces, frames_between, load_of
from unet_fem.study.keys import key
from unet_fem.study.measure.loops import loop, loop_name
from unet_fem.study.settings import Study

VERSION = 2
Answers = dict[str, np.ndarray]


def simulated(
    study: Study, dataset: Dataset, settings: LoopSettings
) -> Iterator[tuple[tuple[int, float], tuple[np.ndarray, Answers, dict[str, str]]]]:
    """The FEM's answers: an iterator of ((number, factor), (force, {name: field}, {name: why it
    stopped, or ""})).

    force and fields (frames, nx, ny, nz, 3) in mN and mm; a field ends before the frame that its
    run did not reach. settings: of the loop that is the FEM in real time. Computed in parallel
    where they are missing, and kept in the cache.
    """
    which = [(n, f) for n in study.stability.interactions for f in study.stability.factors]
    places = []
    for kind, function, own in (
        ("offline", simulate_offline, ()),
        ("loop", simulate_loop, (settings,)),
    ):
        paths = [_path(study, dataset, kind, own, number, factor) for number, factor in which]
        missing = [
            (dataset, *pair, *own, path)
            for pair, path in zip(which, paths, strict=True)
            if not path.is_file()
        ]
        if missing:
            on_all_cores(function, missing, f"multiplied forces, {kind}")
        places.append(paths)
    for (number, factor), *paths in zip(which, *places, strict=True):
        answers, reasons = {}, {}
        for path in paths:
            with np.load(path) as file:
                for entry in file.files:
                    name, _, stopped = entry.partition(":")
                    if stopped:
                        reasons[name] = str(file[entry])
                    else:
                        answers[name] = file[entry]
        yield (number, factor), (factor * force_of(dataset, number), answers, reasons)


def force_of(dataset: Dataset, number: int) -> np.ndarray:
    """(frames, nx, ny, nz, 3) mN: the forces of a test interaction on the grid."""
    return dataset.force_on_grid(dataset.sequence("test", number).force)


def simulate_offline(dataset: Dataset, number: int, factor: float, path: Path) -> None:
    """Write test interaction `number` at `factor` times its forces to `path`, by the dataset's
    solver as far as the run is fit for a dataset.

    The answers: "truth", and "elastic FEM", the same without Prony terms.
    """
    load = load_of(dataset, "test", number, factor)
    elastic = replace(dataset.scene, material=dataset.scene.material.elastic())
    arrays: dict[str, object] = {}
    for name, scene in (("truth", dataset.scene), ("elastic FEM", elastic)):
        found, reason = fit_frames(scene, dataset.fem_mesh, load, dataset.time)
        arrays[name] = dataset.displacement_on_grid(found.displacement)
        arrays[f"{name}:stopped"] = reason or ""
    save_arrays(path, **arrays)


def simulate_loop(
    dataset: Dataset, number: int, factor: float, settings: LoopSettings, path: Path
) -> None:
    """Write the same by the FEM in real time, which takes its few steps for the force that comes
    every frame of its own."""
    stepper = loop(dataset, settings)
    forces = factor * frame_forces(dataset, "test", number, settings.frame)
    calls = frames_between(dataset.scene, settings.frame)

    def step(frame: int) -> np.ndarray:
        for force in forces[(frame - 1) * calls : frame * calls]:
            answer = stepper.step(force)
        return answer

    save_frames(path, {loop_name(settings): step}, dataset)


def save_frames(
    path: Path, steps: dict[str, Callable[[int], np.ndarray]], dataset: Dataset
) -> None:
    """Write what `frames` makes of {name: step} to `path`."""
    arrays: dict[str, object] = {}
    for name, step in steps.items():
        shape = (len(dataset.time), *dataset.grid, 3)
        arrays[name], arrays[f"{name}:stopped"] = frames(step, shape)
    save_arrays(path, **arrays)


def frames(
    step: Callable[[int], np.ndarray], shape: tuple[int, ...]
) -> tuple[np.ndarray, Stop | str]:
    """(fields (frames reached, nx, ny, nz, 3), reason or ""): step(frame) from rest, until it stops
    or gives no finite field.

    shape: of all frames.
    """
    fields = [np.zeros(shape[1:], np.float32)]
    for frame in range(1, shape[0]):
        try:
            field = step(frame)
        except SolverStopped as stop:
            return np.array(fields), stop.reason
        if not np.isfinite(field).all():
            return np.array(fields), Stop.NOT_FINITE
        fields.append(field)
    return np.array(fields), ""


def _path(study, dataset, kind, own, number, factor):
    made_from = key((kind, own, number, factor), [dataset.path], VERSION)
    return study.cache / "stability" / f"{kind}-{number:04d}-x{factor:g}-{made_from}.npz"
