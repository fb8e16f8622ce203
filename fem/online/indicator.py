"""How far a displacement may be from the truth, whoever gave it."""

import math

import numpy as np

from fem.online.creep import Creep, CreepFilter
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.online.residual import Residual
from fem.online.stepper import as_field, check_interval

CARRIED = 0.02  # share of the linear answer that the modes may miss


class ErrorIndicator:
    """An estimate of the error of displacements that answer forces call by call.

        e^2 = |r(a)|^2 + |u - Phi a|^2 + |W f~|^2,   a = Phi^T u

    r is the residual of fem.online.reduced, in first approximation what a is short of equilibrium;
    the second term is what of u the modes cannot judge, and the third what the modes miss of the
    linear answer to the creep-convolved force: nothing that an answer in the modes can make good.
    The stress history is that of the displacements corrected by the residual, a + r.

    After a call `missing` is |W f~| over the linear answer, inf where some of the force stood at
    nodes that contacts do not push on: of it nothing is known, and e is inf too; `carried` is
    whether it is below 2 %.
    """

    def __init__(self, model: ReducedModel) -> None:
        self.model = model
        self.fields, self.residual = Fields(model), Residual(model)
        ends = np.cumsum([0] + [len(block.missing) for block in model.blocks])
        self._parts = [slice(i, j) for i, j in zip(ends[:-1], ends[1:], strict=True)]
        self._size = int(ends[-1])
        creep = Creep.of(tuple((float(g), float(tau)) for g, tau in model.prony))
        self._linear = np.zeros(self._size + model.modes)  # W f, and the elastic answer g
        self._memory = CreepFilter(creep, self._linear.shape)
        self._elapsed = math.nan  # s, the dt that the residual's filters are for
        self.reset()

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self.residual.reset()
        self._memory.reset()
        self.missing = 0.0

    @property
    def carried(self) -> bool:
        """Whether the modes can answer the last force."""
        return self.missing <= CARRIED

    def __call__(self, force: np.ndarray, displacement: np.ndarray, dt: float) -> float:
        """e in mm, an L2 norm over the free nodes, of a displacement in mm under a force in mN, dt
        seconds after the call before; both (N, 3) or (nx, ny, nz, 3).

        Raises InputError for other shapes, values that are not finite and intervals that are no
        positive number.
        """
        if dt != self._elapsed:
            check_interval(None, dt)
            self.residual.set_interval(dt)
            self._elapsed = dt
        a, square = self.fields.coordinates(np.asarray(displacement))
        _, g = self.fields.encode(as_field(force))
        lost = self._lost(g, dt)
        self.residual.begin(g)
        with np.errstate(all="ignore"):
            r = self.residual(a)
            inside = float(r @ r)
        if not inside < np.inf:  # a crushed point: no history follows from it
            return np.inf
        self.residual.accept(a + r)
        return float(np.sqrt(inside + max(square - float(a @ a), 0.0) + lost))

    def _lost(self, g, dt):
        """|W f~|^2 in mm2, and `missing` with it."""
        linear, size = self._linear, self._size
        linear[size:] = g
        for block, part, f in zip(self.model.blocks, self._parts, self.fields.folded, strict=True):
            linear[part] = block.missing @ f
        now = self._memory.step(linear, dt)
        lost, whole = float(now[:size] @ now[:size]), float(now[size:] @ now[size:])
        if not self.fields.carried:
            lost = np.inf
        self.missing = np.sqrt(lost / whole) if whole else np.sqrt(lost)
        return lost
