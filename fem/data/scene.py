"""A scene: everything that one dataset depends on, read from a TOML file."""

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fem import settings as config
from fem.cache import digest
from fem.contact.draw import ContactRange
from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.material.kinds import from_table, to_table
from fem.mesh.embedding import Embedding
from fem.mesh.node_grid import node_grid
from fem.mesh.read import read_mesh
from fem.mesh.shapes import TUMOUR_EDGE, box, tumour
from fem.solver.explicit import Solver

SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class MeshChoice:
    """kind: "tumour", "box" or "file" ("file" if a file is given, else "tumour").

    edge: of a cube of the tumour or box, m; cells: of the box along x, y, z
    file: mesh to read, relative to the scene file; scale: m per unit of length in it, 1 if left out
    fixed, loaded: selections of the held nodes and of the surface to push on, see fem.mesh.select
    and fem.mesh.read
    grid: (nx, ny, nz) nodes of the grid to embed the mesh in, also if it lies on one of its own
    sha256: of the mesh file; load_scene fills it in, so that a changed mesh makes another scene
    """

    kind: Literal["tumour", "box", "file"] | None = None
    edge: float | None = None
    cells: tuple[int, int, int] | None = None
    file: str | None = None
    scale: float | None = None
    fixed: str | None = None
    loaded: str | None = None
    grid: tuple[int, int, int] | None = None
    sha256: str | None = None
    folder: str = field(
        default="", init=False, compare=False, repr=False
    )  # of the scene file, where `file` is looked for

    def __post_init__(self):
        kind = self.kind or ("file" if self.file else "tumour")
        foreign = (
            ("edge", "cells")
            if kind == "file"
            else ("file", "scale", "fixed", "loaded", "grid", "sha256")
        )
        for name in foreign:
            if getattr(self, name) is not None:
                raise InputError(
                    f"mesh.{name} = {getattr(self, name)!r} has no meaning for mesh.kind = '{kind}'; leave it out"
                )
        defaults = {"scale": 1.0} if kind == "file" else {"edge": TUMOUR_EDGE, "cells": (16, 16, 7)}
        for name, value in ({"kind": kind} | defaults).items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        if kind == "file" and not self.file:
            raise InputError("mesh.kind = 'file' needs mesh.file, such as 'liver.vtu'")
        for name in ("scale",) if kind == "file" else ("edge",):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"mesh.{name} = {getattr(self, name)} m must be positive")

    def located(self, folder):
        """This choice with its file found in `folder` and its content known."""
        if self.kind != "file":
            return self
        path = Path(folder, self.file)
        if not path.is_file():
            raise InputError(f"no mesh file {path}; mesh.file is relative to the scene file")
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        if self.sha256 not in (None, sha256):
            raise InputError(
                f"{path} is another mesh than mesh.sha256 = '{self.sha256}' says; restore the mesh or leave mesh.sha256 out"
            )
        found = replace(self, sha256=sha256)
        object.__setattr__(found, "folder", str(folder))
        return found

    def build(self):
        """The HexMesh, with its node grid if it lies on one and none is asked for."""
        if self.kind == "tumour":
            return tumour(self.edge)
        if self.kind == "box":
            return box(self.cells, self.edge)
        found = read_mesh(Path(self.folder, self.file), self.scale, self.fixed, self.loaded)
        lies_on = None if self.grid else node_grid(found)
        return replace(found, grid_shape=lies_on[0], grid_index=lies_on[1]) if lies_on else found

    def embed(self, hex_mesh):
        """The Embedding of a mesh that `build` gave, or None if it lies on a node grid itself."""
        return Embedding(hex_mesh, self.grid) if hex_mesh.grid_shape is None else None


