"""Volume-preserving loss and the metrics of training, after Karami, Lombaert, Rivest-Hénault, arXiv
2301.04614.

Lengths are in mm and volumes in mm3. A model compiled with these closures is loaded with
`compile=False`.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import keras
import numpy as np
from keras import ops

from fem.errors import InputError
from fem.online.volume import VOLUME_BAND
from fem.ranges import checked, checked_array

Tensor: TypeAlias = Any  # of Keras's backend, or an array
Loss = Callable[[Tensor, Tensor], Tensor]  # (y_true, y_pred) -> (B,)


def deformed_volume(displacement: Tensor, points: np.ndarray, faces: np.ndarray) -> Tensor:
    """Volume (B,) in mm3 of the hexahedral mesh moved by displacement (B, nx, ny, nz, 3) in mm.

    By the divergence theorem V = 1/3 sum over boundary faces of int x . n dA: faces inside the mesh
    cancel. A trilinear hexahedron has bilinear faces x(s, t) = m + s E + t F + s t G with s, t in
    [-1/2, 1/2], m the mean of the corners a, b, c, d, and E x F = 1/2 (c - a) x (d - b). Then

        x . (dx/ds x dx/dt) = m . (E x F) + s m . (E x G) + t m . (G x F) - s t E . (F x G),

    the last three integrate to zero, and each face gives exactly (a + b + c + d) . (c - a) x (d -
    b) / 24, which is also the average of its two triangulations.

    points: (nx*ny*nz, 3) mm, reference positions in C order, node (i, j, k) at (i*ny + j)*nz + k.
    faces: (M, 4) node indices of the boundary quads, counter-clockwise seen from outside.
    """
    points = np.asarray(points, dtype="float64")
    points = points - points[np.unique(faces)].mean(axis=0)  # float32 loses less near the origin
    dtype = keras.backend.standardize_dtype(displacement.dtype)
    moved = ops.reshape(displacement, (-1, *points.shape)) + ops.cast(points, dtype)  # (B, N, 3)
    corners = ops.take(moved, np.asarray(faces, dtype="int32"), axis=1)  # (B, M, 4, 3)
    a, b, c, d = (corners[:, :, n] for n in range(4))  # (B, M, 3)
    return ops.sum((a + b + c + d) * ops.cross(c - a, d - b), axis=(1, 2)) / 24


def volume_scale(
    points: np.ndarray, faces: np.ndarray, weight: float, threshold: float, truth: np.ndarray
) -> float:
    """The volume term where its gate opens, weight (threshold V_origin)^2, over the mean square of
    displacements `truth` (S, nx, ny, nz, 3) mm, which is the loss of an answer that stays at rest.

    The term has mm6 beside the mm2 of the mean square, so that this number depends on the unit of
    length: it is stated for mm.
    """
    gate = weight * (threshold * volume_at_rest(points, faces)) ** 2
    return float(gate / np.mean(np.square(truth, dtype=float)))


def volume_loss(
    points: np.ndarray,
    faces: np.ndarray,
    *,
    weight: float = 0.1,
    threshold: float = VOLUME_BAND,
    direction_weight: float = 0.0,
) -> Loss:
    """The paper's loss as a function (y_true, y_pred) -> (B,), whose mean over the batch Keras
    takes:

        L = MSE + weight (V_t - V_origin)^2          where |V_t - V_origin| > threshold V_origin,
        sample by sample,
        L = MSE                                      elsewhere,

    with V_t the volume of the prediction, of all cells or of a set, see surface.volume_surface. The
    second term has mm6 and the first mm2: see `volume_scale`. With a direction_weight, L also has
    direction_weight times the mean over the loaded nodes of ReLU(1 - cos) between force and
    predicted displacement; y_true then has six channels, the displacement and the last step's
    force: (B, nx, ny, nz, 6).

    y_true: (B, nx, ny, nz, 3 or 6) mm (and mN). y_pred: (B, nx, ny, nz, 3) mm. points, faces: see
    deformed_volume. Raises InputError for faces that do not bound a positive volume, and for
    weights out of the ranges of unet_fem.training.settings.LossChoice.
    """
    checked("weight", weight, 0, 1e6)
    checked("threshold", threshold, 0, 10)
    checked("direction_weight", direction_weight, 0, 1e6)
    origin = volume_at_rest(points, faces)

    def loss(y_true, y_pred):
        y_true = ops.cast(y_true, y_pred.dtype)
        total = ops.mean(ops.square(y_pred - y_true[..., :3]), axis=(1, 2, 3, 4))  # (B,)
        change = deformed_volume(y_pred, points, faces) - origin
        gate = ops.abs(change) > threshold * origin
        total += weight * ops.where(gate, ops.square(change), 0.0)
        if direction_weight:
            total += direction_weight * direction_loss(y_true[..., 3:], y_pred)
        return total

    return loss


def direction_loss(force: Tensor, displacement: Tensor, smoothing: float = 1e-3) -> Tensor:
    """Mean over the loaded nodes of ReLU(1 - cos(force, displacement)): (B,), zero for a sample
    without load.

    force, displacement: (B, nx, ny, nz, 3), mN and mm. smoothing: mm, added to the displacement's
    length in quadrature, so that the gradient stays finite where nothing has moved yet.
    """
    squared_force = ops.sum(ops.square(force), axis=-1)  # (B, nx, ny, nz)
    loaded = squared_force > 0
    force_length = ops.sqrt(ops.where(loaded, squared_force, 1.0))
    length = ops.sqrt(ops.sum(ops.square(displacement), axis=-1) + smoothing**2)
    cosine = ops.sum(force * displacement, axis=-1) / (force_length * length)
    penalty = ops.where(loaded, ops.relu(1 - cosine), 0.0)
    count = ops.sum(ops.cast(loaded, penalty.dtype), axis=(1, 2, 3))
    return ops.sum(penalty, axis=(1, 2, 3)) / ops.maximum(count, 1)


def gate_open(points: np.ndarray, faces: np.ndarray, threshold: float = VOLUME_BAND) -> Loss:
    """Metric: fraction of predictions whose volume is off by more than threshold, those the volume
    term acts on."""
    origin = volume_at_rest(points, faces)

    def gate_open(y_true, y_pred):
        change = ops.abs(deformed_volume(y_pred, points, faces) - origin)
        return ops.cast(change > threshold * origin, "float32")  # (B,)

    return gate_open


def volume_violation(points: np.ndarray, faces: np.ndarray) -> Loss:
    """Metric: mean over the predictions of |V_t - V_origin| / V_origin."""
    origin = volume_at_rest(points, faces)

    def volume_violation(y_true, y_pred):
        return ops.abs(deformed_volume(y_pred, points, faces) / origin - 1)  # (B,)

    return volume_violation


class RelativeError(keras.metrics.Metric):
    """Relative L2 error of all samples seen so far: sqrt(sum |y_pred - y_true|^2 / sum |y_true|^2).

    Sums are carried over the batches, so the result does not depend on how the data are batched. A
    sample_weight (B,) weighs both sums.
    """

    def __init__(self, name: str = "relative_error", **kwargs: object) -> None:
        super().__init__(name=name, **kwargs)
        self.squared_error = self.add_weight(name="squared_error", initializer="zeros")
        self.squared_truth = self.add_weight(name="squared_truth", initializer="zeros")

    def update_state(
        self, y_true: Tensor, y_pred: Tensor, sample_weight: Tensor | None = None
    ) -> None:
        """Add a batch."""
        truth = ops.cast(y_true, "float32")[..., :3]
        weight = (
            1.0
            if sample_weight is None
            else ops.reshape(ops.cast(sample_weight, "float32"), (-1, 1, 1, 1, 1))
        )
        self.squared_error.assign_add(
            ops.sum(weight * ops.square(ops.cast(y_pred, "float32") - truth))
        )
        self.squared_truth.assign_add(ops.sum(weight * ops.square(truth)))

    def result(self) -> Tensor:
        """The error of all batches so far."""
        return ops.sqrt(ops.divide_no_nan(self.squared_error, self.squared_truth))


def volume_at_rest(points: np.ndarray, faces: np.ndarray) -> float:
    """V_origin in mm3, a float. Raises InputError for faces that do not bound a positive volume."""
    faces = checked_array("faces", faces, (None, 4), whole=True)
    if not len(faces):
        raise InputError("there are no faces; give those around the cells, (M, 4)")
    points = np.asarray(points)
    if points.ndim != 2:  # of those that no face has there may be any
        checked_array("points", points, (None, 3))
    if faces.min() < 0 or faces.max() >= len(points):
        found = f"{faces.min()} to {faces.max()}"
        raise InputError(
            f"faces use nodes {found} of {len(points)}; number nodes (i*ny + j)*nz + k"
        )
    checked_array("points", points[np.unique(faces)], (None, 3))
    volume = float(deformed_volume(np.zeros((1, *points.shape)), points, faces)[0])
    if not volume > 0:
        raise InputError(
            f"faces bound {volume:.4g} mm3; order each counter-clockwise as seen from outside"
        )
    return volume
