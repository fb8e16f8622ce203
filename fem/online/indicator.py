"""How far a displacement may be from the truth, whoever gave it: the reduced equilibrium's residual
there."""

import numpy as np

from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.online.residual import Residual
from fem.online.stepper import check_interval


class ErrorIndicator:
    """An estimate of the error of displacements that answer forces call by call.

        e = sqrt(|r(a)|^2 + |u - Phi a|^2),   a = Phi^T u

    r is the residual of fem.online.reduced: in first approximation what a is short of equilibrium,
    in mm. The stress history is that of the displacements corrected by it, a + r. `carried` tells
    whether all of the last force stood at nodes that contacts push on, `outside` is |u - Phi a| /
    |u|: what the modes cannot say anything about.
    """

    def __init__(self, model: ReducedModel) -> None:
        self.model = model
        self.fields, self.residual = Fields(model), Residual(model)
        self._interval: float | None = None
        self.reset()

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self.residual.reset()
        self.carried, self.outside = True, 0.0

    def __call__(self, force: np.ndarray, displacement: np.ndarray, dt: float) -> float:
        """e in mm, an L2 norm over the free nodes, of a displacement in mm under a force in mN, dt
        seconds after the call before; both (N, 3) or (nx, ny, nz, 3).

        Raises InputError for other shapes, values that are not finite and intervals that are no
        positive number.
        """
        if dt != self._interval:
            check_interval(None, dt)
            self.residual.set_interval(dt)
            self._interval = dt
        _, g = self.fields.encode(np.asarray(force))
        a, square = self.fields.coordinates(np.asarray(displacement))
        self.residual.begin(g)
        with np.errstate(all="ignore"):
            r = self.residual(a)
            inside, left = float(r @ r), float(a @ a)
        outside = max(square - left, 0.0)
        self.carried = self.fields.carried
        self.outside = float(np.sqrt(outside / square)) if square else 0.0
        if not inside < np.inf:  # a crushed point: no history follows from it
            return float("inf")
        self.residual.accept(a + r)
        return float(np.sqrt(inside + outside))
