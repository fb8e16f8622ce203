"""Stresses at single points of a body: the viscoelastic law where a reduced model looks at it.

    P_e = dW/dF,   T = c P_e - F Q,   S_e = F^-1 P_e,   F = I + H

in units of the shear modulus at rest of each point. c and Q come from the stress history, see
fem.online.creep.exponential_weights. Arrays are components-first, (3, 3, m), and all work arrays
are made once.
"""

from typing import Any

import numpy as np

from fem.material.base import Hyperelastic, bulk_modulus, shear_modulus
from fem.material.kinematics import cofactor, determinant
from fem.material.neo_hooke import NeoHooke

FIRST, SECOND = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])  # of six components
FULL = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # and where (i, j) is among them


class PointLaw:
    """Any law at m points, through its own stress in float64.

    law: of the points, with one value or one a point (m,) of each parameter. Put the displacement
    gradient into `H` (3, 3, m) float32 and call it. Where J <= 0 the stress means nothing, and may
    not be finite: whoever calls it keeps NumPy's warnings quiet.
    """

    def __init__(self, law: Hyperelastic, m: int) -> None:
        self.law, self.mu = law, shear_modulus(law)
        self.H = np.zeros((3, 3, m), np.float32)
        self.P = np.zeros((3, 3, m), np.float32)
        self._work = np.empty((3, 3, m), np.float32)

    def __call__(self, c: float | np.floating, Q: np.ndarray | None, out: np.ndarray) -> np.ndarray:
        """T (3, 3, m) into `out`; Q (3, 3, m) symmetric, or None for elastic tissue."""
        self._elastic()
        if Q is None:
            out[...] = self.P
            return out
        np.multiply(self.P, c, out=out)
        out -= Q
        for k in range(3):
            out -= np.multiply(self.H[:, k, None], Q[k], out=self._work)
        return out

    def _elastic(self):
        F = np.array(self.H, float)
        F.reshape(9, -1)[::4] += 1
        self.P[...] = self.law.stress(F) / self.mu

    def second(self) -> np.ndarray:
        """S_e (6, m) of the last call, in an array that the next one may overwrite."""
        F = np.array(self.H, float)
        F.reshape(9, -1)[::4] += 1
        cof = cofactor(F)
        S = np.einsum("kim,kim->im", cof[:, FIRST], self.P[:, SECOND])
        return S / determinant(F, cof)


class NeoHookePoints(PointLaw):
    """The neo-Hookean law in few passes, from H and j = J - 1, so that small strains keep their
    digits in float32; see fem.solver.stresses.

        P / mu = H + (q - 1)(cof H - H^T) + (q + (q - 1) tr H) I,   q = j/J + (K/mu) j
    """

    def __init__(self, law: NeoHooke, m: int) -> None:
        super().__init__(law, m)
        shared = np.ndim(law.mu) and not np.ndim(law.nu)
        bulk: Any = bulk_modulus(1.0, law.nu) if shared else law.K / law.mu
        self.bulk = np.float32(bulk) if np.ndim(bulk) == 0 else np.asarray(bulk, np.float32)
        # rows and columns repeat cyclically, so that one product has all nine cofactors
        X = np.zeros((5, 5, m), np.float32)
        self.H = H = X[:3, :3]
        self._rows, self._columns = (X[3:, :3], X[:2, :3]), (X[:, 3:], X[:, :2])
        self._products = X[1:4, 1:4], X[2:5, 2:5], X[1:4, 2:5], X[2:5, 1:4]
        self._transposed, self._top = H.swapaxes(0, 1), (H[0], self.P[0])
        self._diagonals = (H[0, 0], H[1, 1], H[2, 2]), (self.P[0, 0], self.P[1, 1], self.P[2, 2])
        self._diagonal = self.P.reshape(9, m)[::4]
        self._trace, self._j, self._J, self._q = np.empty((4, m), np.float32)
        self._six = np.empty((2, 3, 6, m), np.float32)

    def _cofactor(self, out):
        """cof H."""
        for here, there in (self._rows, self._columns):
            here[...] = there
        first, second, third, fourth = self._products
        np.multiply(first, second, out=out)
        out -= np.multiply(third, fourth, out=self._work)

    def _elastic(self):
        C, trace, j, J, q = self.P, self._trace, self._j, self._J, self._q
        self._cofactor(C)
        (H11, H22, H33), (C11, C22, C33) = self._diagonals
        np.add(H11, H22, out=trace)
        trace += H33
        one, two, three = np.multiply(*self._top, out=self._work[0])
        np.add(one, two, out=j)
        for term in (three, C11, C22, C33, trace):
            j += term
        np.add(j, 1, out=J)
        np.divide(j, J, out=q)
        q += np.multiply(j, self.bulk, out=j)
        C -= self._transposed
        r = np.subtract(q, 1, out=j)
        C *= r
        C += self.H
        trace *= r
        trace += q
        self._diagonal += trace

    def second(self) -> np.ndarray:
        """S_e = cof F^T P / J (6, m) of the last call, cof F = (1 + tr H) I - H^T + cof H."""
        cof = np.empty_like(self.P)
        self._cofactor(cof)
        cof -= self._transposed
        cof.reshape(9, -1)[::4] += sum(self._diagonals[0], start=1)
        left, right = self._six
        cof.take(FIRST, axis=1, out=left, mode="clip")
        self.P.take(SECOND, axis=1, out=right, mode="clip")
        left *= right
        S = np.add(left[0], left[1], out=left[0])
        S += left[2]
        S /= self._J
        return S


def point_law(law: Hyperelastic, m: int) -> PointLaw:
    """The PointLaw of `law` at m points, the fast one where there is one."""
    return NeoHookePoints(law, m) if type(law) is NeoHooke else PointLaw(law, m)
