"""A run of cells: the internal force of one element, one law and its stress history."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fem.material.base import Hyperelastic, shear_modulus
from fem.material.neo_hooke import NeoHooke
from fem.mesh.hexmesh import HexMesh
from fem.solver.elements import FullElement, ReducedElement
from fem.solver.relaxation import Coefficients, StressHistory
from fem.solver.stresses import FusedNeoHooke, GenericStress


class CellsResult(NamedTuple):
    """What one pass over some cells found.

    smallest_J, and the cell it lies in; stiffening, see InternalForce; viscous_work: J, work of the
    viscous stress since its last update, 0 if it was not updated.
    """

    smallest_J: float
    cell: int
    stiffening: float
    viscous_work: float


class Expected(NamedTuple):
    """What the past leaves of the stress at the end of a step.

    relaxed: (6, Q, E), in units of the share `left` of the elastic stress that a step leaves
    least, most: bounds of the hourglass control in the same units
    """

    relaxed: np.ndarray
    least: float
    most: float


class Cells:
    """The cells `cells` (a slice) of a mesh; see InternalForce for the options.

    history: a StressHistory, or None for elastic tissue.
    """

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        cells: slice,
        kind: str,
        hourglass_stiffness: float,
        dtype: np.dtype,
        scratch: Callable[..., np.ndarray],
    ) -> None:
        law: Any = material.of_cells(cells, mesh.n_cells)
        self.cells = cells
        # a class that derives from NeoHooke may answer differently, and goes the general way
        fused = type(law) is NeoHooke
        unit = law.mu if fused else 1.0
        self.element: FullElement | ReducedElement
        if kind == "reduced":
            mu, relaxes = law.mu if fused else shear_modulus(law), bool(law.prony)
            self.element = ReducedElement(
                mesh, cells, dtype, scratch, unit, hourglass_stiffness, mu, relaxes
            )
        else:
            self.element = FullElement(mesh, cells, dtype, scratch, unit)
        make = FusedNeoHooke if fused else GenericStress
        self.law: Any = make(law, self.element, kind == "mean_dilatation", dtype, scratch)
        self.history: StressHistory | None = None
        if law.prony:
            shape = self.element.q, self.element.n
            self.history = StressHistory(law.prony, shape, self.law.weights, dtype, scratch)
        self._expected: Expected | None = None

    def add_force(
        self, u: np.ndarray, out: np.ndarray, coefficients: Coefficients | None, check: bool
    ) -> CellsResult:
        """Write the nodal forces (3, 8, E) of displacement u (3, N) into `out`.

        coefficients: of an update of the stress history, None to leave it as it is; check: measure
        the stiffening.
        """
        strain, work = self.law.strain(u), 0.0
        worst = int(strain.J.argmin())  # a NaN counts as smallest
        low = float(strain.J.flat[worst])
        stiffening = self.law.stiffening(strain) if check else 0.0
        updates = self.history is not None and coefficients is not None
        follows = self._expected is not None and isinstance(self.element, ReducedElement)
        cof = self.law.cofactor(strain) if updates or follows else None
        P = self.law.stress(strain)
        if updates:
            work = self._update_history(strain, cof, P, coefficients)
        elif follows:
            self._relax_hourglass(strain, cof, P)
        if self.history is not None:
            self.history.subtract_viscous(strain.H, P)
        self.element.to_nodes(P, out)
        return CellsResult(low, self.cells.start + worst % self.element.n, stiffening, work)

    def _update_history(self, strain, cof, P, coefficients):
        """Relax the stress, and with it the hourglass control; the work in J done meanwhile.

        The viscous stress stood still since the last update, so its work is its product with the
        change of strain.
        """
        if self._expected:
            self._expected = None  # the viscous work is the solver's to count
            stress, relaxed = self.history.update(cof, P, strain.J, coefficients)
            self.element.relax(stress, relaxed, self.history.least)
            return 0.0
        before = self._pair(strain.H)
        stress, relaxed = self.history.update(cof, P, strain.J, coefficients)
        self.element.relax(stress, relaxed, self.history.least)
        work = before - self.history.pairing
        self.history.pairing = self._pair(strain.H)
        return work

    def expect(
        self, coefficients: Coefficients, left: float, bends: list[np.ndarray | None]
    ) -> None:
        """Let the forces be those at the end of a step, in units of `left`, until the next update;
        see StressHistory.expect. bends: displacements (3, N) whose stresses those are."""
        if self.history is None:
            return
        stresses = [0.0 if u is None else self._second_stress(u) for u in bends]
        relaxed = self.history.expect(coefficients, left, stresses)
        self._expected = Expected(relaxed, self.history.least / left, 1 / left)

    def _second_stress(self, u):
        """S_e (6, Q, E) at the displacement u (3, N)."""
        strain = self.law.strain(u)
        cof = self.law.cofactor(strain)
        return self.history.second_stress(cof, self.law.stress(strain), strain.J)

    def _relax_hourglass(self, strain, cof, P):
        """Let the hourglass control be of the end of a step."""
        self.element.relax(self.history.second_stress(cof, P, strain.J), *self._expected)

    def _pair(self, H):
        return self.history.pair(H) + self.element.viscous_energy()

    def pending_work(self, u: np.ndarray) -> float:
        """Work in J of the viscous stress since its last update."""
        if self.history is None:
            return 0.0
        return self._pair(self.law.strain(u).H) - self.history.pairing

    def energies(self, u: np.ndarray) -> tuple[float, float]:
        """(strain, hourglass) energy in J, without relaxation."""
        strain = self.law.strain(u)
        return self.law.energy(strain), self.element.hourglass_energy()

    def hourglass(self, u: np.ndarray) -> tuple[float, float, float]:
        """(motion, hourglass, strain) energy in J, see InternalForce.hourglass."""
        strain, hourglass = self.energies(u)
        return self.element.hourglass_motion(), hourglass, strain

    def dilatation(self, u: np.ndarray) -> np.ndarray:
        """Mean J (E,) of each cell."""
        J = self.law.strain(u).J
        return (self.element.volume * J).sum(axis=0) / self.element.cell_volume

    def forget(self) -> None:
        """Rest: no stress history."""
        if self.history is not None:
            self.history.reset()
            self.element.reset()

    def state(self) -> dict[str, np.ndarray]:
        """The arrays of the stress history, cells along the last axis, and `pairing` (1,); empty
        for elastic tissue."""
        if self.history is None:
            return {}
        arrays = {name: getattr(self.history, name) for name in ("relaxed", "old_stress", "V")}
        if isinstance(self.element, ReducedElement):
            arrays["share"] = self.element.share
        return arrays | {"pairing": np.array([self.history.pairing])}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from a `state` of these cells."""
        for name, value in state.items():
            owner = self.element if name == "share" else self.history
            setattr(owner, name, np.array(value) if np.ndim(value) else float(value))
