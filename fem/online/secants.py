"""Anderson acceleration: what a fixed-point iteration's past steps tell about its next one."""

import numpy as np

from fem.online.stepper import State

REGULAR = 1e-8  # ridge of the secants, of the largest
REACH = (
    10.0  # steps that an accelerated one may be long; old secants of tiny ones would go anywhere
)


class Secants:
    """The last `depth` differences of the iterates a of a <- a + r(a), and of their steps r.

    `step` takes the present ones and gives the step to where the secants say that r is least;
    `begin` starts another sequence of iterates, and `clear` forgets the secants too. (D. G.
    Anderson, J. ACM 12, 1965; Walker and Ni, SIAM J. Numer. Anal. 49, 2011.)
    """

    def __init__(self, size: int, depth: int) -> None:
        """size: of a and r; depth: of the pairs kept."""
        self.depth, self._count = depth, 0
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._dR, self._dX = np.zeros((2, depth, size), np.float32)
        self._gram = np.zeros((depth, depth))

    def begin(self) -> None:
        """The next iterate does not follow from the last."""
        self._last = None

    def clear(self) -> None:
        """Forget them all."""
        self._last, self._count = None, 0

    def step(self, a: np.ndarray, r: np.ndarray) -> np.ndarray:
        """The step (size,) from a in place of r; r itself, and the secants forgotten, where it
        would be REACH times as long."""
        if self._last is not None:
            self._remember(a - self._last[0], r - self._last[1])
        self._last = a, r
        kept = min(self._count, self.depth)
        if not kept:
            return r
        gram = self._gram[:kept, :kept].copy()
        diagonal = gram.ravel()[:: kept + 1]
        diagonal += REGULAR * diagonal.max() + 1e-30
        share = np.linalg.solve(gram, self._dR[:kept] @ r).astype(np.float32)
        step = r - share @ self._dX[:kept]
        if not step @ step <= REACH**2 * (r @ r):
            self._count = 0
            return r
        return step

    def _remember(self, da, dr):
        """Keep a secant pair, in place of the oldest."""
        slot = self._count % self.depth
        self._dR[slot] = dr
        np.add(da, dr, out=self._dX[slot])
        self._count += 1
        kept = min(self._count, self.depth)
        self._gram[slot, :kept] = self._gram[:kept, slot] = self._dR[:kept] @ dr

    def state(self) -> State:
        """{"secants", "gram", "count"}."""
        return {
            "secants": np.stack([self._dR, self._dX]),
            "gram": self._gram.copy(),
            "count": np.array(self._count),
        }

    def restore(self, state: State) -> None:
        """Go on from what `state` gave, with another sequence."""
        self.begin()
        self._dR[:], self._dX[:] = state["secants"]
        self._gram[:], self._count = state["gram"], int(state["count"])
