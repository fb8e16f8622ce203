"""From the interactions of a dataset to the samples that a network learns from."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError


def windows(force: np.ndarray, steps: int | None) -> np.ndarray:
    """Force windows that end at each frame, in order of interaction and frame; before the first
    frame there is no force.

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
    volume: (S,) mm3 of the FEM's deformed mesh.
    """

    force: np.ndarray
    displacement: np.ndarray
    interaction: np.ndarray
    hard: np.ndarray
    volume: np.ndarray

    def __len__(self) -> int:
        return len(self.displacement)

    @property
    def last_force(self) -> np.ndarray:
        """(S, nx, ny, nz, 3) mN of the window's last frame."""
        return self.force if self.force.ndim == 5 else self.force[:, -1]

    def select(self, rows: np.ndarray | slice) -> "Samples":
        """Those of some rows."""
        return Samples(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def load_samples(dataset: Dataset, split: str, steps: int | None) -> Samples:
    """Samples of `split` (of fem.data.scene.SPLITS) of a fem.data.dataset.Dataset, with
    windows of `steps` frames."""
    fields = dataset.read(split)
    frames = fields["force"].shape[1]
    return Samples(
        force=windows(fields["force"], steps),
        displacement=fields["displacement"].reshape(-1, *fields["displacement"].shape[2:]),
        interaction=np.repeat(fields["number"], frames),
        hard=np.repeat(fields["hard"], frames),
        volume=fields["volume"].ravel(),
    )


def training_samples(dataset: Dataset, steps: int | None) -> tuple[Samples, Samples]:
    """(training, validation) samples, see `load_samples`."""
    return load_samples(dataset, "train", steps), load_samples(dataset, "validation", steps)


def scales(samples: Samples) -> tuple[float, float]:
    """(force_scale mN, displacement_scale mm): root mean square over the nonzero entries of the
    training data."""
    result = []
    for name, values in (("force", samples.last_force), ("displacement", samples.displacement)):
        values = values[values != 0]
        if not values.size:
            raise InputError(
                f"every {name} of the training data is zero; raise contact.force in the scene"
            )
        result.append(float(np.sqrt(np.mean(np.square(values, dtype=float)))))
    force, displacement = result
    return force, displacement


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
