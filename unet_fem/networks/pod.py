"""Regressions fitted in closed form: from a window of forces to the displacement, in full or
through a few modes, see fem.online.regression.

The modes are those of the training displacements (proper orthogonal decomposition), the weights
come by ridge regression. No mean is taken out: no force moves nothing, and with a mean the error on
the paper's unseen interactions is 41 % in place of 18 %. The kind of quadratic terms and their
WEIGHT were chosen on the paper's validation data: squares of the forces err 12.3 % there, products
of the 3 to 40 leading coefficients 12.4 %, the linear answer 12.6 %.
"""

from dataclasses import replace
from typing import Protocol

import numpy as np
import scipy.linalg

from fem.errors import InputError
from fem.online.regression import Regression
from unet_fem.networks import ridge

# of the squared forces beside the forces, both of root mean square 1; smaller is more regular
WEIGHT = 0.1

predict = Regression.predict


class Samples(Protocol):
    """What is fitted to, such as unet_fem.training.samples.Samples: windows of forces, as they are
    or remembered, (S, [T,] nx, ny, nz, 3) mN, and the displacement (S, nx, ny, nz, 3) mm of their
    last frames."""

    @property
    def input(self) -> np.ndarray: ...

    @property
    def displacement(self) -> np.ndarray: ...

    def __len__(self) -> int: ...


def linear(train: Samples, validation: Samples, mask: np.ndarray) -> Regression:
    """The linear Regression on Samples, its ridge chosen on `validation`.

    With X the force components that are ever nonzero and Y the displacement of the free nodes,
    mask (nx, ny, nz), the kernel is what `ridge.fit` gives, in float64 until it is kept. Raises
    InputError where all forces are zero.
    """
    active = np.flatnonzero(train.input.any(axis=0))
    if not active.size:
        raise InputError(f"all {len(train)} training forces are zero; give samples with contact")
    shown = [
        (_columns(samples, active), _free_nodes(samples, mask)) for samples in (train, validation)
    ]
    kernel, _ = ridge.fit(*shown[0], ridge.RIDGES, shown[1])
    steps = train.input.shape[1] if train.input.ndim == 6 else None
    return Regression(mask, active, kernel.astype("float32"), steps=steps)


def pod(
    train: Samples, validation: Samples, mask: np.ndarray, modes: int, quadratic: bool
) -> Regression:
    """The POD, or POD + quadratic, Regression on Samples with `modes` modes, or as many as there
    are samples."""
    full = linear(train, validation, mask)
    return reduced(full, train, validation, modes)[quadratic]


def reduced(
    full: Regression, train: Samples, validation: Samples, modes: int
) -> tuple[Regression, Regression]:
    """(POD, POD + quadratic), Regressions with `modes` modes, or as many as there are samples, on
    the samples that `full` was fitted to.

    Ridge regression to the coefficients is the linear one's weights taken to the modes. The modes
    are in order and each coefficient has weights of its own: `truncated` gives the regressions with
    fewer.
    """
    X, X_validation = (_columns(samples, full.active) for samples in (train, validation))
    Y, Y_validation = (_free_nodes(samples, full.mask) for samples in (train, validation))
    phi = scipy.linalg.svd(Y, full_matrices=False)[2][:modes]  # (r, q)
    kernel = full.kernel @ phi.T
    size = np.sqrt(np.mean(np.sum(X**2, axis=1)))  # mN
    weight = WEIGHT / np.sqrt(np.mean(np.sum(X**4, axis=1)))  # 1/mN^2

    def with_squares(X):
        return np.hstack([X / size, weight * X**2])

    both, _ = ridge.fit(
        with_squares(X), Y @ phi.T, ridge.RIDGES, (with_squares(X_validation), Y_validation @ phi.T)
    )
    pod = replace(full, kernel=kernel.astype("float32"), modes=phi.astype("float32"))
    p = len(full.active)
    kernel, squares = (
        np.ascontiguousarray(part, "float32") for part in (both[:p] / size, both[p:] * weight)
    )
    return pod, replace(pod, kernel=kernel, squares=squares)


def truncated(model: Regression, modes: int) -> Regression:
    """`model`, which has modes, with its first `modes` alone."""
    assert model.modes is not None
    squares = None if model.squares is None else np.ascontiguousarray(model.squares[:, :modes])
    return replace(
        model,
        kernel=np.ascontiguousarray(model.kernel[:, :modes]),
        modes=model.modes[:modes],
        squares=squares,
    )


def _columns(samples, active):
    return samples.input.reshape(len(samples), -1)[:, active].astype(float)  # (S, p) mN


def _free_nodes(samples, mask):
    return samples.displacement[:, mask].reshape(len(samples), -1).astype(float)  # (S, q) mm
