"""The HDF5 file of a scene's interactions: written whole or not at all, and checked when it is
opened.

The schema is described in docs/data.md.
"""

import json
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import h5py
import numpy as np

from fem import settings as config
from fem.data.grid import on_grid
from fem.data.scene import SPLITS, Scene
from fem.errors import InputError
from fem.mesh.hexmesh import HexMesh

FORMAT = "unet-fem dataset 1"
UNITS = {
    "force": "mN",
    "displacement": "mm",
    "volume": "mm3",
    "points": "mm",
    "time": "s",
    "energy": "J",
}
FIELDS = ("force", "displacement")


@dataclass(frozen=True)
class Dataset:
    """An opened dataset: its description in memory, its fields read split by split.

    time (frames,) s; split and number (interactions,); hard (interactions,) bool; mask (nx, ny, nz)
    of material nodes; fixed (nx, ny, nz) of held nodes; points (nx, ny, nz, 3) mm; cells (E, 8) as
    indices into the node grid, C order;
    embedding_error: relative L2 error of displacement taken to the grid and back, 0 where the mesh
    lies on the grid.
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
    embedding_error: float = 0.0

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

    @cached_property
    def surface(self):
        """(points (nx*ny*nz, 3) mm, faces (M, 4)): grid nodes and the boundary quads between them,
        outward."""
        return self.points.reshape(-1, 3), self.mesh.grid_index[self.mesh.boundary_faces]

    def read(self, split):
        """{force mN, displacement mm (interactions, frames, nx, ny, nz, 3), volume mm3
        (interactions, frames), hard, number}."""
        if split not in SPLITS:
            raise InputError(f"split '{split}' is not one of {', '.join(SPLITS)}")
        rows = np.flatnonzero(self.split == split)
        with _opened(self.path) as file:
            fields = {
                name: file[name][rows[0] : rows[-1] + 1]
                for name in ("force", "displacement", "volume")
            }
        for name, values in fields.items():
            if not np.isfinite(values).all():
                raise InputError(
                    f"{self.path} holds values that are not finite in {name} ({split}); delete it and generate it again"
                )
        return fields | {"hard": self.hard[rows], "number": self.number[rows]}

    @cached_property
    def fem_mesh(self):
        """The HexMesh in m that the interactions were simulated on: `mesh`, or one that is embedded
        in the grid."""
        with _opened(self.path) as file:
            if "mesh" in file:
                own = {
                    name: values[()] for name, values in file["mesh"].items() if name not in FIELDS
                }
                return HexMesh(**own | {"points": own["points"] * 1e-3})
            loaded = (
                self.mesh.from_grid(file["loaded"][()][..., None])[:, 0]
                if "loaded" in file
                else None
            )
        return replace(self.mesh, points=self.mesh.points * 1e-3, loaded=loaded)

    @cached_property
    def embedding(self):
        """The Embedding of fem_mesh in the grid, or None if its nodes lie on the grid."""
        return self.scene.mesh.embed(self.fem_mesh)

    def on_grid(self, force, displacement):
        """Force and displacement (..., N, 3) at the nodes of fem_mesh on the grid: (..., nx, ny,
        nz, 3)."""
        return on_grid(self.fem_mesh, self.embedding, force, displacement)

    def sequence(self, split, number):
        """Interaction `number` of `split` on the mesh that it was simulated on, a Sequence. Raises
        InputError if there is none."""
        rows = np.flatnonzero((self.split == split) & (self.number == number))
        if not rows.size:
            have = ", ".join(f"{name} 1 to {(self.split == name).sum()}" for name in SPLITS)
            raise InputError(f"{self.path} has no {split} interaction {number}; it has {have}")
        mesh, row = self.fem_mesh, rows[0]
        with _opened(self.path) as file:
            energy = {}  # files from before it was kept have none
            if "energy" in file:
                energy = dict(
                    zip(json.loads(file["energy"].attrs["columns"]), file["energy"][row].T)
                )
            if "mesh" in file:
                fields = {name: file[f"mesh/{name}"][row] for name in FIELDS}
            else:
                fields = {name: mesh.from_grid(file[name][row]) for name in FIELDS}
        return Sequence(replace(mesh, points=mesh.points * 1e3), self.time, **fields, energy=energy)


@dataclass(frozen=True)
class Sequence:
    """One interaction: mesh in mm, time (frames,) s, force (frames, N, 3) mN, displacement (frames,
    N, 3) mm, energy {column: (frames,) J}."""

    mesh: HexMesh
    time: np.ndarray
    force: np.ndarray
    displacement: np.ndarray
    energy: dict


def open_dataset(path):
    """The Dataset at `path`. Raises InputError if it is missing, damaged, or not one of ours."""
    path = Path(path)
    if not path.is_file():
        raise InputError(
            f"no dataset {path}; make it with python -m fem.generate configs/<scene>.toml --out {path}"
        )
    with _opened(path) as file:
        if file.attrs.get("format") != FORMAT:
            raise InputError(
                f"{path} is not a '{FORMAT}' file (format: {file.attrs.get('format')}); generate it again"
            )
        arrays = {
            name: file[name][()]
            for name in ("time", "number", "hard", "mask", "fixed", "points", "cells")
        }
        split = file["split"][()].astype(str)
        tree = config.tomllib.loads(file.attrs["scene"])
        lost = float(file.attrs.get("embedding_error", 0.0))
    return Dataset(
        path=path, scene=config.build(Scene, tree), split=split, embedding_error=lost, **arrays
    )


@contextmanager
def _opened(path):
    """The HDF5 file at `path`, open for reading; what is missing or unreadable in it is an
    InputError."""
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(
            f"{path} cannot be read as HDF5 ({str(error).split('(')[-1].rstrip(')')}); delete it and generate it again"
        ) from None
    with file:
        try:
            yield file
        except (KeyError, OSError) as error:
            raise InputError(
                f"{path} is damaged ({error}); delete it and generate it again"
            ) from None