@dataclass(frozen=True)
class SolverChoice:
    """See fem.solver.explicit.Solver for the meaning and units of each."""

    element: Literal["full", "mean_dilatation", "reduced"] = "full"
    precision: Literal["float32", "float64"] = "float32"
    hourglass_stiffness: float | None = None
    damping: float = 0.0
    mass_scaling: float = 1.0
    safety: float = 0.85

    def __post_init__(self):
        # the solver's default; the other elements have no use for it, so that there it must not
        # make two scenes of one
        stiffness = (
            (0.2 if self.hourglass_stiffness is None else self.hourglass_stiffness)
            if self.element == "reduced"
            else None
        )
        object.__setattr__(self, "hourglass_stiffness", stiffness)


@dataclass(frozen=True)
class Frames:
    """count frames, `interval` s apart; the first is the state at rest."""

    count: int
    interval: float

    def __post_init__(self):
        if self.count < 2 or not 0 < self.interval < np.inf:
            raise InputError(
                f"frames: count = {self.count} must be at least 2 and interval = {self.interval} s positive"
            )

    @property
    def times(self):
        return np.arange(self.count) * self.interval

    @property
    def duration(self):
        return (self.count - 1) * self.interval


@dataclass(frozen=True)
class Interactions:
    """How many interactions each split has, numbered from 1, and the seed of all.

    hard: (first, last) numbers of the test interactions whose peak forces are `hard_force` (low,
    high) times the largest in contact.force, so that they lie outside the training data.
    """

    seed: int
    train: int
    validation: int
    test: int
    hard: tuple[int, int] = (78, 85)
    hard_force: tuple[float, float] = (1.3, 1.6)

    def __post_init__(self):
        for name in SPLITS:
            if getattr(self, name) < 1:
                raise InputError(f"interactions.{name} = {getattr(self, name)} must be at least 1")
        if self.seed < 0:
            raise InputError(f"interactions.seed = {self.seed} must not be negative")
        if not (1 <= self.hard[0] <= self.hard[1] <= self.test):
            raise InputError(
                f"interactions.hard = {list(self.hard)} must be first and last number within the {self.test} test interactions"
            )
        if not 1 <= self.hard_force[0] <= self.hard_force[1] < np.inf:
            raise InputError(
                f"interactions.hard_force = {list(self.hard_force)} must be two factors from low to high, at least 1"
            )

    def all(self):
        """[(split, number)] of every interaction, in the order of the dataset."""
        return [
            (split, number) for split in SPLITS for number in range(1, getattr(self, split) + 1)
        ]

    def is_hard(self, split, number):
        return split == "test" and self.hard[0] <= number <= self.hard[1]


@dataclass(frozen=True)
class Health:
    """What a sequence must fulfil to enter a dataset: energy imbalance, smallest J, kinetic over
    strain energy."""

    imbalance: float = 0.01
    min_J: float = 0.15
    kinetic_share: float = 0.05


@dataclass(frozen=True)
class Scene:
    """Mesh, material, solver, contacts and interactions of one dataset."""

    material: Hyperelastic = field(metadata={"build": from_table})
    contact: ContactRange
    frames: Frames
    interactions: Interactions
    mesh: MeshChoice = field(default_factory=MeshChoice)
    solver: SolverChoice = field(default_factory=SolverChoice)
    health: Health = field(default_factory=Health)

    def toml(self):
        return config.dump_toml(self._tree())

    def digest(self):
        """Eight hexadecimal digits that change with every setting."""
        return digest(self._tree())[:8]

    def _tree(self):
        tree = config.to_dict(self) | {"material": to_table(self.material)}
        del tree["mesh"]["folder"]  # where the scene lies is no part of it
        return tree

    def build_solver(self, hex_mesh):
        return Solver(hex_mesh, self.material, **config.to_dict(self.solver))


def load_scene(path):
    """The Scene in the TOML file at `path`. Raises InputError that names a wrong key or value, or a
    missing mesh file."""
    scene = config.build(Scene, config.read_toml(path))
    return replace(scene, mesh=scene.mesh.located(Path(path).parent))
