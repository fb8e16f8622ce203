"""Simulate the interactions of a scene in parallel, and put the finished ones together as a
dataset."""

import json
import re
import shutil
from collections import Counter
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from fem.cache import digest
from fem.contact.table import table_contacts
from fem.data.confirm import Confirmation, check_confirmed, confirmed, sampled
from fem.data.interaction import healthy_interaction
from fem.data.scene import Scene
from fem.data.write import write_dataset
from fem.errors import InputError
from fem.files import make_folder, save_arrays, write_text
from fem.locks import lock
from fem.mesh.hexmesh import HexMesh
from fem.workers import on_all_cores

SIMULATION_VERSION = 2  # raise it when the same scene gives other interactions than before


def generate(
    scene: Scene, path: str | Path, workers: int | None = None, executor: Executor | None = None
) -> dict[str, int]:
    """Write the dataset of `scene` to `path` and return {reason: count} of the draws that were
    rejected.

    The result depends on the scene alone, not on the number of worker processes, on the `executor`
    (see fem.workers) or on interruptions: finished interactions wait in a folder beside `path`.
    Where the mass is scaled a sample of them is simulated again at the true mass, see
    fem.data.confirm. Raises InputError where another process writes to `path`, no draw is fit, or
    the sample is too far from the true mass.
    """
    path, mesh = Path(path), scene.mesh.build()
    # a scene that cannot start fails here, not in a worker
    scene.build_solver(mesh)
    scene.mesh.embed(mesh)
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the path of a file")
    with lock(path):
        folder, run = _waiting(path, scene, mesh), (path.name, workers, executor)
        parts = _simulated(scene, mesh, folder, *run)
        confirmation = _confirmed(scene, mesh, parts, folder, *run)
        check_confirmed(scene, confirmation)
        write_dataset(path, scene, mesh, map(_read, parts.values()), confirmation)
        rejected = sum((Counter(_read(part)["rejected"]) for part in parts.values()), Counter())
        _remove_waiting(path)
    return dict(rejected)


def _simulated(
    scene: Scene,
    mesh: HexMesh,
    folder: Path,
    title: str,
    workers: int | None,
    executor: Executor | None,
) -> dict[tuple[str, int], Path]:
    """The files of all interactions (split, number) in `folder`; those that are not there are
    simulated."""
    make_folder(folder)
    paths = {which: folder / "{}-{:04d}.npz".format(*which) for which in scene.interactions.all()}
    todo = [which for which, path in paths.items() if not path.is_file()]
    on_all_cores(
        healthy_interaction,
        [(scene, mesh, *which) for which in todo],
        f"simulating {title}",
        executor=executor,
        workers=workers,
        keep=lambda task, result: _write(paths[task[2:]], result),
        unit="interaction",
        before=len(paths) - len(todo),
    )
    return paths


def _confirmed(
    scene: Scene,
    mesh: HexMesh,
    parts: dict[tuple[str, int], Path],
    folder: Path,
    title: str,
    workers: int | None,
    executor: Executor | None,
) -> list[Confirmation]:
    """The sample at the true mass; what is not in `folder` is simulated."""
    paths = {which: folder / "true-mass-{}-{:04d}.json".format(*which) for which in sampled(scene)}
    todo = []
    for which, path in paths.items():
        if not path.is_file():
            part = _read(parts[which])
            contacts = table_contacts(part["contacts"])
            todo.append((scene, mesh, *which, contacts, part["displacement"]))
    if todo:
        on_all_cores(
            confirmed,
            todo,
            f"confirming {title}",
            executor=executor,
            workers=workers,
            keep=lambda task, found: write_text(paths[task[2:4]], json.dumps(found)),
            unit="interaction",
            before=len(paths) - len(todo),
        )
    return [Confirmation(*json.loads(path.read_text())) for path in paths.values()]


def _write(path: Path, result: dict) -> None:
    save_arrays(path, **result | {"rejected": json.dumps(result["rejected"])})


def _read(path: Path) -> dict:
    with np.load(path) as part:
        return {name: part[name] for name in part.files if name != "rejected"} | {
            "rejected": json.loads(str(part["rejected"]))
        }


def _waiting(path: Path, scene: Scene, mesh: HexMesh) -> Path:
    """The folder beside `path` for what this code made of this scene on this mesh."""
    content = (scene.toml(), mesh.points, mesh.cells, mesh.fixed, mesh.loaded)
    return path.with_name(f".{path.name}.{digest(content, version=SIMULATION_VERSION)}.parts")


def _remove_waiting(path: Path) -> None:
    """Remove the folders of this output, those of other scenes or older code too."""
    name = re.compile(rf"\.{re.escape(path.name)}\.[0-9a-f]+\.parts")
    for folder in list(path.parent.iterdir()):
        if name.fullmatch(folder.name):
            shutil.rmtree(folder)
