"""Stresses and energies at the points of a run of cells: the fused neo-Hookean kernel, and any law.

Both take H = du/dX (3, 3, Q, E) and keep what they make of it in work arrays that all runs of cells
share.

The fused kernel works in units of mu and starts from H = F - I and j = J - 1, never from F and J: a
strain of 1e-8 then keeps all its digits, in float32 too, and so does the small j of nearly
incompressible tissue.

    P = mu F + (K j - mu/J) cof F = H + (q - 1)(cof H - H^T) + (q + (q - 1) tr H) I,   q = j/J + K j
      (mu = 1)
    j = tr H + tr cof H + det H,   cof F = (1 + tr H) I - H^T + cof H
"""

import inspect
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fem.material.base import Hyperelastic, acoustic_stiffness, bulk_modulus, volumetric_modulus
from fem.material.kinematics import cofactor, determinant
from fem.material.neo_hooke import NeoHooke
from fem.solver.elements import FullElement, ReducedElement


class Strain(NamedTuple):
    """H = du/dX, C = cof H, tr H, j = J - 1 and J."""

    H: np.ndarray
    C: np.ndarray
    trace: np.ndarray
    j: np.ndarray
    J: np.ndarray


class Deformation(NamedTuple):
    """H = du/dX in the kernel's precision; F, cof F and J in float64."""

    H: np.ndarray
    F: np.ndarray
    cof: np.ndarray
    J: np.ndarray


class FusedNeoHooke:
    """The neo-Hookean law in as few passes over memory as it takes, in units of mu.

    mean_dilatation: let K act on the cell's mean of J.
    """

    def __init__(
        self,
        material: NeoHooke,
        element: FullElement | ReducedElement,
        mean_dilatation: bool,
        dtype: np.dtype,
        scratch: Callable[..., np.ndarray],
    ) -> None:
        self.element, self.scratch, self.mean_dilatation = element, scratch, mean_dilatation
        mu, nu = material.mu, material.nu
        # one Poisson ratio is one K in units of mu, however many mu there are
        shared = np.ndim(mu) and not np.ndim(nu)
        bulk = bulk_modulus(1.0, nu) if shared else material.K / mu
        self.bulk: Any = np.asarray(bulk, dtype) if np.ndim(bulk) else bulk
        self.weights = Weights(element, mu)

    @cached_property
    def _work(self):
        """Rows of H and two of them again, one more array for products, and the Strain."""
        scratch, shape = self.scratch, (self.element.q, self.element.n)
        X, C = scratch("X", (5, 3, *shape)), scratch("C", (3, 3, *shape))
        scalars = (scratch(name, shape) for name in ("trace", "j", "J"))
        return X, scratch("T", (3, *shape)), Strain(X[:3], C, *scalars)

    def strain(self, u: np.ndarray) -> Strain:
        """The Strain at displacement u (3, N), in shared work arrays."""
        X, T, strain = self._work
        H, C, trace, j, J = strain
        self.element.displacement_gradient(u, H)
        # rows repeat cyclically, so that one ufunc makes a column of all three cofactor rows
        X[3:] = X[:2]
        for k in range(3):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            np.multiply(X[1:4, k1], X[2:5, k2], out=C[:, k])
            C[:, k] -= np.multiply(X[1:4, k2], X[2:5, k1], out=T)
        np.multiply(H[0], C[0], out=T)
        np.add(T[0], T[1], out=j)
        j += T[2]
        np.add(H[0, 0], H[1, 1], out=trace)
        trace += H[2, 2]
        for i in range(3):
            j += C[i, i]
        j += trace
        np.add(j, 1, out=J)
        return strain

    def cofactor(self, strain: Strain) -> np.ndarray:
        """cof F (3, 3, Q, E), in a work array of its own."""
        H, C, trace, *_ = strain
        cof = self.scratch("cof", C.shape)
        np.subtract(C, H.swapaxes(0, 1), out=cof)
        cof.reshape(9, *trace.shape)[::4] += trace + 1
        return cof

    def stress(self, strain: Strain) -> np.ndarray:
        """P (3, 3, Q, E) in units of mu; it takes the place of the strain's C."""
        H, C, trace, j, J = strain
        T = self._work[1]
        q, r = np.divide(j, J, out=T[0]), T[1]
        q += self._pressure(j, T[1])
        np.subtract(q, 1, out=r)
        trace *= r
        trace += q
        C -= H.swapaxes(0, 1)
        C *= r
        C += H
        C.reshape(9, *j.shape)[::4] += trace
        return C

    def _pressure(self, j, out):
        """K j in units of mu, or K times the cell's mean of j."""
        if not self.mean_dilatation:
            return np.multiply(j, self.bulk, out=out)
        return (self.bulk * self.element.cell_mean(j)).astype(j.dtype)

    def stiffening(self, strain: Strain) -> float:
        """How much stiffer than at rest the stiffest point is: K + mu/J^2 acts along cof F."""
        cof = self.cofactor(strain)
        area = np.einsum("cjqe,cjqe->qe", cof, cof) / 3
        with np.errstate(all="ignore"):
            stiff = 1 + (self.bulk + 1 / np.square(strain.J)) * area
        if np.ndim(self.bulk):
            return float((stiff / (self.bulk + 2)).max())
        return float(stiff.max()) / (self.bulk + 2)

    def energy(self, strain: Strain) -> float:
        """Strain energy of the cells in J."""
        H, _, trace, j, _ = strain
        with np.errstate(all="ignore"):
            # (I1 - 3)/2 - ln J
            W = (j - np.log1p(j)) - (j - trace) + np.einsum("cjqe,cjqe->qe", H, H) / 2
        w = self.weights
        if self.mean_dilatation:
            mean = (self.element.volume * j).sum(axis=0) / self.element.cell_volume
            bulk = np.sum(self.bulk / 2 * mean**2 * w.cells)
        else:
            bulk = np.sum(self.bulk / 2 * np.square(j) * w.points)
        return float(w.factor * (np.sum(W * w.points) + bulk))


