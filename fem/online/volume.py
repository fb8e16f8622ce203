"""The volume within a closed surface of quads, and how far a predicted one may be off."""

import numpy as np

VOLUME_BAND = 0.07  # the paper's, of the volume at rest


class QuadVolume:
    """The volume in mm3 within quads (a, b, c, d), by the divergence theorem in float32.

    V = sum (a + b + c + d) . (c - a) x (d - b) / 24, the same as in unet_fem.training.losses. Only
    faces with a node that moves change; the others are summed once. A call allocates nothing.
    """

    def __init__(self, points: np.ndarray, faces: np.ndarray, moving: np.ndarray) -> None:
        """points: (N, 3) mm. faces: (M, 4) nodes, counter-clockwise seen from outside. moving: N
        values of bool, in any shape, the nodes that may be displaced."""
        points = points - points[np.unique(faces)].mean(
            axis=0
        )  # float32 loses less near the origin
        moves = moving.ravel()[faces].any(axis=1)
        self._nodes = faces[moves].T.ravel()  # (4 M,) the corners a of all faces, then b, c, d
        self._rest = points[self._nodes].astype("float32")
        shape = int(moves.sum()), 3
        self._corners = np.empty_like(self._rest)
        self._a, self._b, self._c, self._d = self._corners.reshape(4, *shape)
        self._e, self._f, self._normal = (np.empty(shape, "float32") for _ in range(3))
        self._product = np.empty(shape[0], "float32")
        a, b, c, d = (points[faces[~moves, n]] for n in range(4))
        self._constant = float(np.sum((a + b + c + d) * np.cross(c - a, d - b))) / 24

    def __call__(self, displacement: np.ndarray) -> float:
        """mm3 under displacement of N nodes, (..., 3) mm."""
        a, b, c, d, e, f = self._a, self._b, self._c, self._d, self._e, self._f
        normal, product = self._normal, self._product
        np.take(displacement.reshape(-1, 3), self._nodes, axis=0, out=self._corners, mode="clip")
        self._corners += self._rest
        np.subtract(c, a, out=e)
        np.subtract(d, b, out=f)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(e[:, j], f[:, k], out=normal[:, i])
            np.multiply(e[:, k], f[:, j], out=product)
            normal[:, i] -= product
        a += b
        a += c
        a += d
        return self._constant + float(np.vdot(a, normal)) / 24
