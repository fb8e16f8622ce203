"""A scene: everything that one dataset depends on, read from a TOML file."""

from dataclasses import InitVar, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fem import settings as config
from fem.cache import digest
from fem.contact.draw import ContactRange
from fem.data.mesh_choice import MeshChoice, on_own_grid
from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.material.groups import Groups, by_cells, check_groups, split_table
from fem.material.kinds import from_table, to_table
from fem.mesh.hexmesh import HexMesh, checked_mesh
from fem.mesh.read import check_held
from fem.ranges import number
from fem.solver.explicit import Solver
from fem.solver.gate import LIMITS
from fem.solver.quasistatic import TOLERANCE, QuasiStatic
from fem.solver.reduced import ReducedSolver, file_digest

SPLITS = ("train", "validation", "test", "hard")  # their places seed the draws


SOLVERS: dict[str, type[Solver] | type[QuasiStatic]] = {
    "explicit": Solver,
    "quasistatic": QuasiStatic,
    "reduced": ReducedSolver,
}
# largest imbalance of energy: work is summed over the steps, and those of the one are milliseconds
IMBALANCE = {"explicit": 0.01, "quasistatic": 0.05, "reduced": 0.05}
# largest force out of balance: of inertia and damping, or what the modes of a reduced model leave
DISEQUILIBRIUM = {"reduced": 0.1}
# which settings of SolverChoice mean something for which kind
SOLVER_KINDS = {
    "explicit": {
        "element", "precision", "hourglass_stiffness", "damping", "mass_scaling", "safety"
    },
    "quasistatic": {"element", "precision", "hourglass_stiffness", "tolerance"},
    "reduced": {"precision", "model", "sha256"},
}  # fmt: skip


@dataclass(frozen=True)
class SolverChoice:
    """kind: "explicit" for fem.solver.explicit.Solver, "quasistatic" for
    fem.solver.quasistatic.QuasiStatic, "reduced" for fem.solver.reduced.ReducedSolver: see there
    for the meaning and units of the others.

    damping, mass_scaling and safety belong to the explicit solver, tolerance to the quasi-static.
    model: file of the reduced solver, relative to the scene file; sha256: of it, which load_scene
    fills in, so that another model makes another scene.
    """

    element: Literal["full", "mean_dilatation", "reduced"] = "full"
    precision: Literal["float32", "float64"] = "float32"
    hourglass_stiffness: float | None = number(0, 100, default=None)
    damping: float = number(0, 1e6, "1/s", default=0.0)
    mass_scaling: float = number(1e-3, 1e8, default=1.0)
    safety: float = number(1e-3, 10, default=0.85)
    kind: Literal["explicit", "quasistatic", "reduced"] = "explicit"
    tolerance: float | None = number(1e-12, 1, default=None)
    model: str | None = None
    sha256: str | None = None
    folder: InitVar[str | Path] = ""

    def __post_init__(self, folder: str | Path) -> None:
        config.normalised(self, "solver")
        object.__setattr__(self, "folder", str(folder))
        every = {own.name for own in fields(self)} - {"kind"}
        unused = sorted(every - SOLVER_KINDS[self.kind])
        config.refuse_unused(self, unused, "solver", f"solver.kind = '{self.kind}'")
        if self.element != "reduced":
            reason = f"solver.element = '{self.element}'"
            config.refuse_unused(self, ["hourglass_stiffness"], "solver", reason)
        elif self.hourglass_stiffness is None:
            object.__setattr__(self, "hourglass_stiffness", 0.2)  # the solver's default
        if self.kind == "reduced" and not self.model:
            raise InputError("solver.kind = 'reduced' needs solver.model, such as 'reduced.npz'")
        if self.kind == "quasistatic" and self.tolerance is None:
            object.__setattr__(self, "tolerance", TOLERANCE)

    def located(self, folder: str | Path) -> "SolverChoice":
        """This choice with its model found in `folder` and its content known."""
        if self.model is None:
            return self
        sha256 = file_digest(Path(folder, self.model))
        if self.sha256 not in (None, sha256):
            raise InputError(
                f"{Path(folder, self.model)} is another model than solver.sha256 ="
                f" '{self.sha256}' says; restore the model or leave solver.sha256 out"
            )
        return replace(self, sha256=sha256, folder=folder)

    def settings(self) -> dict[str, Any]:
        """Its entries that mean something for its kind, by name; `kind` is the caller's."""
        used = SOLVER_KINDS[self.kind] | {"element"}
        return {name: value for name, value in config.to_dict(self).items() if name in used}

    @property
    def true_mass(self) -> bool:
        """Whether tissue has its own inertia."""
        return self.kind == "explicit" and self.mass_scaling == 1

    def build(self, mesh: HexMesh, material: Hyperelastic) -> Solver | QuasiStatic:
        """The solver of a mesh and its law."""
        settings = self.settings()
        if self.kind == "reduced":
            found = self.located(self.folder)  # type: ignore[attr-defined]
            del settings["sha256"]
            settings["model"] = Path(found.folder, settings["model"])  # type: ignore[attr-defined]
        return SOLVERS[self.kind](mesh, material, **settings)


