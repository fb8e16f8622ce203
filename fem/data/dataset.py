"""The HDF5 file of a scene's interactions: written whole or not at all, and checked when it is
opened.

The schema is described in docs/data.md.
"""

import json
import math
import tomllib
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import h5py
import numpy as np

from fem import settings as config
from fem.contact.push import Contact
from fem.contact.table import table_contacts
from fem.data.draws import redrawn_contacts
from fem.data.grid import displacement_on_grid, force_on_grid, grid_of
from fem.data.scene import SPLITS, Scene
from fem.data.schema import (
    AT_ONCE,
    CONFIRMATION,
    FIELDS,
    FIRST_FORMAT,
    FORMAT,
    check_contents,
    check_members,
    damaged,
)
from fem.errors import InputError
from fem.files import checked_path
from fem.material.base import Hyperelastic
from fem.memory import require_memory
from fem.mesh import element
from fem.mesh.embedding import Embedding
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MM, NodeGrid

READ = (*FIELDS, "volume")


@dataclass(frozen=True)
class Dataset:
    """An opened dataset: its description in memory, its fields read split by split.

    format: FORMAT or FIRST_FORMAT
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
    format: str = FORMAT

    @property
    def grid(self) -> tuple[int, int, int]:
        """(nx, ny, nz) nodes of the networks' grid."""
        return self.mask.shape

    @property
    def free(self) -> np.ndarray:
        """(nx, ny, nz) bool: nodes that can move."""
        return self.mask & ~self.fixed

    @cached_property
    def mesh(self) -> HexMesh:
        """What the networks see as a HexMesh (m): the nodes of the grid that carry material, in its
        order.

        It is an image of `fem_mesh`, with its nodes where they lie on the grid.
        """
        index = np.flatnonzero(self.mask)
        place = np.cumsum(self.mask.ravel()) - 1
        points = self.points.reshape(-1, 3)[index] / MM
        grid = NodeGrid(self.grid, index)
        return HexMesh(points, place[self.cells], self.fixed.ravel()[index], grid)

    @cached_property
    def rest_volume(self) -> float:
        """mm3 of the networks' cells at rest, to judge the volume of a prediction by."""
        return float(element.gauss_volumes(self.points.reshape(-1, 3), self.cells).sum())

    @cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """(points (nx*ny*nz, 3) mm, faces (M, 4)): grid nodes and the boundary quads between them,
        outward."""
        return self.points.reshape(-1, 3), grid_of(self.mesh).index[self.mesh.boundary_faces]

    def read(
        self, split: str, fields: Collection[str] = READ, numbers: Iterable[int] | None = None
    ) -> dict[str, np.ndarray]:
        """{force mN, displacement mm (interactions, frames, nx, ny, nz, 3), volume mm3
        (interactions, frames), hard, number} of a split.

        fields: those to load, of the first three; numbers: of the interactions to load, in this
        order; all if left out. Raises InputError for what there is not, and for values that are not
        finite.
        """
        unknown = [name for name in fields if name not in READ]
        if unknown or isinstance(fields, str):
            raise InputError(f"fields = {fields!r} are not some of {', '.join(READ)}")
        if split not in SPLITS:
            raise InputError(f"split '{split}' is not one of {', '.join(SPLITS)}")
        rows = np.flatnonzero(self.split == split)
        if not rows.size:
            raise InputError(
                f"{self.path} has no {split} interactions; set interactions."
                f"{'hard_set' if split == 'hard' else split} in its scene and generate it again"
            )
        if numbers is not None:
            rows = np.array([self._row(split, number) for number in numbers], int)
        whole = len(rows) and np.array_equal(rows, np.arange(rows[0], rows[0] + len(rows)))
        with _opened(self.path) as file:
            shapes = [file[name].shape[1:] for name in fields]
            size = 4 * len(rows) * sum(math.prod(shape) for shape in shapes)
            require_memory(size, f"the {split} interactions of {self.path}")
            found = {
                name: file[name][rows[0] : rows[-1] + 1]
                if whole
                else np.array([file[name][row] for row in rows])
                for name in fields
            }
            self._check_finite(found, split)
        return found | {"hard": self.hard[rows], "number": self.number[rows]}

    def contacts(self, split: str, number: int) -> list[Contact]:
        """The contacts that pushed in interaction `number` of `split`; where the file is from
        before they were kept, they are drawn again."""
        row = self._row(split, number)
        with _opened(self.path) as file:
            if "contacts" in file:
                return table_contacts(file["contacts"][row])
        force = self.sequence(split, number).force
        return redrawn_contacts(self.scene, self.fem_mesh, force, split, number)

    @cached_property
    def confirmation(self) -> np.ndarray:
        """(interactions simulated again at the true mass,) with the fields `split`, `number` and
        `error`, the relative L2 distance of the displacement from it."""
        with _opened(self.path) as file:
            return file["confirmation"][()] if "confirmation" in file else np.empty(0, CONFIRMATION)

    @cached_property
    def fem_mesh(self) -> HexMesh:
        """The HexMesh (m) that the interactions were simulated on, read from the file: whole and to
        the bit, or, from the first format, by way of mm and of the grid. Raises InputError where it
        is not the mesh that was written, or the grid's points are not its own."""
        with _opened(self.path) as file:
            if self.format == FORMAT:
                mesh = read_mesh_group(file["mesh"], self.grid)
                self._check_mesh(mesh, file.attrs.get("mesh_digest"))
                return mesh
            if "mesh" in file:
                return read_mesh_group(file["mesh"], self.grid, MM)
            loaded = file["loaded"][()] if "loaded" in file else None
        if loaded is None:
            return self.mesh
        return self.mesh.with_sets(loaded=grid_of(self.mesh).from_grid(loaded[..., None])[:, 0])

    @property
    def material(self) -> Hyperelastic:
        """The law of `fem_mesh`, with the parameters of its cell groups; see Scene.material_on."""
        return self.scene.material_on(self.fem_mesh)

    @cached_property
    def rejected(self) -> dict[str, dict[str, int]]:
        """{split: {reason: count}} of the draws that were refused; empty for files from before they
        were counted by split."""
        with _opened(self.path) as file:
            found = json.loads(file.attrs.get("rejected_by_split", "{}"))
            if not isinstance(found, dict) or not all(
                isinstance(counts, dict) and all(isinstance(n, int) for n in counts.values())
                for counts in found.values()
            ):
                raise damaged(self.path, "its rejected_by_split is not counts by split")
            return found

    def _check_mesh(self, mesh, digest):
        if digest is not None and digest != mesh.digest:
            raise damaged(self.path, "'mesh' is not what was written")
        if mesh.grid is not None:
            own = mesh.grid.to_grid(mesh.points * MM)[self.mask]
            if not np.allclose(own, self.points[self.mask], rtol=0, atol=1e-6 * np.ptp(own)):
                raise damaged(self.path, "'points' are not those of its mesh")

    @cached_property
    def mesh_digest(self) -> str:
        """HexMesh.digest of fem_mesh."""
        return self.fem_mesh.digest

    def for_learning(self) -> "Dataset":
        """This dataset, to learn from and to judge by. Raises InputError for a file of the first
        format, and for one made on another mesh than its scene has now: these are for reading."""
        if self.format != FORMAT:
            raise InputError(
                f"{self.path} is a '{self.format}' file, which is for reading only: it does not"
                " hold its mesh; generate it again"
            )
        choice = self.scene.mesh
        if choice.kind in ("tumour", "box") and choice.content != self.mesh_digest:
            raise InputError(
                f"{self.path} is for reading only: it was made on another mesh than mesh.kind ="
                f" '{choice.kind}' is now; generate it again"
            )
        return self

    @cached_property
    def embedding(self) -> Embedding | None:
        """The Embedding of fem_mesh in the grid, or None if its nodes lie on the grid."""
        return self.scene.mesh.embed(self.fem_mesh)

    def force_on_grid(self, force: np.ndarray) -> np.ndarray:
        """Forces (..., N, 3) at the nodes of fem_mesh on the grid: (..., nx, ny, nz, 3)."""
        return force_on_grid(self.fem_mesh, self.embedding, force)

    def displacement_on_grid(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement (..., N, 3) at the nodes of fem_mesh on the grid: (..., nx, ny, nz, 3)."""
        return displacement_on_grid(self.fem_mesh, self.embedding, displacement)

    def on_grid(self, force: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both of them."""
        return self.force_on_grid(force), self.displacement_on_grid(displacement)

    def sequence(self, split: str, number: int) -> "Sequence":
        """Interaction `number` of `split` on the mesh that it was simulated on, a Sequence. Raises
        InputError if there is none."""
        mesh, row = self.fem_mesh, self._row(split, number)
        with _opened(self.path) as file:
            energy = {}  # files from before it was kept have none
            if "energy" in file:
                names = json.loads(file["energy"].attrs["columns"])
                energy = dict(zip(names, file["energy"][row].T, strict=True))
            if mesh.grid is None:
                fields = {name: file[f"mesh/{name}"][row] for name in FIELDS}
            else:
                fields = {name: mesh.grid.from_grid(file[name][row]) for name in FIELDS}
            self._check_finite(fields | energy, f"{split} {number}")
        return Sequence(mesh, self.time, **fields, energy=energy)

    def _check_finite(self, found, where):
        for name, values in found.items():
            if not np.isfinite(values).all():
                raise damaged(self.path, f"values are not finite in {name} ({where})")

    def _row(self, split, number):
        rows = np.flatnonzero((self.split == split) & (self.number == number))
        if not rows.size:
            have = ", ".join(
                f"{name} 1 to {(self.split == name).sum()}" for name in SPLITS if name in self.split
            )
            raise InputError(f"{self.path} has no {split} interaction {number}; it has {have}")
        return rows[0]


@dataclass(frozen=True)
class Sequence:
    """One interaction: mesh (m), time (frames,) s, force (frames, N, 3) mN, displacement (frames,
    N, 3) mm, energy {column: (frames,) J}."""

    mesh: HexMesh
    time: np.ndarray
    force: np.ndarray
    displacement: np.ndarray
    energy: dict[str, np.ndarray]


def read_mesh_group(
    group: h5py.Group, shape: tuple[int, int, int], per_metre: float = 1.0
) -> HexMesh:
    """The HexMesh in an HDF5 group, its points given in units of which a metre has `per_metre`;
    shape: of the node grid, if it lies on one."""

    def sets(kind):
        if kind not in group:
            return {}
        return dict(zip(json.loads(group[kind].attrs["names"]), group[kind][()], strict=True))

    return HexMesh(
        group["points"][()] / per_metre,
        group["cells"][()],
        group["fixed"][()],
        NodeGrid(shape, group["grid_index"][()]) if "grid_index" in group else None,
        group["loaded"][()] if "loaded" in group else None,
        sets("node_sets"),
        sets("cell_sets"),
    )


def open_dataset(path: str | Path) -> Dataset:
    """The Dataset at `path`. Raises InputError if it is missing, damaged, or not one of ours."""
    path = checked_path(path)
    if not path.is_file():
        raise InputError(
            f"no dataset {path}; make it with python -m fem.generate configs/<scene>.toml --out"
            f" {path}"
        )
    with _opened(path) as file:
        form = file.attrs.get("format")
        if form not in (FORMAT, FIRST_FORMAT):
            raise InputError(f"{path} is not a '{FORMAT}' file (format: {form}); generate it again")
        check_members(file, path)
        arrays = {name: file[name][()] for name in AT_ONCE}
        tree = tomllib.loads(file.attrs["scene"])
        if tree.get("mesh", {}).get("kind") == "tumour":
            tree["mesh"].pop("cells", None)  # migration: of the tumour's former block
        scene = config.build(Scene, tree)
        # a path in a scene file is its user's; one in a dataset is not followed
        scene = replace(scene, mesh=scene.mesh.detached())
        lost = float(file.attrs.get("embedding_error", 0.0))
        if not 0 <= lost < np.inf:
            raise damaged(path, f"its embedding_error is {lost}")
        check_contents(path, arrays, scene)
    del arrays["volume"]
    split = arrays.pop("split").astype(str)
    return Dataset(path=path, scene=scene, split=split, embedding_error=lost, format=form, **arrays)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """The HDF5 file at `path`, open for reading; what is missing or unreadable in it is an
    InputError."""
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(
            f"{path} cannot be read as HDF5 ({str(error).split('(')[-1].rstrip(')')}); delete it"
            " and generate it again"
        ) from None
    with file:
        try:
            yield file
        except InputError as error:
            if str(path) in str(error):
                raise
            raise damaged(path, str(error)) from None
        # h5py and its readers fail in many ways on bytes that are not theirs
        except (KeyError, OSError, RuntimeError, TypeError, ValueError, AttributeError) as error:
            raise damaged(path, " ".join(str(error).split())[:200]) from None
