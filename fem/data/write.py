"""Write the interactions of a scene to one HDF5 file, whole or not at all. The schema is described
in docs/data.md."""

import json
import os
from collections import Counter
from pathlib import Path

import h5py
import numpy as np

from fem.data.dataset import FIELDS, FORMAT, UNITS
from fem.data.grid import on_grid
from fem.measure.machine import versions
from fem.solver.energy import COLUMNS

HEALTH = ("imbalance", "min_J", "kinetic_share", "hourglass_share", "steps")


def write_dataset(path, scene, mesh, results):
    """Write the interactions `results` (dicts of fem.data.interaction, in the order of
    scene.interactions.all()) to `path`.

    A temporary file beside it takes its place only when it is complete.
    """
    path = Path(path)
    embedding = scene.mesh.embed(mesh)
    grid_mesh = embedding.grid_mesh if embedding else mesh
    squared_loss = squared_size = 0.0
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    order = scene.interactions.all()
    frames, grid = scene.frames.count, (*grid_mesh.grid_shape, 3)
    rejected = Counter()
    try:
        with h5py.File(partial, "w") as file:
            file.attrs["format"] = FORMAT
            file.attrs["scene"] = scene.toml()
            file.attrs["scene_digest"] = scene.digest()
            file.attrs["seed"] = scene.interactions.seed
            file.attrs["versions"] = json.dumps(versions())
            make = {
                "chunks": (1, frames, *grid),
                "compression": "gzip",
                "compression_opts": 1,
                "shuffle": True,
            }
            fields = {
                k: file.create_dataset(k, (len(order), frames, *grid), "f4", **make) for k in FIELDS
            }
            own = {}  # the FEM's own fields, where the grid has them only approximately
            if embedding:
                make["chunks"] = 1, frames, mesh.n_nodes, 3
                own = {
                    k: file.create_dataset(
                        f"mesh/{k}", (len(order), frames, mesh.n_nodes, 3), "f4", **make
                    )
                    for k in FIELDS
                }
                file["mesh/points"], file["mesh/cells"], file["mesh/fixed"] = (
                    mesh.points * 1e3,
                    mesh.cells,
                    mesh.fixed,
                )
            if mesh.loaded is not None:
                file["mesh/loaded" if embedding else "loaded"] = (
                    mesh.loaded if embedding else mesh.to_grid(mesh.loaded[:, None])[..., 0]
                )
            energy = file.create_dataset("energy", (len(order), frames, len(COLUMNS) - 1), "f8")
            energy.attrs["columns"] = json.dumps(COLUMNS[1:])
            volume = file.create_dataset("volume", (len(order), frames), "f8")
            health = {
                k: file.create_dataset(f"health/{k}", (len(order),), "i8" if k == "steps" else "f8")
                for k in HEALTH
            }
            for i, result in enumerate(results):
                for name, values in zip(
                    FIELDS, on_grid(mesh, embedding, *(result[name] for name in FIELDS))
                ):
                    fields[name][i] = values
                for name, field in own.items():
                    field[i] = result[name]
                if embedding:
                    back = embedding.to_mesh(
                        grid_mesh.from_grid(values)
                    )  # the displacement, the last of FIELDS
                    squared_loss += np.sum(np.square(back - result["displacement"], dtype=float))
                    squared_size += np.sum(np.square(result["displacement"], dtype=float))
                volume[i], energy[i] = result["volume"], result["energy"]
                for name, column in health.items():
                    column[i] = result[name]
                rejected.update(result["rejected"])
            file.attrs["rejected"] = json.dumps(rejected)
            file.attrs["embedding_error"] = (
                float(np.sqrt(squared_loss / squared_size)) if squared_size else 0.0
            )
            file["time"] = scene.frames.times
            file["split"] = np.array([split for split, _ in order], "S10")
            file["number"] = [number for _, number in order]
            file["hard"] = [scene.interactions.is_hard(*which) for which in order]
            file["mask"] = grid_mesh.to_grid(np.ones((grid_mesh.n_nodes, 1), bool))[..., 0]
            file["fixed"] = grid_mesh.to_grid(grid_mesh.fixed[:, None])[..., 0]
            file["points"] = grid_mesh.to_grid(grid_mesh.points * 1e3)
            file["cells"] = grid_mesh.grid_index[grid_mesh.cells]
            for name, unit in UNITS.items():
                for where in (name, f"mesh/{name}"):
                    if where in file:
                        file[where].attrs["unit"] = unit
        with open(partial, "rb") as done:
            os.fsync(done.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
