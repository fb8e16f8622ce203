"""What a frame's answer may be off by, and when nobody vouches for it."""

import numpy as np

from fem.online.creep import Creep, CreepFilter
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.online.stepper import State

ALARM = 0.05  # a bound above this share of the displacement is flagged
UNREST = 0.1  # above it a frame is flagged: the step was long, and what follows it is unknown
STRETCH = 0.15, 0.3  # and the latter times `size`: of |ln(K / mu)|, added to a bound; half is seen
REASONS = (  # of the parts of a bound
    "K / mu is far from the data's, whose modes are not those of this tissue",
    "the force is none that the data's contacts make",
    "the frame did not settle",
    "the tissue is moved farther than in the data",
)


class Guard:
    """bound = weights . (1, missing, unrest, size), a share of |u| that the error of nine of ten
    frames like those of training does not exceed.

    missing: what the modes miss of the linear answer to the force and its past, as a share of it;
    unrest: how far the frame is from rest, as a share of |a|; size: s^2 of the largest component s
    in mm of a node's displacement, and what is left of earlier frames' s^2 |a|, which creeps as
    forces do, as a share of |a|. fitted (5,): the weights, and the size beyond which a frame is
    flagged whatever they say; see unet_fem.deployment.conformal.

    stretched: |ln| of how K / mu differs from that of the data, whose modes are not that tissue's;
    0 for the data's own.

    `begin` a frame and `judge` it after each evaluation. Then `features` (4,) and `bound` are the
    frame's, and `reason` says why the answer is flagged; it is empty where it is not.
    """

    def __init__(self, model: ReducedModel, fitted: np.ndarray, stretched: float = 0.0) -> None:
        self.stretched = stretched
        self.missing = [block.missing for block in model.blocks]
        self.weights, self.far = np.asarray(fitted[:4], float), float(fitted[4])
        creep = Creep.of(tuple((float(g), float(tau)) for g, tau in model.prony))
        self._missed = np.zeros(sum(len(W) for W in self.missing) + 1)  # and s^2 |a| of the last
        self.memory = CreepFilter(creep, self._missed.shape)
        self.reset()

    def reset(self) -> None:
        """No force in the past."""
        self.memory.reset()
        self.astray = False
        self._missed[:] = 0
        self.bound, self.reason, self.features = 0.0, "", np.zeros(4)

    def begin(self, fields: Fields, dt: float) -> None:
        """A frame of dt s, whose force `fields` has encoded."""
        np.concatenate(
            [W @ f for W, f in zip(self.missing, fields.folded, strict=True)], out=self._missed[:-1]
        )
        now = self.memory.step(self._missed, dt)
        self._lost = float(now[:-1] @ now[:-1])
        self._past = float(now[-1] - self._missed[-1])  # it is remembered a frame late
        self.astray = self.astray or not fields.carried  # what comes after has a wrong past

    def judge(self, linear: np.ndarray, a: np.ndarray, unrest: float, largest: float) -> None:
        """The bound of an answer a (R,) mm; linear (R,) mm: the linear answer to the force;
        largest: component in mm of a node's displacement."""
        whole, square = float(linear @ linear), float(a @ a)
        missing = (self._lost / whole) ** 0.5 if whole else 0.0
        size = largest**2
        self._missed[-1] = size * square**0.5
        if square:
            size += self._past / square**0.5
        self.features = np.array([1.0, missing, unrest, size])
        parts = self.weights * self.features
        stretch = (STRETCH[0] + STRETCH[1] * size) * self.stretched
        parts[0] += stretch
        self.bound, self.reason = float(parts.sum()), ""
        if size > self.far:
            self.flag(3)
        if unrest > UNREST:
            self.flag(2)
        if self.astray:
            self.bound = np.inf
            self.reason = "some of the force stands where no contact of the data pushes"
        elif not self.bound <= ALARM:
            parts[0] = stretch
            self.reason = REASONS[int(np.argmax(parts))]

    def flag(self, part: int) -> None:
        """Do not vouch for the frame, for the reason of one of the features."""
        self.bound = max(self.bound, ALARM)
        self.reason = self.reason or REASONS[part]

    def state(self) -> State:
        """All that the next bound depends on besides the next answer."""
        own = {"astray": np.array(self.astray), "largest": self._missed[-1:].copy()}
        return {f"guard_{name}": values for name, values in (self.memory.state() | own).items()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave."""
        kept = {k.removeprefix("guard_"): v for k, v in state.items() if k.startswith("guard_")}
        self.astray, self._missed[-1:] = bool(kept["astray"]), kept["largest"]
        self.memory.restore(kept)
