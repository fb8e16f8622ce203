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
        self._X = np.zeros((5, 5, m), np.float32)
        self.H = self._X[:3, :3]
        self._diagonal = self.P.reshape(9, m)[::4]
        self._trace, self._j, self._J, self._q = np.empty((4, m), np.float32)
        self._six = np.empty((2, 3, 6, m), np.float32)

    def _elastic(self):
        X, H, C, W = self._X, self.H, self.P, self._work
        trace, j, J, q = self._trace, self._j, self._J, self._q
        X[3:, :3] = X[:2, :3]
        X[:, 3:] = X[:, :2]
        np.multiply(X[1:4, 1:4], X[2:5, 2:5], out=C)
        C -= np.multiply(X[1:4, 2:5], X[2:5, 1:4], out=W)
        np.add(H[0, 0], H[1, 1], out=trace)
        trace += H[2, 2]
        D = np.multiply(H[0], C[0], out=W[0])
        np.add(D[0], D[1], out=j)
        j += D[2]
        j += C[0, 0]
        j += C[1, 1]
        j += C[2, 2]
        j += trace
        np.add(j, 1, out=J)
        np.divide(j, J, out=q)
        q += np.multiply(j, self.bulk, out=j)
        C -= H.swapaxes(0, 1)
        r = np.subtract(q, 1, out=j)
        C *= r
        C += H
        trace *= r
        trace += q
        self._diagonal += trace

    def second(self) -> np.ndarray:
        """S_e = cof F^T P / J (6, m) of the last call, cof F = (1 + tr H) I - H^T + cof H."""
        X, H, cof = self._X, self.H, np.empty_like(self.P)
        np.multiply(X[1:4, 1:4], X[2:5, 2:5], out=cof)
        cof -= np.multiply(X[1:4, 2:5], X[2:5, 1:4], out=self._work)
        cof -= H.swapaxes(0, 1)
        cof.reshape(9, -1)[::4] += H[0, 0] + H[1, 1] + H[2, 2] + 1
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
