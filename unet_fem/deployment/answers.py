"""The answers of a stepper to whole interactions."""

import os
import warnings
from pathlib import Path

import numpy as np

from fem.online.stepper import Stepper
from unet_fem.runtime.surrogate import Surrogate


def answers(stepper: Stepper | Path | str, force: np.ndarray) -> np.ndarray:
    """What `stepper`, or the surrogate at this path, says on force (I, F, ...) mN, frame by frame,
    each interaction from rest: (I*F, ...) mm. Its warnings are held back."""
    if isinstance(stepper, str | Path):
        stepper = Surrogate(stepper, threads=os.cpu_count() or 1)
    result = np.empty_like(force)
    with muted():
        for interaction, out in zip(force, result, strict=True):
            stepper.reset()
            for n, field in enumerate(interaction):
                out[n] = stepper.step(field)
    return result.reshape(-1, *force.shape[2:])


def muted() -> warnings.catch_warnings:
    """A context without the steppers' warnings: the hard interactions do leave the training
    range."""
    return warnings.catch_warnings(action="ignore", category=RuntimeWarning)
