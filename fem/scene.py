"""A scene: everything that one dataset depends on, read from a TOML file."""

import hashlib
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fem import config, mesh
from fem.contact import ContactRange
from fem.errors import InputError
from fem.material import Material
from fem.solver import Solver

SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class MeshChoice:
    """kind: "tumour" or "box"; edge: of a cube, m; cells: of the box along x, y, z."""

    kind: Literal["tumour", "box"] = "tumour"
    edge: float = mesh.TUMOUR_EDGE
    cells: tuple[int, int, int] = (16, 16, 7)

    def __post_init__(self):
        if not 0 < self.edge < np.inf:
            raise InputError(f"mesh.edge = {self.edge} m must be positive")

    def build(self):
        return mesh.tumour(self.edge) if self.kind == "tumour" else mesh.box(self.cells, self.edge)


@dataclass(frozen=True)
class SolverChoice:
    """See fem.solver.Solver for the meaning and units of each."""

    element: Literal["full", "mean_dilatation", "reduced"] = "full"
    precision: Literal["float32", "float64"] = "float32"
    hourglass_stiffness: float = 0.05
    damping: float = 0.0
    mass_scaling: float = 1.0
    safety: float = 0.85


@dataclass(frozen=True)
class Frames:
    """count frames, `interval` s apart; the first is the state at rest."""

    count: int
    interval: float

    def __post_init__(self):
        if self.count < 2 or not 0 < self.interval < np.inf:
            raise InputError(f"frames: count = {self.count} must be at least 2 and interval = {self.interval} s positive")

    @property
    def times(self):
        return np.arange(self.count) * self.interval

    @property
    def duration(self):
        return (self.count - 1) * self.interval


@dataclass(frozen=True)
class Interactions:
    """How many interactions each split has, numbered from 1, and the seed of all.

    hard: (first, last) numbers of the test interactions whose peak forces are `hard_force` (low, high) times the largest
    in contact.force, so that they lie outside the training data.
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
        if not (1 <= self.hard[0] <= self.hard[1] <= self.test):
            raise InputError(f"interactions.hard = {list(self.hard)} must be first and last number within the {self.test} test interactions")
        if not 1 <= self.hard_force[0] <= self.hard_force[1]:
            raise InputError(f"interactions.hard_force = {list(self.hard_force)} must be two factors from low to high, at least 1")

    def all(self):
        """[(split, number)] of every interaction, in the order of the dataset."""
        return [(split, number) for split in SPLITS for number in range(1, getattr(self, split) + 1)]

    def is_hard(self, split, number):
        return split == "test" and self.hard[0] <= number <= self.hard[1]


@dataclass(frozen=True)
class Health:
    """What a sequence must fulfil to enter a dataset: energy imbalance, smallest J, kinetic over strain energy."""

    imbalance: float = 0.01
    min_J: float = 0.15
    kinetic_share: float = 0.05


@dataclass(frozen=True)
class Scene:
    """Mesh, material, solver, contacts and interactions of one dataset."""

    material: Material
    contact: ContactRange
    frames: Frames
    interactions: Interactions
    mesh: MeshChoice = field(default_factory=MeshChoice)
    solver: SolverChoice = field(default_factory=SolverChoice)
    health: Health = field(default_factory=Health)

    def toml(self):
        return config.dump_toml(config.to_dict(self))

    def digest(self):
        """Eight hexadecimal digits that change with every setting."""
        return hashlib.sha256(self.toml().encode()).hexdigest()[:8]

    def build_solver(self, hex_mesh):
        return Solver(hex_mesh, self.material, **config.to_dict(self.solver))


def load_scene(path):
    """The Scene in the TOML file at `path`. Raises InputError that names a wrong key or value."""
    return config.build(Scene, config.read_toml(path))
