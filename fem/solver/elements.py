"""Displacement gradients of a run of cells, and nodal forces of their stresses.

Arrays are components-first, (3, 8, E) and (3, 3, Q, E): each ufunc then runs over long contiguous
planes. The products with shape gradients are matrix products with one small matrix that all cells
share where they are congruent. What a scene does not need (cell-wise Jacobians, hourglass control,
one modulus a cell) is chosen once, when the element is built.

An element has `n` cells of `q` points, `volume` (Q, E) or (Q, 1) of its points and `cell_volume`
(E,), m3. Stresses are in units of `unit` Pa, one value or one a cell.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from fem.mesh import element
from fem.mesh.hexmesh import HexMesh


class FullElement:
    """2 x 2 x 2 points a cell."""

    def __init__(
        self,
        mesh: HexMesh,
        cells: slice,
        dtype: np.dtype,
        scratch: Callable[..., np.ndarray],
        unit: float | np.ndarray,
    ) -> None:
        self.scratch = scratch
        self.index = np.ascontiguousarray(mesh.cells[cells].T)  # (8, E)
        self.q, self.n = len(element.GAUSS), self.index.shape[1]
        jacobian = element.jacobians(mesh.points, mesh.cells[cells], element.GAUSS)  # (E, Q, 3, 3)
        self.unit: np.ndarray | None = (
            None  # (E,) what the divergence of congruent cells cannot hold
        )
        if mesh.congruent:
            if np.ndim(unit):
                self.unit, unit = np.asarray(unit, dtype), 1.0
            physical, self.volume = _congruent(element.GAUSS, 1.0, jacobian[0])
            self.to_physical = None
            self.gradient, self.divergence = _matrices(physical, unit * self.volume, dtype)
        else:
            gradients = element.shape_gradients(element.GAUSS)  # (Q, 3, 8)
            self.to_physical = np.ascontiguousarray(
                np.linalg.inv(jacobian).transpose(2, 3, 1, 0), dtype
            )  # (r, j, Q, E)
            self.volume = np.ascontiguousarray(np.linalg.det(jacobian).T)  # (Q, E) m3
            self.force_weight = (unit * self.volume).astype(dtype)  # N m
            self.gradient = gradients.transpose(1, 0, 2).reshape(3 * self.q, 8).astype(dtype)
            self.divergence = np.ascontiguousarray(self.gradient.T)
        self.cell_volume = (self.volume * np.ones((self.q, self.n))).sum(axis=0)  # (E,)

    @cached_property
    def _corners(self):
        return self.scratch("U", (3, 8, self.n))

    def displacement_gradient(self, u: np.ndarray, H: np.ndarray) -> None:
        """du_c/dX_j at the points, (3, 3, Q, E), into H."""
        U = self._corners
        u.take(self.index, axis=1, out=U, mode="clip")
        if self.to_physical is None:
            np.matmul(self.gradient, U, out=H.reshape(3, 3 * self.q, self.n))
            return
        G, T = self.scratch("G", H.shape), self.scratch("T", H.shape[1:])
        np.matmul(self.gradient, U, out=G.reshape(3, 3 * self.q, self.n))
        for j in range(3):
            np.multiply(G[:, 0], self.to_physical[0, j], out=H[:, j])
            H[:, j] += np.multiply(G[:, 1], self.to_physical[1, j], out=T)
            H[:, j] += np.multiply(G[:, 2], self.to_physical[2, j], out=T)

    def to_nodes(self, P: np.ndarray, out: np.ndarray) -> None:
        """Nodal forces (3, 8, E) in N of the stress P (3, 3, Q, E), which is overwritten."""
        if self.to_physical is None:
            np.matmul(self.divergence, P.reshape(3, 3 * self.q, self.n), out=out)
            if self.unit is not None:  # on 24 forces a cell, not on its 72 stresses
                out *= self.unit
            return
        G, T = self.scratch("G", P.shape), self.scratch("T", P.shape[1:])
        P *= self.force_weight
        for r in range(3):
            np.multiply(P[:, 0], self.to_physical[r, 0], out=G[:, r])
            G[:, r] += np.multiply(P[:, 1], self.to_physical[r, 1], out=T)
            G[:, r] += np.multiply(P[:, 2], self.to_physical[r, 2], out=T)
        np.matmul(self.divergence, G.reshape(3, 3 * self.q, self.n), out=out)

    def cell_mean(self, value: np.ndarray) -> np.ndarray:
        """Mean (E,) over the volume of each cell of a value at its points (Q, E)."""
        volume = self.volume * np.ones((1, self.n))
        return np.einsum("qe,qe->e", volume, value) / self.cell_volume

    def relax(
        self, stress: np.ndarray, relaxed: np.ndarray, least: float, most: float = 1.0
    ) -> None:
        """Nothing relaxes here but the stress itself."""

    def reset(self) -> None:
        """Nothing to forget."""

    def hourglass_energy(self) -> float:
        """No energy beside the strain energy."""
        return 0.0

    def hourglass_motion(self) -> float:
        """No motion that the stress does not resist."""
        return 0.0

    def viscous_energy(self) -> float:
        """No energy beside that of the viscous stress."""
        return 0.0


class ReducedElement:
    """One point a cell with the mean gradient, and hourglass control (Flanagan and Belytschko
    1981).

    The hourglass force k gamma (gamma . u) is exact under rotation: gamma is orthogonal to every
    linear field. k is the share `hourglass` of one in proportion to `mu` (Pa), since one in
    proportion to K + 2 mu locks as nu goes to 0.5, and with Prony terms it relaxes as the cell's
    stress does: left elastic, it carries the load of a long hold.
    """

    def __init__(
        self,
        mesh: HexMesh,
        cells: slice,
        dtype: np.dtype,
        scratch: Callable[..., np.ndarray],
        unit: float | np.ndarray,
        hourglass: float,
        mu: float | np.ndarray,
        relaxes: bool,
    ) -> None:
        self.scratch, self.relaxes, self.congruent = scratch, relaxes, mesh.congruent
        self.index = np.ascontiguousarray(mesh.cells[cells].T)  # (8, E)
        self.q, self.n = 1, self.index.shape[1]
        if mesh.congruent:
            mean = self._share_gradient(mesh, cells, dtype, unit)
        else:
            mean = self._own_gradients(mesh, cells, dtype, unit)
        # as Flanagan and Belytschko, but with mu for K + 2 mu
        squares = np.square(mean).sum(axis=(0, 1))
        # (E,) N/m: of a share of 1, and of what there is
        self.whole = (mu * self.cell_volume * squares / 8).astype(dtype)
        self.stiffness = (hourglass * mu * self.cell_volume * squares / 8).astype(dtype)
        if mesh.congruent:
            self._stack(dtype, unit, np.ndim(mu))
        self.reset()

    def _share_gradient(self, mesh, cells, dtype, unit):
        jacobian = element.jacobians(mesh.points, mesh.cells[cells], element.CENTRE)
        physical, self.volume = _congruent(element.CENTRE, 8.0, jacobian[0])
        self.cell_volume = (self.volume * np.ones((1, self.n))).sum(axis=0)
        weight = (1.0 if np.ndim(unit) else unit) * self.volume
        self.gradient, self.divergence = _matrices(physical, weight, dtype)
        return self.gradient.astype(float).reshape(3, 8, 1)

    def _own_gradients(self, mesh, cells, dtype, unit):
        jacobian = element.jacobians(mesh.points, mesh.cells[cells], element.GAUSS)
        volume = np.linalg.det(jacobian)  # (E, Q)
        gradients = element.shape_gradients(element.GAUSS)
        every = np.einsum("qra,eqrj,eq->jae", gradients, np.linalg.inv(jacobian), volume)
        self.cell_volume = volume.sum(axis=1)
        self.volume = self.cell_volume[None]
        mean = every / self.cell_volume
        self.gradient = np.ascontiguousarray(mean, dtype)  # (3, 8, E)
        self.divergence = np.ascontiguousarray(unit * mean * self.cell_volume, dtype)
        corners = mesh.points[mesh.cells[cells]]  # (E, 8, 3)
        offset = np.einsum("ha,eaj->hje", element.HOURGLASS, corners)
        self.gamma = np.ascontiguousarray(
            element.HOURGLASS[:, :, None] - np.einsum("hje,jae->hae", offset, mean), dtype
        )
        return mean

    def _stack(self, dtype, unit, cellwise):
        """Gradient and hourglass shapes in one matrix each way, (7, 8) and (8, 7)."""
        self.unit = unit.astype(dtype) if np.ndim(unit) else None
        in_unit = self.stiffness if self.unit is None else self.stiffness.astype(float) / unit
        # a share of mu, as of one modulus a cell, is the same in all
        cellwise = cellwise and not np.allclose(in_unit, in_unit[0], rtol=1e-6, atol=0)
        self.cellwise_stiffness = in_unit.astype(dtype) if cellwise else None
        rows = np.vstack([self.gradient.astype(float), element.HOURGLASS])
        stiffness = 1.0 if cellwise else in_unit[0]
        columns = np.vstack([self.divergence.T.astype(float), element.HOURGLASS * stiffness])
        self.rows, self.columns = rows.astype(dtype), np.ascontiguousarray(columns.T, dtype)

    @cached_property
    def _corners(self):
        return self.scratch("U", (3, 8, self.n))

    @cached_property
    def _modes(self):
        """(3, 7, E) work array: the gradient, and the four hourglass modes of each component."""
        return self.scratch("Q", (3, 7, self.n))

    def displacement_gradient(self, u: np.ndarray, H: np.ndarray) -> None:
        """du_c/dX_j at the centres, (3, 3, 1, E), into H; the hourglass modes stay in Q."""
        U, Q = self._corners, self._modes
        u.take(self.index, axis=1, out=U, mode="clip")
        if self.congruent:
            np.matmul(self.rows, U, out=Q)
            H[:, :, 0] = Q[:, :3]
        else:
            np.einsum("jae,cae->cje", self.gradient, U, out=H[:, :, 0])
            np.einsum("hae,cae->che", self.gamma, U, out=Q[:, 3:])

    def to_nodes(self, P: np.ndarray, out: np.ndarray) -> None:
        """Nodal forces (3, 8, E) in N of the stress P (3, 3, 1, E) and of the hourglass modes."""
        Q = self._modes
        if self.relaxes:
            Q[:, 3:] *= self.share
        if self.congruent:
            Q[:, :3] = P[:, :, 0]
            if self.cellwise_stiffness is not None:
                Q[:, 3:] *= self.cellwise_stiffness
            np.matmul(self.columns, Q, out=out)
            if self.unit is not None:
                out *= self.unit
        else:
            np.einsum("jae,cje->cae", self.divergence, P[:, :, 0], out=out)
            Q[:, 3:] *= self.stiffness
            out += np.einsum("hae,che->cae", self.gamma, Q[:, 3:])

    def cell_mean(self, value: np.ndarray) -> np.ndarray:
        """The value (E,) of the one point, from (1, E)."""
        return value[0]

    def relax(
        self, stress: np.ndarray, relaxed: np.ndarray, least: float, most: float = 1.0
    ) -> None:
        """The stiffness keeps the share of the cell's stress (6, 1, E) that is not `relaxed`."""
        elastic = np.linalg.norm(stress, axis=(0, 1))
        left = np.linalg.norm(stress - relaxed, axis=(0, 1))
        ones = np.ones_like(left)
        share = np.clip(np.divide(left, elastic, out=ones, where=elastic > 0), least, most)
        self.share = share.astype(self.stiffness.dtype)

    def reset(self) -> None:
        """The full stiffness again."""
        if self.relaxes:
            self.share = np.ones(self.n, self.stiffness.dtype)  # of the stiffness that is left

    def hourglass_energy(self) -> float:
        """Energy in J of the hourglass modes of the last displacement, without relaxation."""
        return self._energy(self.stiffness)

    def hourglass_motion(self) -> float:
        """The energy in J that the same motion would have under a hourglass stiffness of mu: it
        tells where there is little stiffness, or none."""
        return self._energy(self.whole)

    def viscous_energy(self) -> float:
        """What relaxation has taken from that energy, J."""
        return self._energy(self.stiffness * (self.share - 1))

    def _energy(self, stiffness):
        modes = np.square(self._modes[:, 3:]).sum(axis=(0, 1))
        return float(np.sum(modes * stiffness, dtype=float) / 2)


def _congruent(rule, weight, jacobian):
    """Shape gradients (3, Q, 8) in 1/m and volumes (Q, 1) in m3 of cells that share the Jacobians
    (Q, 3, 3)."""
    volume = np.linalg.det(jacobian) * weight
    gradients = element.shape_gradients(rule)
    return np.einsum("qra,qrj->jqa", gradients, np.linalg.inv(jacobian)), volume[:, None]


def _matrices(physical, weight, dtype):
    """The gradient (3 Q, 8) and the divergence (8, 3 Q) of shared shape gradients."""
    rows = physical.shape[0] * physical.shape[1]
    gradient = physical.reshape(rows, 8).astype(dtype)
    return gradient, np.ascontiguousarray((physical * weight).reshape(rows, 8).T, dtype)
