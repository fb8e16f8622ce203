"""Nodal internal forces of a hexahedral mesh, in vectorised NumPy."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse

from fem.errors import InputError
from fem.material.base import Hyperelastic, volumetric_modulus
from fem.material.check import check_law
from fem.material.kinds import KINDS
from fem.mesh.hexmesh import HexMesh
from fem.solver.cells import Cells
from fem.solver.relaxation import history_coefficients

# cells per pass: keeps a pass inside the processor's cache, whatever the size of the mesh
CHUNK = 2048
ELEMENTS = ("full", "reduced", "mean_dilatation")


class InternalForce:
    """f(u) for one mesh and material; call it with u (3, N) in m to get the internal force (3, N)
    in N.

    material: a Hyperelastic, with one value or one a cell of each parameter; NeoHooke itself has a
    kernel of its own, every other law goes through its stress in float64. A law of the user's own
    is checked first, see fem.material.check.
    element: "full" (2 x 2 x 2 points), "mean_dilatation" (the same with one pressure a cell, which
    does not lock as nu goes to 0.5) or "reduced" (one point and hourglass control).
    precision: "float64" or "float32" for the work inside cells; nodal vectors are float64 in both.
    hourglass_stiffness: in units of the shear modulus, used by "reduced" alone.

    After a call, `min_J` and its `worst_cell` describe that state, and so does `stiffening` if
    `check` was true: how much stiffer than at rest the stiffest point is. With Prony terms the
    viscous part of the stress is brought up to date by `relax(dt)` before a call, and is otherwise
    kept as it was.

    Raises InputError for an unknown element or precision, and for a law that is not fit for them.
    """

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        element: str = "full",
        precision: str = "float64",
        hourglass_stiffness: float = 0.2,
    ) -> None:
        if element not in ELEMENTS:
            raise InputError(f"element '{element}' is not one of {', '.join(ELEMENTS)}")
        if precision not in ("float64", "float32"):
            raise InputError(f"precision '{precision}' is not 'float64' or 'float32'")
        if type(material) not in KINDS.values():
            check_law(material, mesh.n_cells)
        if element == "mean_dilatation" and volumetric_modulus(material) is None:
            raise InputError(
                f"element 'mean_dilatation' needs the modulus K of a term K/2 (J - 1)^2 in the"
                f" energy, and {type(material).__name__} names none beside its energy; give it K or"
                " take element 'full' or 'reduced'"
            )
        self.mesh, self.material, self.element = mesh, material, element
        self.dtype = np.dtype(precision)
        self.min_J, self.stiffening, self.worst_cell = 1.0, 1.0, 0
        self.viscous_work = 0.0  # J, work of the viscous stresses up to their last update
        self._relax: tuple[float, float] | None = None
        self._scratch: dict[Any, np.ndarray] = {}
        self._cell_force = np.empty((3, 8, mesh.n_cells), self.dtype)
        self._scatter = _scatter(mesh, self.dtype)
        self._chunks = [
            Cells(mesh, material, cells, element, hourglass_stiffness, self.dtype, self._work_array)
            for cells in _chunks(mesh.n_cells)
        ]

    def _work_array(self, name, shape, dtype=None):
        """A work array that all chunks share; contents do not survive the next chunk."""
        key = name, shape
        if key not in self._scratch:
            self._scratch[key] = np.empty(shape, dtype or self.dtype)
        return self._scratch[key]

    def relax(self, elapsed: float, ahead: float = 0.0) -> None:
        """Let the next call advance the stress history by `elapsed` seconds, and hold it for
        `ahead` seconds.

        The held stress is that of the middle of those seconds, which makes standing still
        second-order accurate.
        """
        self._relax = float(elapsed), float(ahead)

    def expect(self, elapsed: float, bends: Sequence[np.ndarray | None] = ()) -> float:
        """Let the calls from here on give the internal force at the end of a step of `elapsed`
        seconds over which the elastic stress runs linearly, in units of the share c of the elastic
        stress that such a step leaves: c, which is 1 for elastic tissue.

        It holds for any displacement, so that the one in equilibrium can be looked for, until
        `relax` and a call take the step.

        bends: for each Prony term the displacement (3, N) m whose elastic stress has relaxed at the
        end besides, where the stress bends within the step, or None
        """
        bends = [None if u is None else self._cast(u) for u in bends]
        coefficients = history_coefficients(self.material.prony, elapsed)
        left = 1.0 - sum(
            g * a * new
            for (g, _), (a, _, new, _) in zip(self.material.prony, coefficients, strict=True)
        )
        for chunk in self._chunks:
            chunk.expect(coefficients, left, bends)
        return left

    def forget(self) -> None:
        """Drop the stress history: from here on the tissue relaxes as if it had been at rest until
        now."""
        for chunk in self._chunks:
            chunk.forget()

    def state(self) -> dict[str, np.ndarray]:
        """The stress history as a dict of arrays, empty for elastic tissue; see `restore`."""
        if not self.material.prony:
            return {}
        states = [chunk.state() for chunk in self._chunks]
        joined = {name: np.concatenate([s[name] for s in states], axis=-1) for name in states[0]}
        return joined | {"viscous_work": np.array(self.viscous_work)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from the stress history that `state` gave, of this mesh, element and precision."""
        if not self.material.prony:
            return
        arrays = dict(state)
        self.viscous_work = float(arrays.pop("viscous_work"))
        pairing = arrays.pop("pairing")
        for i, chunk in enumerate(self._chunks):
            own = {name: value[..., chunk.cells] for name, value in arrays.items()}
            chunk.restore(own | {"pairing": pairing[i]})

    def __call__(
        self, u: np.ndarray, out: np.ndarray | None = None, check: bool = False
    ) -> np.ndarray:
        """Internal force (3, N) at displacement u (3, N)."""
        u = self._cast(u)
        prony, relax = self.material.prony, self._relax
        coefficients = None if relax is None else history_coefficients(prony, *relax)
        self.min_J = np.inf
        if check:
            self.stiffening = 0.0
        for chunk in self._chunks:
            low, cell, stiffening, work = chunk.add_force(
                u, self._cell_force[:, :, chunk.cells], coefficients, check
            )
            if low < self.min_J or np.isnan(low):
                self.min_J, self.worst_cell = low, cell
            if check:
                self.stiffening = max(self.stiffening, stiffening)
            self.viscous_work += work
        self._relax = None
        out = np.empty((3, self.mesh.n_nodes)) if out is None else out
        for component in range(3):
            out[component] = self._scatter @ self._cell_force[component].ravel()
        return out

    def energies(self, u: np.ndarray) -> tuple[float, float]:
        """(strain, hourglass) energy in J of the displacement u (3, N), the strain energy without
        relaxation."""
        u = self._cast(u)
        strain, hourglass = np.sum([chunk.energies(u) for chunk in self._chunks], axis=0)
        return strain, hourglass

    def hourglass(self, u: np.ndarray) -> tuple[float, float, float]:
        """Energies in J at the displacement u (3, N): of the hourglass modes if the hourglass
        stiffness were the shear modulus, of the hourglass modes, and strain, all without
        relaxation; zeros for elements that have no such modes."""
        if self.element != "reduced":
            return 0.0, 0.0, 0.0
        u = self._cast(u)
        motion, energy, strain = np.sum([chunk.hourglass(u) for chunk in self._chunks], axis=0)
        return motion, energy, strain

    def viscous_energy(self, u: np.ndarray) -> float:
        """Work in J of the viscous stresses up to the displacement u (3, N): minus what relaxation
        has spared so far."""
        u = self._cast(u)
        return self.viscous_work + sum(chunk.pending_work(u) for chunk in self._chunks)

    def dilatation(self, u: np.ndarray) -> np.ndarray:
        """J of every cell (E,), the mean over its points, at displacement u (3, N)."""
        u = self._cast(u)
        return np.concatenate([chunk.dilatation(u) for chunk in self._chunks])

    def _cast(self, u):
        return u if u.dtype == self.dtype else u.astype(self.dtype)


def _chunks(n_cells):
    """The cells in slices of CHUNK."""
    return [slice(s, min(s + CHUNK, n_cells)) for s in range(0, n_cells, CHUNK)]


def _scatter(mesh, dtype):
    """The sparse matrix (N, 8 E) that adds the forces of the cells' corners to their nodes."""
    index = mesh.cells.T.ravel()
    entries = np.ones(index.size, dtype), (index, np.arange(index.size))
    return scipy.sparse.csr_matrix(entries, (mesh.n_nodes, index.size))
