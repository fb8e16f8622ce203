"""Which frames a network learns from: readings of "1512 samples" that the paper does not tell
apart.

A. All frames of the interactions of each split, as the dataset has them: leak-free.
B. split = "frames": the frames of both splits, dealt out at random. The inputs of a window are the
   true frames before its last; only targets are dealt out. Most frames to validate by then have a
   neighbour among those to learn from, see `leaking`.
C. each = k: k frames at random of each interaction, from as many more interactions.
"""

import numpy as np

from unet_fem.training.samples import Samples, joined
from unet_fem.training.settings import SampleChoice


def read_as(
    train: Samples, validation: Samples, frames: int, choice: SampleChoice
) -> tuple[Samples, Samples]:
    """(training, validation) samples as `choice` reads those of both splits, whole interactions of
    `frames` frames each; the two as they are for the default."""
    if (choice.split, choice.each) == ("interactions", 0):
        return train, validation
    whole = joined(train, validation)
    learn, validate = rows_of((len(train), len(validation)), frames, choice)
    return whole.select(learn), whole.select(validate)


def rows_of(
    sizes: tuple[int, int], frames: int, choice: SampleChoice
) -> tuple[np.ndarray, np.ndarray]:
    """(rows to learn from, rows to validate by), each in order, of the samples of both splits one
    behind the other, `sizes` of them."""
    rng = np.random.default_rng(choice.seed)
    parts = [np.arange(sizes[0]), sizes[0] + np.arange(sizes[1])]
    if choice.each:
        parts = [_some(rows.reshape(-1, frames), choice.each, rng) for rows in parts]
    if choice.split == "frames":
        dealt = rng.permutation(np.concatenate(parts))
        parts = [np.sort(dealt[: len(parts[0])]), np.sort(dealt[len(parts[0]) :])]
    return parts[0], parts[1]


def leaking(train: np.ndarray, validation: np.ndarray, frames: int) -> float:
    """Share of the rows to validate by whose interaction has the frame before or after among the
    rows to learn from, see `rows_of`."""
    known = set(train.tolist())
    beside = [
        any(row + step in known and (row + step) // frames == row // frames for step in (-1, 1))
        for row in validation.tolist()
    ]
    return float(np.mean(beside))


def _some(rows, each, rng):
    """`each` of every line of rows (I, frames), in order."""
    count = min(each, rows.shape[1])
    return np.concatenate([np.sort(rng.choice(line, count, replace=False)) for line in rows])