@dataclass(frozen=True)
class Frames:
    """count frames, `interval` s apart; the first is the state at rest."""

    count: int = number(2, 1_000_000)
    interval: float = number(1e-5, 1e5, "s")

    def __post_init__(self) -> None:
        config.normalised(self, "frames")

    @property
    def times(self) -> np.ndarray:
        """(count,) s."""
        return np.arange(self.count) * self.interval

    @property
    def duration(self) -> float:
        """s, from the first frame to the last."""
        return (self.count - 1) * self.interval


PAPERS_HARD = (78, 85)  # of the paper's 100 tests
MOST = 1_000_000  # interactions of a split
SHARE = 1e6  # of what health limits: as good as no limit


@dataclass(frozen=True)
class Interactions:
    """How many interactions each split has, numbered from 1, and the seed of all.

    hard: (first, last) numbers of the test interactions whose peak forces are `hard_force` (low,
    high) times the largest in contact.force, so that they lie outside the training data. Left out
    it is the paper's 78 to 85, and no test is hard where there are fewer than 85;
    hard_force is 1.3 to 1.6 if left out.
    hard_set: how many interactions the split "hard" has, each with a peak of hard_force; 0 for a
    dataset without it.
    """

    seed: int = number(0, 2**63 - 1)
    train: int = number(1, MOST)
    validation: int = number(1, MOST)
    test: int = number(1, MOST)
    hard: tuple[int, int] | None = number(1, MOST, default=None, ascending=True)
    hard_force: tuple[float, float] | None = number(1, 100, default=None, ascending=True)
    hard_set: int = number(0, MOST, default=0)

    def __post_init__(self) -> None:
        config.normalised(self, "interactions")
        if self.hard is None and self.test >= PAPERS_HARD[1]:
            object.__setattr__(self, "hard", PAPERS_HARD)
        if self.hard is None and not self.hard_set:
            if self.hard_force is not None:
                raise InputError(
                    f"interactions.hard_force = {list(self.hard_force)} has no meaning without"
                    " interactions.hard or hard_set; give one, or leave all out"
                )
            return
        if self.hard is not None and self.hard[1] > self.test:
            raise InputError(
                f"interactions.hard = {list(self.hard)} must be first and last number within the"
                f" {self.test} test interactions"
            )
        object.__setattr__(self, "hard_force", self.hard_force or (1.3, 1.6))

    def all(self) -> list[tuple[str, int]]:
        """[(split, number)] of every interaction, in the order of the dataset."""
        counts = self.train, self.validation, self.test, self.hard_set
        return [
            (split, number)
            for split, count in zip(SPLITS, counts, strict=True)
            for number in range(1, count + 1)
        ]

    def is_hard(self, split: str, number: int) -> bool:
        """Whether this interaction pushes harder than anything in training."""
        if split != "test":
            return split == "hard"
        return self.hard is not None and self.hard[0] <= number <= self.hard[1]


@dataclass(frozen=True)
class Health:
    """What a sequence must fulfil to enter a dataset: energy imbalance, smallest J, kinetic over
    strain energy, and the fem.solver.gate.Signs.

    imbalance, disequilibrium: left out they are those of the scene's solver, IMBALANCE and
    DISEQUILIBRIUM, or fem.solver.gate.LIMITS
    confirm: how many interactions are simulated again at the true mass where it is scaled;
    mass_error: largest relative L2 distance of their displacement from it
    """

    imbalance: float | None = number(0, SHARE, default=None)
    min_J: float = number(0, 1, default=0.15)
    kinetic_share: float = number(0, SHARE, default=0.05)
    corner_J: float = number(0, 1, default=LIMITS.corner_J)
    disequilibrium: float | None = number(0, SHARE, default=None)
    hourglass_motion: float = number(0, SHARE, default=LIMITS.hourglass_motion)
    hourglass_share: float = number(0, SHARE, default=LIMITS.hourglass_share)
    confirm: int = number(0, MOST, default=3)
    mass_error: float = number(0, SHARE, default=0.02)

    def __post_init__(self) -> None:
        config.normalised(self, "health")


