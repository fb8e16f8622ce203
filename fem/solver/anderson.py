"""Anderson acceleration of a fixed-point iteration (Anderson 1965; Walker and Ni 2011)."""

from typing import Any

import numpy as np

from fem.online.stepper import State

WINDOW = 6  # pairs of differences that are kept
RIDGE = 1e-10  # on the normal equations, in units of their trace
TINY = 1e-300  # the same where nothing has changed


class Anderson:
    """The next iterate of x <- x + r(x), from the differences of the last ones.

    The combination of the last residuals that is smallest says where to go on:

        x + r - sum t_i (dx_i + dr_i),   t = argmin |r - sum t_i dr_i|

    The differences outlive a call of `begin`, which starts with another r of nearly the same slope.

    size: of x and r, which may have any shape
    """

    def __init__(self, size: int, window: int = WINDOW) -> None:
        self.window = window
        self.dx, self.dr = (np.zeros((window, size)) for _ in "xr")
        self.count = 0  # pairs that have been kept, the last of them at (count - 1) % window
        self._x: Any = None
        self._r: Any = None

    def clear(self) -> None:
        """Forget every difference."""
        self.count, self._x = 0, None

    def begin(self) -> None:
        """The next call is of another function: no difference with the last."""
        self._x = None

    def __call__(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """The iterate after x, whose residual is r."""
        x_, r_ = x.ravel(), r.ravel()
        if self._x is not None:
            place = self.count % self.window
            np.subtract(x_, self._x, out=self.dx[place])
            np.subtract(r_, self._r, out=self.dr[place])
            self.count += 1
        self._x, self._r = x_.copy(), r_.copy()
        kept = min(self.count, self.window)
        new = x_ + r_
        if kept:
            dx, dr = self.dx[:kept], self.dr[:kept]
            normal = dr @ dr.T
            normal.flat[:: kept + 1] += RIDGE * np.trace(normal) + TINY
            weights = np.linalg.solve(normal, dr @ r_)
            new -= weights @ dx + weights @ dr
        return new.reshape(x.shape)

    def state(self) -> State:
        """The kept differences, between two calls of `begin`."""
        return {"dx": self.dx.copy(), "dr": self.dr.copy(), "count": np.array(self.count)}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave."""
        self.dx, self.dr = np.array(state["dx"]), np.array(state["dr"])
        self.count, self._x = int(state["count"]), None
