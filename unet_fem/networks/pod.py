"""Regressions as competitors: from a window of forces to the displacement, in full or through a few
modes.

    linear      u = W f
    POD         u = sum_k (W f)_k phi_k
    quadratic   u = sum_k (W f + Q f^2)_k phi_k

with phi_k the modes of the training displacements (proper orthogonal decomposition) and the weights
by ridge regression. No mean is
taken out: no force moves nothing, and with a mean the error on the paper's unseen interactions is
41 % in place of 18 %. The kind of quadratic terms and their WEIGHT were chosen on the paper's
validation data: squares of the forces err 12.3 % there, products of the 3 to 40 leading
coefficients 12.4 %, the linear answer 12.6 %.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from unet_fem.networks import ridge

# of the squared forces beside the forces, both of root mean square 1; smaller is more regular
WEIGHT = 0.1


@dataclass(frozen=True)
class Regression:
    """mask (nx, ny, nz), the free nodes; active (p,) force components used; kernel (p, q or r)
    mm/mN; modes (r, q) or None; squares (p, r) mm/mN^2, or None without quadratic terms."""

    mask: np.ndarray
    active: np.ndarray
    kernel: np.ndarray
    modes: np.ndarray | None = None
    squares: np.ndarray | None = None

    @property
    def family(self):
        return (
            "linear" if self.modes is None else "POD" if self.squares is None else "POD + quadratic"
        )

    @property
    def parameters(self):
        return sum(a.size for a in (self.kernel, self.modes, self.squares) if a is not None)


def predict(model, force):
    """Displacement (S, nx, ny, nz, 3) float32 mm from force windows (S, [T,] nx, ny, nz, 3) mN."""
    f = force.reshape(len(force), -1)[:, model.active]
    u = f @ model.kernel
    if model.squares is not None:
        u += f**2 @ model.squares
    if model.modes is not None:
        u = u @ model.modes
    result = np.zeros((len(force), *model.mask.shape, 3), "float32")
    result[:, model.mask] = u.reshape(len(force), -1, 3)
    return result


def linear(train, validation, mask):
    """The linear Regression on Samples, its ridge chosen on `validation`: the same as
    unet_fem.networks.linear.linear_regression."""
    active = np.flatnonzero(train.force.any(axis=0))
    shown = [
        (_columns(samples, active), _free_nodes(samples, mask)) for samples in (train, validation)
    ]
    kernel, _ = ridge.fit(*shown[0], ridge.RIDGES, shown[1])
    return Regression(mask, active, kernel.astype("float32"))


def reduced(full, train, validation, modes):
    """(POD, POD + quadratic), Regressions with `modes` modes, or as many as there are samples, on
    the samples that `full` was fitted to.

    Ridge regression to the coefficients is the linear one's weights taken to the modes. The modes
    are in order and each coefficient
    has weights of its own: `truncated` gives the regressions with fewer.
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
    parts = {"kernel": both[:p] / size, "squares": both[p:] * weight}
    return pod, replace(
        pod, **{name: np.ascontiguousarray(values, "float32") for name, values in parts.items()}
    )


def truncated(model, modes):
    """`model` with its first `modes` modes alone."""
    squares = None if model.squares is None else np.ascontiguousarray(model.squares[:, :modes])
    return replace(
        model,
        kernel=np.ascontiguousarray(model.kernel[:, :modes]),
        modes=model.modes[:modes],
        squares=squares,
    )


def _columns(samples, active):
    return samples.force.reshape(len(samples), -1)[:, active].astype(float)  # (S, p) mN


def _free_nodes(samples, mask):
    return samples.displacement[:, mask].reshape(len(samples), -1).astype(float)  # (S, q) mm
