"""Simulate the interactions of a scene in parallel, and put the finished ones together as a
dataset."""

import json
import re
import shutil
from collections import Counter
from concurrent.futures import Executor
from contextlib import suppress
from pathlib import Path

import numpy as np

from fem.cache import digest
from fem.contact.surface import surface_of
from fem.contact.table import TABLE, table_contacts
from fem.data.confirm import Confirmation, check_confirmed, confirmed, sampled
from fem.data.interaction import healthy_interaction
from fem.data.scene import Scene
from fem.data.write import write_dataset
from fem.errors import InputError
from fem.files import load_arrays, make_folder, read_json, save_arrays, vet_output, write_text
from fem.locks import lock
from fem.memory import require_disk, require_memory
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
    if not isinstance(scene, Scene):
        raise InputError(f"{str(scene)[:60]} is no Scene; take fem.load_scene")
    path, mesh = vet_output(path), scene.mesh.build()
    # a scene that cannot start fails here, not in a worker
    scene.build_solver(mesh)
    scene.mesh.embed(mesh)
    surface_of(mesh).check_footprints(*scene.contact.radius)
    require_memory(_bytes(scene, mesh), f"an interaction of frames.count = {scene.frames.count}")
    with lock(path):
        folder, run = _waiting(path, scene, mesh), (path.name, workers, executor)
        try:
            parts = _simulated(scene, mesh, folder, *run)
        finally:
            with suppress(OSError):  # it goes where nothing waits in it
                folder.rmdir()
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
    paths = {which: folder / "{}-{:04d}.npz".format(*which) for which in scene.interactions.all()}
    todo = [which for which, path in paths.items() if not _waits(path, scene, mesh)]
    require_disk(len(todo) * _bytes(scene, mesh), folder, f"{len(todo)} interactions")
    make_folder(folder)
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
        if not _confirmation(path):
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
    found = map(_confirmation, paths.values())
    return [one for one in found if one]


def _confirmation(path):
    """The Confirmation that waits in `path`, or None where there is none, or none that is whole."""
    try:
        found = read_json(path, list) if path.is_file() else []
        split, number, error = found
    except (InputError, ValueError):
        return None
    whole = isinstance(split, str) and isinstance(number, int) and isinstance(error, float)
    return Confirmation(split, number, error) if whole else None


def _bytes(scene, mesh):
    """Of the fields of one interaction, as it waits."""
    return 24 * scene.frames.count * mesh.n_nodes


def _arrays(path):
    return load_arrays(path, most=2 * path.stat().st_size + 2**20)  # they are not compressed


def _waits(path, scene, mesh):
    """Whether a whole interaction waits in `path`; one that is damaged is simulated again."""
    if not path.is_file():
        return False
    part = _arrays(path)
    fields = scene.frames.count, mesh.n_nodes, 3
    return (
        {"force", "displacement", "volume", "energy", "contacts", "rejected"} <= part.keys()
        and part["force"].shape == part["displacement"].shape == fields
        and part["volume"].shape == fields[:1]
        and part["contacts"].dtype == TABLE
        and all(np.isfinite(part[name]).all() for name in ("force", "displacement", "volume"))
    )


def _write(path: Path, result: dict) -> None:
    save_arrays(path, **result | {"rejected": json.dumps(result["rejected"])})


def _read(path: Path) -> dict:
    part = _arrays(path)
    if "rejected" not in part:
        raise InputError(f"{path} was damaged while it waited; run the same command again")
    return part | {"rejected": json.loads(str(part["rejected"]))}


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
