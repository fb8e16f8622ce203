"""Nodal internal forces of a hexahedral mesh."""

import numpy as np
import scipy.sparse

from fem.errors import InputError
from fem.solver.cells import FullCells, ReducedCells
from fem.solver.relaxation import history_coefficients

CHUNK = (
    2048  # cells per pass: keeps a pass inside the processor's cache, whatever the size of the mesh
)
ELEMENTS = ("full", "reduced", "mean_dilatation")


class InternalForce:
    """f(u) for one mesh and material; call it with u (3, N) in m to get the internal force (3, N)
    in N.

    element: "full" (2 x 2 x 2 points), "mean_dilatation" (the same with one pressure a cell, which
    does not lock as nu goes to 0.5) or "reduced" (one point and hourglass control).
    precision: "float64" or "float32" for the work inside cells; nodal vectors are float64 in both.
    hourglass_stiffness: in units of mu, used by "reduced" alone.

    After a call, `min_J` and its `worst_cell` describe that state, and so does `stiffening` if
    `check` was true. With Prony terms the viscous part of the stress is brought up to date by
    `relax(dt)` before a call, and is otherwise kept as it was.
    """

    def __init__(
        self, mesh, material, element="full", precision="float64", hourglass_stiffness=0.2
    ):
        if element not in ELEMENTS:
            raise InputError(f"element '{element}' is not one of {', '.join(ELEMENTS)}")
        if precision not in ("float64", "float32"):
            raise InputError(f"precision '{precision}' is not 'float64' or 'float32'")
        self.mesh, self.material, self.element = mesh, material, element
        self.dtype = np.dtype(precision)
        self.min_J, self.stiffening, self.worst_cell = 1.0, 1.0, 0
        self._cell_force = np.empty((3, 8, mesh.n_cells), self.dtype)
        index = np.ascontiguousarray(mesh.cells.T)  # (8, E)
        ones = np.ones(index.size, self.dtype)
        self._scatter = scipy.sparse.csr_matrix(
            (ones, (index.ravel(), np.arange(index.size))), (mesh.n_nodes, index.size)
        )
        self._scratch = {}
        make = ReducedCells if element == "reduced" else FullCells
        starts = range(0, mesh.n_cells, CHUNK)
        self._chunks = [
            make(self, slice(s, min(s + CHUNK, mesh.n_cells)), index, hourglass_stiffness)
            for s in starts
        ]
        self._relax = None
        self.viscous_work = 0.0  # J, work of the viscous stresses up to their last update

    def scratch(self, name, shape):
        """A work array that all chunks share; contents do not survive the next chunk."""
        key = name, shape
        if key not in self._scratch:
            self._scratch[key] = np.empty(shape, self.dtype)
        return self._scratch[key]

    def relax(self, elapsed, ahead=0.0):
        """Let the next call advance the stress history by `elapsed` seconds, and hold it for
        `ahead` seconds.

        The held stress is that of the middle of those seconds, which makes standing still
        second-order accurate.
        """
        self._relax = float(elapsed), float(ahead)

    def forget(self):
        """Drop the stress history: from here on the tissue relaxes as if it had been at rest until
        now."""
        for chunk in self._chunks:
            chunk._start_history()

    def __call__(self, u, out=None, check=False):
        """Internal force (3, N) at displacement u (3, N)."""
        u = u if u.dtype == self.dtype else u.astype(self.dtype)
        coefficients = (
            None if self._relax is None else history_coefficients(self.material.prony, *self._relax)
        )
        self.min_J = np.inf
        if check:
            self.stiffening = 0.0
        for chunk in self._chunks:
            chunk.add_force(u, self._cell_force[:, :, chunk.cells], coefficients, check)
        self._relax = None
        out = np.empty((3, self.mesh.n_nodes)) if out is None else out
        for component in range(3):
            out[component] = self._scatter @ self._cell_force[component].ravel()
        return out

    def energies(self, u):
        """(strain, hourglass) energy in J of the displacement u (3, N), the strain energy without
        relaxation."""
        u = u if u.dtype == self.dtype else u.astype(self.dtype)
        return tuple(np.sum([chunk.energies(u) for chunk in self._chunks], axis=0))

    def viscous_energy(self, u):
        """Work in J of the viscous stresses up to the displacement u (3, N): minus what relaxation
        has spared so far."""
        u = u if u.dtype == self.dtype else u.astype(self.dtype)
        return self.viscous_work + sum(chunk.pending_work(u) for chunk in self._chunks)

    def dilatation(self, u):
        """J of every cell (E,), the mean over its points, at displacement u (3, N)."""
        u = u if u.dtype == self.dtype else u.astype(self.dtype)
        return np.concatenate([chunk.dilatation(u) for chunk in self._chunks])