def _unused_health(solver: SolverChoice, health: Health) -> dict[str, str]:
    """{name: for what it means nothing} of the settings of `health` beside this solver."""
    unused: dict[str, str] = {}
    if solver.element != "reduced":
        reason = f"solver.element = '{solver.element}'"
        unused |= dict.fromkeys(("hourglass_motion", "hourglass_share"), reason)
    if solver.true_mass:
        reason = "the explicit solver with solver.mass_scaling = 1"
        unused |= dict.fromkeys(("confirm", "mass_error"), reason)
    elif not health.confirm:
        unused["mass_error"] = "health.confirm = 0"
    return unused


@dataclass(frozen=True)
class Scene:
    """Mesh, material, solver, contacts and interactions of one dataset.

    groups: {cell set of the mesh: {parameter: value}}, what its cells have in place of the
    material's; [material.<cell set>] in a file. See `material_on`.
    """

    material: Hyperelastic = field(metadata={"build": from_table})
    contact: ContactRange
    frames: Frames
    interactions: Interactions
    mesh: MeshChoice = field(default_factory=MeshChoice)
    solver: SolverChoice = field(default_factory=SolverChoice)
    health: Health = field(default_factory=Health)
    groups: Groups = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        config.normalised(self)
        object.__setattr__(self, "groups", check_groups(self.material, self.groups))
        for name, reason in _unused_health(self.solver, self.health).items():
            config.refuse_unused(self.health, [name], "health", reason)
        kind = self.solver.kind
        usual: dict[str, Any] = {
            "imbalance": IMBALANCE[kind],
            "disequilibrium": DISEQUILIBRIUM.get(kind, LIMITS.disequilibrium),
        }
        left_out = {n: value for n, value in usual.items() if getattr(self.health, n) is None}
        object.__setattr__(self, "health", replace(self.health, **left_out))

    @staticmethod
    def arranged(tree: dict[str, Any]) -> dict[str, Any]:
        """The tables of a scene file with those of cell groups beside [material], not in it."""
        if "groups" in tree:
            raise InputError("unknown key 'groups'; give a group of cells as [material.<cell set>]")
        if not isinstance(tree.get("material"), dict):
            return tree
        material, groups = split_table(tree["material"])
        return tree | {"material": material, "groups": groups}

    def toml(self) -> str:
        """The text of every setting, defaults included; where the scene lies is no part of it."""
        return config.dump_toml(self._tree())

    def digest(self) -> str:
        """Eight hexadecimal digits that change with every setting and with the mesh that they
        give."""
        return digest([self._tree(), self.mesh.content])[:8]

    def _tree(self):
        tree = config.to_dict(self)
        groups = tree.pop("groups")
        if not self.contact.pull:  # what older scenes do not have does not change their digest
            del tree["contact"]["pull"]
        tree["solver"] = self.solver.settings()
        if self.solver.kind != "explicit":
            tree["solver"] = {"kind": self.solver.kind} | tree["solver"]
        return tree | {"material": to_table(self.material) | groups}

    def with_solver(self, solver: SolverChoice) -> "Scene":
        """This scene with another solver, and without the limits of health that mean nothing for
        it."""
        usual = config.defaults(Health, _unused_health(solver, self.health))
        return replace(self, solver=solver, health=replace(self.health, **usual))

    def with_mesh(self, mesh: HexMesh, grid: tuple[int, int, int] | None = None) -> "Scene":
        """This scene on the HexMesh `mesh` (m), such as fem.mesh.read.read_mesh gives; its dataset
        stores the mesh whole.

        grid: (nx, ny, nz) nodes of the grid to embed the mesh in, also if it lies on one of its
        own. Raises InputError for a mesh that is not held.
        """
        check_held(checked_mesh(mesh))
        mesh = replace(mesh, grid=None) if grid else on_own_grid(mesh)
        choice = MeshChoice("given", grid=grid, sha256=mesh.digest, mesh=mesh)
        return replace(self, mesh=choice)

    def material_on(self, hex_mesh: HexMesh) -> Hyperelastic:
        """The law of `hex_mesh`: one value a cell, (E,), of the parameters in which its cell groups
        differ, and `material` itself where they do not.

        Raises InputError for a group that is no cell set of the mesh, or shares cells with another.
        """
        return by_cells(self.material, hex_mesh, self.groups)

    def build_solver(self, hex_mesh: HexMesh) -> Solver | QuasiStatic:
        """The solver of `hex_mesh` with this scene's material and settings."""
        return self.solver.build(hex_mesh, self.material_on(hex_mesh))


def load_scene(path: str | Path) -> Scene:
    """The Scene in the TOML file at `path`. Raises InputError that names a wrong key or value, or a
    missing mesh file."""
    scene = config.build(Scene, config.read_toml(path))
    folder = Path(path).parent
    return replace(scene, mesh=scene.mesh.located(folder), solver=scene.solver.located(folder))
