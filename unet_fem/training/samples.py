"""From the interactions of a dataset to the samples that a network learns from."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.input_field import InputField


def windows(force: np.ndarray, steps: int | None) -> np.ndarray:
    """Windows of forces, or of what is seen in their place, that end at each frame, in order of
    interaction and frame; before the first frame there is none.

    force: (I, F, nx, ny, nz, 3). Returns (I*F, steps, nx, ny, nz, 3), or (I*F, nx, ny, nz, 3) for
    steps None.
    """
    frames, grid = force.shape[1], force.shape[2:]
    if steps is None:
        return force.reshape(-1, *grid)
    rest = np.zeros((len(force), steps - 1, *grid), force.dtype)
    padded = np.concatenate([rest, force], axis=1)  # (I, steps-1+F, ...)
    return np.stack([padded[:, t : t + frames] for t in range(steps)], axis=2).reshape(
        -1, steps, *grid
    )


@dataclass(frozen=True)
class Samples:
    """The samples of one split.

    force: windows, mN, see `windows`; displacement: (S, nx, ny, nz, 3) mm of the window's last
    frame; interaction: (S,) the number of the interaction that each comes from; hard: (S,) bool;
    volume: (S,) mm3 of the FEM's deformed mesh; seen: windows of what the model sees in place of
    the forces, if it does; `force` is then that of the last frame alone.
    """

    force: np.ndarray
    displacement: np.ndarray
    interaction: np.ndarray
    hard: np.ndarray
    volume: np.ndarray
    seen: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.displacement)

    @property
    def last_force(self) -> np.ndarray:
        """(S, nx, ny, nz, 3) mN of the window's last frame."""
        return _last(self.force)

    @property
    def input(self) -> np.ndarray:
        """The windows that a model takes."""
        return self.force if self.seen is None else self.seen

    @property
    def last_input(self) -> np.ndarray:
        """(S, nx, ny, nz, 3) of the input window's last frame."""
        return _last(self.input)

    def select(self, rows: np.ndarray | slice) -> "Samples":
        """Those of some rows."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return Samples(**{name: a[rows] for name, a in own.items() if a is not None})


def _last(windows):
    return windows if windows.ndim == 5 else windows[:, -1]


def load_samples(
    dataset: Dataset,
    split: str,
    steps: int | None,
    field: InputField | None = None,
    numbers: Iterable[int] | None = None,
) -> Samples:
    """Samples of `split` (of fem.data.scene.SPLITS) of a fem.data.dataset.Dataset, with
    windows of `steps` frames of the `field` that the model sees, of the forces if None; numbers: of
    the interactions, all if None."""
    found = dataset.read(split, numbers=numbers)
    force, frames, seen = found["force"], found["force"].shape[1], None
    if field:
        seen = windows(field.sequences(force, dataset.scene.frames.interval), steps)
    return Samples(
        force=windows(force, None if field else steps),
        seen=seen,
        displacement=found["displacement"].reshape(-1, *found["displacement"].shape[2:]),
        interaction=np.repeat(found["number"], frames),
        hard=np.repeat(found["hard"], frames),
        volume=found["volume"].ravel(),
    )


def training_samples(
    dataset: Dataset, steps: int | None, field: InputField | None = None, hard: int = 0
) -> tuple[Samples, Samples]:
    """(training, validation) samples, see `load_samples`; hard: how many interactions of the split
    "hard" are among the first."""
    train = load_samples(dataset, "train", steps, field)
    if hard:
        train = joined(train, load_samples(dataset, "hard", steps, field, range(1, hard + 1)))
    return train, load_samples(dataset, "validation", steps, field)


def joined(first: Samples, second: Samples) -> Samples:
    """The samples of both, one behind the other."""
    names = [own.name for own in fields(Samples) if getattr(first, own.name) is not None]
    pairs = {name: (getattr(first, name), getattr(second, name)) for name in names}
    return Samples(**{name: np.concatenate(pair) for name, pair in pairs.items()})


def scales(samples: Samples, corrects: bool = False) -> tuple[float, float]:
    """(scale of the input, mN or mm, displacement_scale mm): root mean square over the nonzero
    entries of the training data. corrects: the displacement's is that of its difference from the
    input."""
    result: list[float] = []
    displacement = samples.displacement
    if corrects:
        displacement = displacement - samples.last_input
    for name, field in (("force", samples.last_input), ("displacement", displacement)):
        values = field[field != 0]
        if not values.size:
            raise InputError(
                f"every {name} of the training data is zero; raise contact.force in the scene"
            )
        result.append(float(np.sqrt(np.mean(np.square(values, dtype=float)))))
    return result[0], result[1]


def batches(
    force: np.ndarray, targets: np.ndarray, batch_size: int, seed: int, first_epoch: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Endless shuffled batches, epoch after epoch from `first_epoch`, as (force, targets) slices.

    The order depends on the seed and the epoch alone, so a resumed run sees what an uninterrupted
    one would.
    targets: (S, nx, ny, nz, 3 or 6), see unet_fem.training.losses.volume_loss.
    """
    for epoch in itertools.count(first_epoch):
        order = np.random.default_rng([seed, epoch]).permutation(len(force))
        for start in range(0, len(order), batch_size):
            rows = order[start : start + batch_size]
            yield force[rows], targets[rows]
