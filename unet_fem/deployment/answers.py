"""The answers of a surrogate to whole interactions."""

import os
import warnings

import numpy as np


def answers(path, force):
    """What the surrogate at `path` says on force (I, F, nx, ny, nz, 3) mN, frame by frame, each
    interaction from rest: (I*F, ...) mm."""
    from unet_fem.runtime.surrogate import Surrogate

    surrogate = Surrogate(path, threads=os.cpu_count())
    result = np.empty_like(force)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RuntimeWarning
        )  # the hard interactions do leave the training range
        for interaction, out in zip(force, result):
            surrogate.reset()
            for field, displacement in zip(interaction, out):
                surrogate.step(field, out=displacement)
    return result.reshape(-1, *force.shape[2:])
