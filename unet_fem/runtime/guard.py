"""What a frame's answer may be off by, and when nobody vouches for it."""

import numpy as np

from fem.online.creep import Creep, CreepFilter
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel

ALARM = 0.05  # a bound above this share of the displacement is flagged
STRETCH = 0.15  # of |ln(K / mu)|, added to a bound: 0.05 to 0.12 of it are seen


class Guard:
    """bound = weights . (1, missing, step, size), a share of |u| that the error of nine of ten
    frames like those of training does not exceed.

    missing: what the modes miss of the linear answer to the force and its past, as a share of it;
    step: the last one, as a share of |a|; size: the cube of the largest component of
    a node's displacement, in mm3. weights (4,): unet_fem.deployment.conformal fits them.

    stretched: |ln| of how K / mu differs from that of the data, whose modes are not that tissue's;
    0 for the data's own.

    After a call `features` (4,) and `bound` are the frame's, and `reason` says why the answer is
    flagged; it is empty where it is not.
    """

    def __init__(self, model: ReducedModel, weights: np.ndarray, stretched: float = 0.0) -> None:
        self.stretched = stretched
        self.missing = [block.missing for block in model.blocks]
        self.weights = np.asarray(weights, float)
        creep = Creep.of(tuple((float(g), float(tau)) for g, tau in model.prony))
        self.memory = CreepFilter(creep, (sum(len(W) for W in self.missing),))
        self.reset()

    def reset(self) -> None:
        """No force in the past."""
        self.memory.reset()
        self.astray = False
        self.bound, self.reason, self.features = 0.0, "", np.zeros(4)

    def __call__(
        self, fields: Fields, linear: np.ndarray, step: float, size: float, dt: float
    ) -> None:
        """Judge the frame that `fields` has encoded; linear (R,) mm: the linear answer to it."""
        parts = zip(self.missing, fields.folded, strict=True)
        lost = self.memory.step(np.concatenate([W @ f for W, f in parts]), dt)
        whole = float(linear @ linear)
        missing = (float(lost @ lost) / whole) ** 0.5 if whole else 0.0
        self.features = np.array([1.0, missing, step, size])
        parts_of_bound = self.weights * self.features
        self.bound = float(parts_of_bound.sum()) + STRETCH * self.stretched
        self.reason = ""
        if self.astray or not fields.carried:  # what comes after has a wrong past
            self.astray, self.bound = True, np.inf
            self.reason = "some of the force stands where no contact of the data pushes"
        elif not self.bound <= ALARM:
            parts_of_bound[0] = STRETCH * self.stretched
            self.reason = (
                "K / mu is far from the data's, whose modes are not those of this tissue",
                "the force is none that the data's contacts make",
                "the frame did not settle",
                "the tissue is moved farther than in the data",
            )[int(np.argmax(parts_of_bound))]
