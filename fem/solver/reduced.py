"""Quasi-static motion in the modes of a reduced model: datasets of many interactions, fast."""

import hashlib
from pathlib import Path

import numpy as np

from fem.cache import digest
from fem.errors import InputError, SolverStopped, Stop
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MM, MN
from fem.online.reduced import ReducedStepper
from fem.online.reduced_model import ReducedModel
from fem.solver.load_steps import LoadStep
from fem.solver.quasistatic import QuasiStatic

UNREST = 0.02  # largest last step of the reduced solver beside its answer


class ReducedSolver(QuasiStatic):
    """A QuasiStatic whose equilibria are those of a reduced model; see fem.online.reduced.

    Everything else is as there: the internal force of the full mesh is taken once a step, for
    observers and for the smallest J. model: file of a fem.online.reduced_model.ReducedModel.

    Raises InputError for a model of another mesh or material, and SolverStopped(NOT_IN_EQUILIBRIUM)
    where the reduced solver comes to no rest.
    """

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        model: str | Path,
        element: str = "full",
        precision: str = "float64",
    ) -> None:
        if element != "full":
            raise InputError(
                f"solver.element = '{element}' is not that of a reduced model; leave it out"
            )
        reduced = ReducedModel.load(model)
        reduced.check(mesh.digest, digest(material))
        super().__init__(mesh, material, element, precision)
        self.reduced = ReducedStepper(reduced)

    def _equilibrium(self, step: LoadStep, tolerance: float | None = None) -> np.ndarray:
        """The displacement (3, N) m of the model at the end of a step; its own tolerance holds."""
        dt = step.time - self.time
        displacement = self.reduced.step((step.load.T * MN).astype(np.float32), dt)
        if not self.reduced.unrest <= UNREST:
            raise SolverStopped.because(
                Stop.NOT_IN_EQUILIBRIUM,
                f"the reduced solver still moves by {self.reduced.unrest:.1%} at {step.time:.4g} s",
            )
        return displacement.T.astype(float) / MM

    def snapshot(self) -> dict[str, np.ndarray]:
        """A copy of all that the run depends on from here, as arrays by name."""
        own = {f"reduced.{name}": array for name, array in self.reduced.state().items()}
        return super().snapshot() | own

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Go on from what `snapshot` gave. Raises InputError for that of another solver."""
        super().restore(snapshot)
        own = {name for name in snapshot if name.startswith("reduced.")}
        self.reduced.restore({name.removeprefix("reduced."): snapshot[name] for name in own})


def file_digest(model: str | Path) -> str:
    """SHA-256 of a model's file. Raises InputError where there is none."""
    if not Path(model).is_file():
        raise InputError(f"no reduced model {model}; make one with python -m fem.reduce data.h5")
    return hashlib.sha256(Path(model).read_bytes()).hexdigest()
