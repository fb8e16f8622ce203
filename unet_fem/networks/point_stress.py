"""The neo-Hookean law at material points as a layer of a network: keras.ops alone, batch first, and
in units of the shear modulus. It has the formulas of fem.online.point_law."""

from typing import Any, NamedTuple

import numpy as np
from keras import ops


def cyclic(x: Any) -> Any:
    """(B, 3, 3, m) with its first two rows and columns again behind it: (B, 5, 5, m)."""
    x = ops.concatenate([x, x[:, :2]], axis=1)
    return ops.concatenate([x, x[:, :, :2]], axis=2)


class Stress(NamedTuple):
    """P (B, 3, 3, m) of a displacement gradient, and what S is made of: cof F and J (B, 1, 1,
    m)."""

    P: Any
    cof: Any
    J: Any


EYE = np.eye(3, dtype="float32")[None, :, :, None]


def trace(H: Any) -> Any:
    """(B, 1, 1, m) of (B, 3, 3, m)."""
    return H[:, :1, :1] + H[:, 1:2, 1:2] + H[:, 2:, 2:]


def neo_hooke(H: Any, bulk: Any) -> Stress:
    """The Stress in units of mu at displacement gradients H (B, 3, 3, m); bulk: K / mu.

    P = H + (q - 1)(cof H - H^T) + (q + (q - 1) tr H) I, q = j / J + K j, j = J - 1: as in
    fem.solver.stresses, without cancellation.
    """
    X = cyclic(H)
    C = X[:, 1:4, 1:4] * X[:, 2:5, 2:5] - X[:, 1:4, 2:5] * X[:, 2:5, 1:4]  # cof H
    row = H[:, :1] * C[:, :1]
    tr = trace(H)
    j = tr + trace(C) + row[:, :, :1] + row[:, :, 1:2] + row[:, :, 2:]
    J = 1 + j
    q = j / J + bulk * j
    D = C - ops.transpose(H, (0, 2, 1, 3))
    P = H + (q - 1) * D + (q + (q - 1) * tr) * EYE
    return Stress(P, D + (1 + tr) * EYE, J)


def second_stress(stress: Stress) -> Any:
    """S = F^-1 P = cof F^T P / J, (B, 6, m): its components 00, 11, 22, 12, 20, 01."""
    cof, P = stress.cof, stress.P
    turned_cof = ops.concatenate([cof[:, :, 1:], cof[:, :, :1]], axis=2)  # columns 1 2 0
    turned_P = ops.concatenate([P[:, :, 2:], P[:, :, :2]], axis=2)  # columns 2 0 1
    S = ops.concatenate([cof * P, turned_cof * turned_P], axis=2)
    S = (S[:, :1] + S[:, 1:2] + S[:, 2:]) / stress.J
    return ops.reshape(S, (-1, 6, S.shape[-1]))


def at_rest(H: Any, bulk: Any) -> Any:
    """C : H, the linear stress in units of mu."""
    return H + ops.transpose(H, (0, 2, 1, 3)) + bulk * trace(H) * EYE


def full(V: Any) -> Any:
    """A symmetric tensor (B, 6, m), in the order of `second_stress`, as (B, 3, 3, m)."""
    order = (0, 5, 4, 5, 1, 3, 4, 3, 2)
    rows = ops.concatenate([V[:, k : k + 1] for k in order], axis=1)
    return ops.reshape(rows, (-1, 3, 3, V.shape[-1]))


def times(F: Any, Q: Any) -> Any:
    """The matrix products F Q of (B, 3, 3, m)."""
    return F[:, :, :1] * Q[:, :1] + F[:, :, 1:2] * Q[:, 1:2] + F[:, :, 2:] * Q[:, 2:]
