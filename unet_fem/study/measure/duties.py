"""The duties of whatever answers beside a user, the same for every competitor whose run time is
compared: what a deployed network does around its graph."""

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.stepper import State, Stepper
from fem.online.volume import VOLUME_BAND, QuadVolume
from unet_fem.runtime.surrogate import force_size


class Dutiful:
    """A Stepper on the node grid that also checks that the force is finite and within the training
    range, and sounds an alarm where the answer's volume leaves the paper's band, as
    unet_fem.runtime.Surrogate does."""

    def __init__(self, stepper: Stepper, dataset: Dataset) -> None:
        self.stepper, self.interval = stepper, stepper.interval
        self.largest = force_size(dataset.read("train", ("force",))["force"])
        self._volume = QuadVolume(*dataset.surface, dataset.free)
        self.rest_volume = self._volume(np.zeros((*dataset.grid, 3), "float32"))
        self.outside_training_range = self.volume_alarm = False

    def reset(self) -> None:
        """Back to rest."""
        self.stepper.reset()

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """The stepper's answer. Raises InputError for a force that is not finite."""
        total, nodal = _size(force.reshape(-1, 3))
        if not total + nodal < np.inf:
            raise InputError("the force is not finite; give it in mN")
        most_total, most_nodal = self.largest  # beyond them by more than rounding
        self.outside_training_range = total > 1.00001 * most_total or nodal > 1.00001 * most_nodal
        answer = self.stepper.step(force, dt)
        self.volume_alarm = abs(self._volume(answer) / self.rest_volume - 1) > VOLUME_BAND
        return answer

    def state(self) -> State:
        """Of the stepper."""
        return self.stepper.state()

    def restore(self, state: State) -> None:
        """Of the stepper."""
        self.stepper.restore(state)


def dutiful(stepper: Stepper, dataset: Dataset) -> Stepper:
    """`stepper` with these duties: itself where it has them already."""
    return stepper if hasattr(stepper, "volume_alarm") else Dutiful(stepper, dataset)


def _size(force):
    total, nodal = force.sum(axis=0), np.einsum("ni,ni->n", force, force).max()
    return float(total @ total) ** 0.5, float(nodal) ** 0.5