class GenericStress:
    """Any law, through its own stress, energy and tangent, in Pa.

    The law works in float64 whatever the precision of the kernel: it sees F = I + H, in which
    float32 would leave a strain of 1e-8 no digit.
    """

    def __init__(
        self,
        material: Hyperelastic,
        element: FullElement | ReducedElement,
        mean_dilatation: bool,
        dtype: np.dtype,
        scratch: Callable[..., np.ndarray],
    ) -> None:
        self.material, self.element, self.scratch = material, element, scratch
        self.K = volumetric_modulus(material) if mean_dilatation else None
        self.weights = Weights(element, 1.0)
        self._stress = _stress_into(material)
        rest = np.tile(np.eye(3)[:, :, None, None], (1, 1, 1, element.n))
        self.rest = acoustic_stiffness(material.tangent(rest))  # (1, E) Pa

    def strain(self, u: np.ndarray) -> Deformation:
        """The Deformation at displacement u (3, N)."""
        shape = 3, 3, self.element.q, self.element.n
        H, F = self.scratch("H", shape), self.scratch("F", shape, float)
        self.element.displacement_gradient(u, H)
        F[...] = H
        F.reshape(9, *shape[2:])[::4] += 1
        cof = cofactor(F)
        return Deformation(H, F, cof, determinant(F, cof))

    def cofactor(self, strain: Deformation) -> np.ndarray:
        """cof F (3, 3, Q, E)."""
        return strain.cof

    def stress(self, strain: Deformation) -> np.ndarray:
        """P (3, 3, Q, E) in Pa; with K, of the cell's mean of J where the law has K (J - 1)."""
        H, F, cof, J = strain
        P = self._stress(F, out=self.scratch("P64", F.shape, float))
        if self.K is not None:
            P = P + self.K * (self.element.cell_mean(J) - J) * cof
        out = self.scratch("P", H.shape)
        out[...] = P
        return out

    def stiffening(self, strain: Deformation) -> float:
        """How much stiffer than at rest the stiffest point is, by the largest ||A[:, J, :, J]||."""
        with np.errstate(all="ignore"):
            return float((acoustic_stiffness(self.material.tangent(strain.F)) / self.rest).max())

    def energy(self, strain: Deformation) -> float:
        """Strain energy of the cells in J."""
        volume, j = self.element.volume, strain.J - 1
        total = np.sum(self.material.energy(strain.F) * volume)
        if self.K is not None:
            mean = self.element.cell_mean(j)
            total += np.sum(self.K / 2 * np.square(mean) * self.element.cell_volume)
            total -= np.sum(self.K / 2 * np.square(j) * volume)
        return float(total)


class Weights:
    """Volumes that turn densities in units of `unit` Pa into J: factor * sum(points * density).

    points (Q, E) or (Q, 1), cells (E,): m3, or J/unit where the unit differs from cell to cell.
    """

    def __init__(self, element: FullElement | ReducedElement, unit: float | np.ndarray) -> None:
        cellwise = np.ndim(unit) > 0
        self.factor: Any = 1.0 if cellwise else unit
        self.points = unit * element.volume if cellwise else element.volume
        self.cells = unit * element.cell_volume if cellwise else element.cell_volume


def _stress_into(material):
    """stress(F, out) of a law, also of one whose stress takes no `out`."""
    if "out" in inspect.signature(material.stress).parameters:
        return material.stress
    return lambda F, out: material.stress(F)
