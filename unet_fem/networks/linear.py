"""Linear regression as a Keras model."""

import keras
import numpy as np
from keras import layers, ops

from fem.errors import InputError
from unet_fem.networks import ridge as ridge_regression
from unet_fem.networks.layers import displacement_layer


def linear_regression(force, displacement, mask, ridge=1e-6, validation=None):
    """Ridge regression in closed form, as a Keras model with the networks' input and output.

    With X the force components that are ever nonzero, Y the displacement of the free nodes, and s
    the largest eigenvalue of X^T X, the kernel is W = (X^T X + ridge s I)^-1 X^T Y = X^T (X X^T +
    ridge s I)^-1 Y, by whichever matrix is smaller, in float64. There is no intercept: no force, no
    displacement.

    force: (S, nx, ny, nz, 3) or windows (S, T, nx, ny, nz, 3), mN. displacement: (S, nx, ny, nz,
    3), mm.
    mask: (nx, ny, nz) bool, the free material nodes. ridge: one value or several, as a fraction of
    s; several cost one eigendecomposition, and the best on validation = (force, displacement) is
    kept. The model's name tells which. Raises InputError when all forces are zero, or several
    ridges come without validation.
    """
    mask = np.asarray(mask, dtype=bool)
    active = np.flatnonzero(np.any(force, axis=0))
    if active.size == 0:
        raise InputError(f"all {len(force)} training forces are zero; give samples with contact")

    def columns(force):
        return force.reshape(len(force), -1)[:, active].astype("float64")  # (S, p)

    def free_nodes(displacement):
        return displacement[:, mask].reshape(len(displacement), -1).astype("float64")  # (S, q)

    X, Y = columns(force), free_nodes(displacement)
    shown = None if validation is None else (columns(validation[0]), free_nodes(validation[1]))
    kernel, ridge = ridge_regression.fit(X, Y, ridge, shown)  # (p, q)

    position = np.zeros((*mask.shape, 3), dtype="int32")
    position[mask] = np.arange(kernel.shape[1]).reshape(-1, 3)
    inputs = keras.Input(force.shape[1:], name="force")  # (B, [T,] nx, ny, nz, 3)
    x = layers.Flatten(dtype="float32", name="force_flat")(inputs)
    x = ops.take(x, active.astype("int32"), axis=1)  # (B, p)
    dense = layers.Dense(kernel.shape[1], use_bias=False, dtype="float32", name="regression")
    x = ops.take(dense(x), position.ravel(), axis=1)  # (B, nx*ny*nz*3)
    x = layers.Reshape(position.shape, dtype="float32", name="displacement_grid")(
        x
    )  # (B, nx, ny, nz, 3)
    model = keras.Model(inputs, displacement_layer(x, 1.0, mask), name=f"linear_ridge_{ridge:g}")
    dense.set_weights([kernel.astype("float32")])
    return model
