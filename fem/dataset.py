"""The HDF5 file of a scene's interactions: written whole or not at all, and checked when it is opened.

The schema is described in docs/data.md.
"""

import json
import os
import platform
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np

from fem import config
from fem.errors import InputError
from fem.mesh import HexMesh
from fem.scene import SPLITS, Scene

FORMAT = "unet-fem dataset 1"
UNITS = {"force": "mN", "displacement": "mm", "volume": "mm3", "points": "mm", "time": "s"}
HEALTH = ("imbalance", "min_J", "kinetic_share", "hourglass_share", "steps")


def write_dataset(path, scene, mesh, results):
    """Write the interactions `results` (dicts of fem.interaction, in the order of scene.interactions.all()) to `path`.

    A temporary file beside it takes its place only when it is complete.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    order = scene.interactions.all()
    frames, grid = scene.frames.count, (*mesh.grid_shape, 3)
    rejected = Counter()
    try:
        with h5py.File(partial, "w") as file:
            file.attrs["format"] = FORMAT
            file.attrs["scene"] = scene.toml()
            file.attrs["scene_digest"] = scene.digest()
            file.attrs["seed"] = scene.interactions.seed
            file.attrs["versions"] = json.dumps(versions())
            make = {"chunks": (1, frames, *grid), "compression": "gzip", "compression_opts": 1, "shuffle": True}
            fields = [file.create_dataset(k, (len(order), frames, *grid), "f4", **make) for k in ("force", "displacement")]
            volume = file.create_dataset("volume", (len(order), frames), "f8")
            health = {k: file.create_dataset(f"health/{k}", (len(order),), "i8" if k == "steps" else "f8") for k in HEALTH}
            for i, result in enumerate(results):
                for field in fields:
                    field[i] = mesh.to_grid(result[field.name.strip("/")])
                volume[i] = result["volume"]
                for name, column in health.items():
                    column[i] = result[name]
                rejected.update(result["rejected"])
            file.attrs["rejected"] = json.dumps(rejected)
            file["time"] = scene.frames.times
            file["split"] = np.array([split for split, _ in order], "S10")
            file["number"] = [number for _, number in order]
            file["hard"] = [scene.interactions.is_hard(*which) for which in order]
            file["mask"] = mesh.to_grid(np.ones((mesh.n_nodes, 1), bool))[..., 0]
            file["fixed"] = mesh.to_grid(mesh.fixed[:, None])[..., 0]
            file["points"] = mesh.to_grid(mesh.points * 1e3)
            file["cells"] = mesh.grid_index[mesh.cells]
            for name, unit in UNITS.items():
                file[name].attrs["unit"] = unit
        with open(partial, "rb") as done:
            os.fsync(done.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def versions():
    """Versions of what the numbers depend on."""
    return {"python": platform.python_version()} | {name: version(name) for name in ("unet-fem", "numpy", "scipy", "h5py")}


@dataclass(frozen=True)
class Dataset:
    """An opened dataset: its description in memory, its fields read split by split.

    time (frames,) s; split and number (interactions,); hard (interactions,) bool; mask (nx, ny, nz) of material nodes;
    fixed (nx, ny, nz) of held nodes; points (nx, ny, nz, 3) mm; cells (E, 8) as indices into the node grid, C order.
    """

    path: Path
    scene: Scene
    time: np.ndarray
    split: np.ndarray
    number: np.ndarray
    hard: np.ndarray
    mask: np.ndarray
    fixed: np.ndarray
    points: np.ndarray
    cells: np.ndarray

    @property
    def grid(self):
        return self.mask.shape

    @property
    def free(self):
        """(nx, ny, nz) bool: nodes that can move."""
        return self.mask & ~self.fixed

    @cached_property
    def mesh(self):
        """The HexMesh in mm, with the nodes of the grid that carry material."""
        index = np.flatnonzero(self.mask)
        place = np.cumsum(self.mask.ravel()) - 1
        points = self.points.reshape(-1, 3)[index].astype(float)
        return HexMesh(points, place[self.cells], self.fixed.ravel()[index], self.grid, index)

    def read(self, split):
        """{force mN, displacement mm (interactions, frames, nx, ny, nz, 3), volume mm3 (interactions, frames), hard, number}."""
        if split not in SPLITS:
            raise InputError(f"split '{split}' is not one of {', '.join(SPLITS)}")
        rows = np.flatnonzero(self.split == split)
        with _opened(self.path) as file:
            fields = {name: file[name][rows[0] : rows[-1] + 1] for name in ("force", "displacement", "volume")}
        for name, values in fields.items():
            if not np.isfinite(values).all():
                raise InputError(f"{self.path} holds values that are not finite in {name} ({split}); delete it and generate it again")
        return fields | {"hard": self.hard[rows], "number": self.number[rows]}


def open_dataset(path):
    """The Dataset at `path`. Raises InputError if it is missing, damaged, or not one of ours."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"no dataset {path}; make it with python -m fem.generate configs/<scene>.toml --out {path}")
    with _opened(path) as file:
        if file.attrs.get("format") != FORMAT:
            raise InputError(f"{path} is not a '{FORMAT}' file (format: {file.attrs.get('format')}); generate it again")
        try:
            arrays = {name: file[name][()] for name in ("time", "number", "hard", "mask", "fixed", "points", "cells")}
            split = file["split"][()].astype(str)
            tree = config.tomllib.loads(file.attrs["scene"])
        except (KeyError, OSError) as error:
            raise InputError(f"{path} is damaged ({error}); delete it and generate it again") from None
    return Dataset(path=path, scene=config.build(Scene, tree), split=split, **arrays)


def _opened(path):
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path} cannot be read as HDF5 ({str(error).split('(')[-1].rstrip(')')}); delete it and generate it again") from None
