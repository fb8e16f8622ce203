"""Write the interactions of a scene to one HDF5 file, whole or not at all. The schema is described
in docs/data.md."""

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from fem.contact.table import TABLE, contact_table
from fem.data.confirm import Confirmation
from fem.data.grid import displacement_from_grid, displacement_on_grid, force_on_grid
from fem.data.hdf5 import new_hdf5
from fem.data.scene import Scene
from fem.data.schema import CONFIRMATION, FIELDS, FORMAT, UNITS
from fem.errors import InputError
from fem.measure.machine import versions
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MM
from fem.solver.energy import COLUMNS
from fem.solver.gate import Signs

HEALTH = ("imbalance", "min_J", "kinetic_share", *Signs._fields, "steps")


def write_dataset(
    path: str | Path,
    scene: Scene,
    mesh: HexMesh,
    results: Iterable[dict[str, Any]],
    confirmation: Iterable[Confirmation] = (),
) -> None:
    """Write the interactions `results` (dicts of fem.data.interaction, in the order of
    scene.interactions.all()) to `path`, with the confirmation of some of them.

    A temporary file beside it takes its place only when it is complete.
    """
    embedding = scene.mesh.embed(mesh)
    with new_hdf5(path) as file:
        _describe(file, scene)
        file.attrs["mesh_digest"] = mesh.digest
        _write_grid(file, embedding.grid_mesh if embedding else mesh)
        _write_mesh(file, mesh)
        columns = _columns(file, scene, mesh, file["mask"].shape)
        order = groups(scene)
        rejected: dict[str, Counter] = {group: Counter() for group in order}
        lost = size = 0.0  # mm2
        for i, result in enumerate(results):
            displacement = displacement_on_grid(mesh, embedding, result["displacement"])
            row = result | {
                "force": force_on_grid(mesh, embedding, result["force"]),
                "displacement": displacement,
                "contacts": _table(result["contacts"], scene.contact.count),
            }
            if embedding:
                row |= {f"mesh/{name}": result[name] for name in FIELDS}
                back = displacement_from_grid(mesh, embedding, displacement)
                lost += np.sum(np.square(back - result["displacement"], dtype=float))
                size += np.sum(np.square(result["displacement"], dtype=float))
            for name, column in columns.items():
                column[i] = row[name.removeprefix("health/")]
            rejected[order[i]].update(result["rejected"])
        if rows := [tuple(one) for one in confirmation]:
            file["confirmation"] = np.array(rows, CONFIRMATION)
        file.attrs["rejected"] = json.dumps(sum(rejected.values(), Counter()))
        file.attrs["rejected_by_split"] = json.dumps(rejected)
        file.attrs["embedding_error"] = float(np.sqrt(lost / size)) if size else 0.0
        for name, unit in UNITS.items():
            if name in file:
                file[name].attrs["unit"] = unit


def groups(scene: Scene) -> list[str]:
    """The name of what each interaction's refused draws are counted under, in the order of
    scene.interactions.all(): its split, and "test, hard" for the hard ones of the test."""
    return [
        "test, hard" if split == "test" and scene.interactions.is_hard(split, number) else split
        for split, number in scene.interactions.all()
    ]


def _describe(file, scene):
    """What stands for the whole file: its origin, and which interaction is where."""
    file.attrs["format"] = FORMAT
    file.attrs["scene"] = scene.toml()
    file.attrs["scene_digest"] = scene.digest()
    file.attrs["seed"] = scene.interactions.seed
    file.attrs["versions"] = json.dumps(versions())
    order = scene.interactions.all()
    file["time"] = scene.frames.times
    file["split"] = np.array([split for split, _ in order], "S10")
    file["number"] = [number for _, number in order]
    file["hard"] = [scene.interactions.is_hard(*which) for which in order]


def _write_grid(file, grid_mesh):
    """What the networks see of the mesh."""
    grid = grid_mesh.grid
    file["mask"] = grid.mask
    file["fixed"] = grid.to_grid(grid_mesh.fixed[:, None])[..., 0]
    file["points"] = grid.to_grid(grid_mesh.points * MM)
    file["cells"] = grid.index[grid_mesh.cells]


def _write_mesh(file, mesh):
    """The mesh that was simulated, whole and to the bit: fem.data.dataset.read_mesh_group."""
    group = file.create_group("mesh")
    group["points"], group["cells"], group["fixed"] = mesh.points, mesh.cells, mesh.fixed
    if mesh.loaded is not None:
        group["loaded"] = mesh.loaded
    if mesh.grid is not None:
        group["grid_index"] = mesh.grid.index
    for kind in ("node_sets", "cell_sets"):
        sets = getattr(mesh, kind)
        if sets:
            group.create_dataset(kind, data=np.array(list(sets.values())), compression="gzip")
            group[kind].attrs["names"] = json.dumps(list(sets))


def _columns(file, scene, mesh, grid):
    """{name: HDF5 array} of all that has a row for each interaction."""
    count, frames = len(scene.interactions.all()), scene.frames.count

    def fields(where, shape):
        packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        chunk = (1, frames, *shape)
        for name in FIELDS:
            yield (
                f"{where}{name}",
                file.create_dataset(
                    f"{where}{name}", (count, frames, *shape), "f4", chunks=chunk, **packed
                ),
            )

    columns = dict(fields("", (*grid, 3)))
    if mesh.grid is None:  # the grid has the FEM's own fields only approximately
        columns |= dict(fields("mesh/", (mesh.n_nodes, 3)))
    columns["volume"] = file.create_dataset("volume", (count, frames), "f8")
    columns["energy"] = file.create_dataset("energy", (count, frames, len(COLUMNS) - 1), "f8")
    columns["energy"].attrs["columns"] = json.dumps(COLUMNS[1:])
    columns["contacts"] = file.create_dataset("contacts", (count, scene.contact.count), TABLE)
    for name in HEALTH:
        kind = "i8" if name == "steps" else "f8"
        columns[f"health/{name}"] = file.create_dataset(f"health/{name}", (count,), kind)
    return columns


def _table(contacts, count):
    table = contacts if isinstance(contacts, np.ndarray) else contact_table(contacts)
    if len(table) != count:
        raise InputError(
            f"an interaction has {len(table)} contacts, and contact.count = {count}; give as many"
        )
    return table
