"""The reduced equilibrium with its stress history: what is left of a frame's force in modal
coordinates. See fem.online.reduced for the equations."""

import numpy as np

from fem.online.creep import exponential_weights
from fem.online.point_law import FULL, point_law
from fem.online.reduced_model import ReducedModel
from fem.online.stepper import State


class Residual:
    """r(a) of one frame after the other.

    `set_interval(dt)` before the first frame and whenever dt changes; then, frame by frame,
    `begin(g)`, `self(a)` as often as wanted, and `accept(a)`. Vectors (R,) have the even modes
    first; `parts` are the slices of the blocks.
    """

    def __init__(self, model: ReducedModel) -> None:
        blocks = model.blocks
        ends = np.cumsum([0] + [len(block.M) for block in blocks])
        self.parts = [slice(i, j) for i, j in zip(ends[:-1], ends[1:], strict=True)]
        self.R, self.m = model.modes, model.points
        h = self.m // len(blocks)
        self.mirrored = len(blocks) == 2
        self.law = point_law(model.law, self.m)
        self._H = [np.empty((3, 3, h), np.float32) for _ in blocks]  # of each parity
        self._T = np.empty((3, 3, self.m), np.float32)
        self._z = [np.empty(block.M.shape[1], np.float32) for block in blocks]
        self._y = np.empty(self.R, np.float32)
        self._b = np.empty(self.R, np.float32)
        self._rhs = np.empty(self.R, np.float32)
        self._Q = np.zeros((3, 3, self.m), np.float32)
        # for each parity: A (with few long rows, which is faster), M, its coordinates and those
        # that points see, and its work arrays
        self._gemvs = [
            (
                np.ascontiguousarray(block.A.T),
                block.M,
                part,
                slice(part.start, part.start + block.A.shape[1]),
            )
            for block, part in zip(blocks, self.parts, strict=True)
        ]
        self._in = [(H.reshape(-1), z, z[: 9 * h]) for H, z in zip(self._H, self._z, strict=True)]
        self._seen = [z[9 * h :] for z in self._z]
        self._sides = self.law.H[:, :, :h], self.law.H[:, :, h:]
        self._stresses = self._T[:, :, :h], self._T[:, :, h:]
        self._folded = [z[: 9 * h].reshape(3, 3, h) for z in self._z]
        self.prony = [(float(g), float(tau)) for g, tau in model.prony]
        self.c, self._viscous = 1.0, bool(self.prony)
        # rows: relaxed stresses q_k, the last stress, the new one; columns: points, then modes
        self._Z = np.zeros((len(self.prony) + 2, 6 * self.m + self.R))
        self._memory = np.zeros(6 * self.m + self.R)
        self.size = 0

    def set_interval(self, dt: float) -> None:
        """Frames of dt s from here on."""
        K = len(self.prony)
        self._advance, self._weights, self.c = np.zeros((K, K + 2)), np.zeros(K + 1), 1.0
        for k, (g, tau) in enumerate(self.prony):
            a, old, new = exponential_weights(dt, tau)
            self._advance[k, k], self._advance[k, K:] = 1 - a, (a * old, a * new)
            self._weights[k] = g * (1 - a)
            self._weights[K] += g * a * old
            self.c -= g * a * new
        self._kept = np.float32(self.c)

    def begin(self, g: np.ndarray) -> None:
        """A frame with the elastic answer g (R,) mm to its force."""
        if not self._viscous:
            self._rhs[:] = g
            return
        np.dot(self._weights, self._Z[:-1], out=self._memory)
        six = self._memory[: 6 * self.m].reshape(6, self.m)
        self._Q[...] = six[FULL]
        self._aQ = self._memory[6 * self.m :].astype(np.float32)
        np.add(g, self._aQ, out=self._rhs)
        self._rhs /= self._kept

    def __call__(self, a: np.ndarray) -> np.ndarray:
        """The residual (R,) mm at the coordinates a (R,) float32: a new array."""
        b = np.multiply(a, self._kept, out=self._b)
        if self._viscous:
            b -= self._aQ
        for (A, _, _, seen), (H, *_) in zip(self._gemvs, self._in, strict=True):
            np.dot(a[seen], A, out=H)
        left, right = self._sides
        if self.mirrored:
            even, odd = self._H
            np.add(even, odd, out=left)
            np.subtract(even, odd, out=right)
        else:
            left[...] = self._H[0]
        self.law(self._kept, self._Q if self._viscous else None, self._T)
        left, right = self._stresses
        if self.mirrored:
            even, odd = self._folded
            np.add(left, right, out=even)
            np.subtract(left, right, out=odd)
        else:
            self._folded[0][...] = left
        y = self._y
        for (_, M, part, seen), z, rest in zip(self._gemvs, self._z, self._seen, strict=True):
            rest[:] = b[seen]
            np.dot(M, z, out=y[part])
        y /= self._kept
        r = np.subtract(self._rhs, a)
        r -= y
        return r

    def viscous(self, points: np.ndarray) -> np.ndarray:
        """Q (3, 3, k) of this frame at some of the points."""
        return self._Q[:, :, points]

    def accept(self, a: np.ndarray) -> None:
        """The frame ends at a; its stress is that of the last call."""
        if not self._viscous:
            return
        Z, points = self._Z, 6 * self.m
        Z[-1, :points] = self.law.second().ravel()
        Z[-1, points:] = a
        Z[:-2] = self._advance @ Z
        Z[-2] = Z[-1]

    def reset(self) -> None:
        """Rest: no stress in the past."""
        self._Z[:] = 0

    def state(self) -> State:
        """The history, {"history": (K + 1, 6 m + R)}."""
        return {"history": self._Z[:-1].copy()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave."""
        self._Z[:-1] = state["history"]
