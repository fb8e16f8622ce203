"""Cofactor and determinant of deformation gradients (3, 3, ...), and what a pressure adds to a
stress.

    cof F = J F^-T,   J = det F
    P_vol = p(J) cof F,   dP_vol/dF = p'(J) cof F x cof F + p(J) dcof F/dF
"""

import numpy as np

IDENTITY = np.eye(3)


def cofactor(F: np.ndarray) -> np.ndarray:
    """cof F (3, 3, ...)."""
    out = np.empty(F.shape, np.result_type(F, float))
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            np.multiply(F[i1, j1], F[i2, j2], out=out[i, j, ...])
            out[i, j] -= F[i1, j2] * F[i2, j1]
    return out


def determinant(F: np.ndarray, cof: np.ndarray) -> np.ndarray:
    """J (...) from F and cof F."""
    return F[0, 0] * cof[0, 0] + F[0, 1] * cof[0, 1] + F[0, 2] * cof[0, 2]


def pressure_tangent(
    F: np.ndarray, cof: np.ndarray, p: np.ndarray, slope: np.ndarray
) -> np.ndarray:
    """d(p(J) cof F)/dF (3, 3, 3, 3, ...), with p and dp/dJ (...)."""
    out, pF = np.einsum("iJ...,kL...->iJkL...", slope * cof, cof), p * F
    for i, J in np.ndindex(3, 3):  # dcof_iJ/dF_kL = e_ikm e_JLM F_mM, finite where J = 0 too
        i1, i2, J1, J2 = (i + 1) % 3, (i + 2) % 3, (J + 1) % 3, (J + 2) % 3
        out[i, J, i1, J1] += pF[i2, J2]
        out[i, J, i2, J2] += pF[i1, J1]
        out[i, J, i1, J2] -= pF[i2, J1]
        out[i, J, i2, J1] -= pF[i1, J2]
    return out


def add_to_diagonal(A: np.ndarray, value: np.ndarray | float) -> np.ndarray:
    """A (3, 3, 3, 3, ...) with value (...) d_ik d_JL added in place."""
    for i, J in np.ndindex(3, 3):
        A[i, J, i, J] += value
    return A


def where_upright(J: np.ndarray, W: np.ndarray) -> np.ndarray:
    """W where J > 0, and inf where the tissue is inverted."""
    return np.where(J > 0, W, np.inf)
