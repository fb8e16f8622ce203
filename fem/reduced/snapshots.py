"""The snapshots of a dataset in modal coordinates, in one pass over its file.

A basis grows while the interactions go by: what an interaction has outside of it beyond TOLERANCE
is added by a singular value decomposition, and its coordinates are kept. At the end the proper
orthogonal modes are those of the coordinates (a small eigenvalue problem), and no field is read
twice. With a mirror the basis is one of even and one of odd fields, which is that of all snapshots
and of their images.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.files import replacing
from fem.reduced.symmetry import Sides

TOLERANCE = 2e-4  # relative L2, of what the growing basis leaves out
MOST = 1200  # vectors of the basis of a parity
Which = tuple[str, int]  # split and number of an interaction


class GrowingBasis:
    """Orthonormal vectors that span rows seen so far to within a tolerance of their mean energy.

    most: vectors at most. `energy` and `lost`: squares of all rows, and of what is left out.
    """

    def __init__(self, size: int, tolerance: float = TOLERANCE, most: int = MOST) -> None:
        self.Q = np.zeros((size, 0), np.float32)
        self.tolerance, self.most = tolerance, most
        self.energy = self.lost = 0.0
        self._count = 0

    def add(self, rows: np.ndarray) -> np.ndarray:
        """Coordinates (frames, k) of the rows (frames, size); the basis grows where it must."""
        rows = rows.astype(np.float32)
        y = rows @ self.Q
        rest = rows - y @ self.Q.T
        again = rest @ self.Q  # twice is enough
        y, rest = y + again, rest - again @ self.Q.T
        self.energy += float(np.vdot(rows, rows))
        self._count += 1
        allowed = self.tolerance**2 * self.energy / self._count
        outside = float(np.vdot(rest, rest))
        if outside > allowed and self.Q.shape[1] < self.most:
            _, s, V = np.linalg.svd(rest, full_matrices=False)
            left = np.cumsum((s**2)[::-1])[::-1]  # what stays outside if cut here
            n = min(int(np.sum(left > allowed)), self.most - self.Q.shape[1])
            new = V[:n].T - self.Q @ (self.Q.T @ V[:n].T)
            new = np.linalg.qr(new)[0]
            y = np.hstack([y, rest @ new])
            outside -= float(np.sum(s[:n] ** 2))
            self.Q = np.ascontiguousarray(np.hstack([self.Q, new]), np.float32)
        self.lost += max(outside, 0.0)
        return y


@dataclass(frozen=True, eq=False)
class Snapshots:
    """Interactions in coordinates of a basis, in the file at `path`.

    which: (split, number) of each; bases: (3 h, k) of each parity; interval: s between frames;
    left_out: what the basis does not hold of them, relative L2
    """

    path: Path
    which: list[Which]
    bases: list[np.ndarray]
    interval: float
    left_out: float

    def of(self, split: str, numbers: Iterable[int] | None = None) -> list[int]:
        """The places of a split's interactions."""
        wanted = None if numbers is None else set(numbers)
        return [
            i
            for i, (name, number) in enumerate(self.which)
            if name == split and (wanted is None or number in wanted)
        ]

    def force(self, i: int) -> list[np.ndarray]:
        """(frames, 3 h_force) mN at the loadable nodes in interaction i, of each parity."""
        return self._rows("force", i)

    def coordinates(self, i: int) -> list[np.ndarray]:
        """(frames, k) mm in the bases in interaction i, of each parity."""
        return self._rows("coordinates", i)

    def _rows(self, name, i):
        with h5py.File(self.path) as file:
            rows = [file[f"{name}{parity}"][i] for parity in range(len(self.bases))]
        if name == "coordinates":
            rows = [y[:, : Q.shape[1]] for y, Q in zip(rows, self.bases, strict=True)]
        return rows

    def decomposition(self, members: Iterable[int]) -> "Decomposition":
        """The proper orthogonal modes of the interactions `members`."""
        grams = [np.zeros((Q.shape[1],) * 2) for Q in self.bases]
        for i in members:
            for gram, y in zip(grams, self.coordinates(i), strict=True):
                gram += y.T.astype(float) @ y
        energies, vectors = zip(*(np.linalg.eigh(gram) for gram in grams), strict=True)
        return Decomposition([w[::-1] for w in energies], [V[:, ::-1] for V in vectors])

    def in_modes(self, modes: list[np.ndarray], i: int) -> np.ndarray:
        """(frames, R) coordinates of interaction i in `modes`, the even ones first."""
        parts = zip(self.coordinates(i), modes, strict=True)
        return np.hstack([y @ phi for y, phi in parts])


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Proper orthogonal modes, those of each parity by falling energy: energies (k,) mm2 and
    vectors (k, k) in the snapshots' bases."""

    energies: list[np.ndarray]
    vectors: list[np.ndarray]

    @property
    def _order(self):
        return np.sort(np.concatenate(self.energies))[::-1]

    def modes(self, count: int) -> list[np.ndarray]:
        """The first `count` modes of all, (k, R_b) of each parity."""
        order = self._order
        least = order[min(count, len(order)) - 1]
        both = zip(self.energies, self.vectors, strict=True)
        return [V[:, : int(np.sum(w >= least))] for w, V in both]

    def left_out(self, count: int) -> float:
        """What the first `count` modes leave out of the snapshots, relative L2."""
        order = self._order
        return float(np.sqrt(max(order[count:].sum(), 0.0) / order.sum()))

    def count(self, left_out: float) -> int:
        """How many modes it takes to leave out no more than that."""
        order = np.maximum(self._order, 0.0)
        rest = order.sum() - np.cumsum(order)
        return 1 + int(np.sum(rest > left_out**2 * order.sum()))


def read_snapshots(
    dataset: Dataset,
    which: list[Which],
    free: Sides,
    loadable: Sides,
    path: str | Path,
    tolerance: float = TOLERANCE,
    progress: Callable[[Iterable[Which]], Iterable[Which]] = iter,
) -> Snapshots:
    """Read the interactions `which` of a dataset once and keep them in coordinates at `path`."""
    size, frames = 3 * len(free.left), len(dataset.time)
    most = min(size, MOST)
    bases = [GrowingBasis(size, tolerance, most) for _ in range(free.parities)]
    with replacing(path) as partial, h5py.File(partial, "w") as file:

        def column(name, width):
            packed = {"chunks": (1, frames, width), "compression": "gzip", "compression_opts": 1}
            return file.create_dataset(name, (len(which), frames, width), "f4", **packed)

        columns = [
            (column(f"coordinates{b}", most), column(f"force{b}", 3 * len(loadable.left)))
            for b in range(free.parities)
        ]
        for i, (split, number) in enumerate(progress(which)):
            one = dataset.sequence(split, number)
            if not (np.isfinite(one.displacement).all() and np.isfinite(one.force).all()):
                raise InputError(
                    f"{dataset.path} holds values that are not finite in {split} {number}; delete"
                    " it and generate it again"
                )
            fields = zip(free.fold(one.displacement), loadable.fold_force(one.force), strict=True)
            for basis, (place, forces), (u, f) in zip(bases, columns, fields, strict=True):
                y = basis.add(u)
                place[i, :, : y.shape[1]] = y
                forces[i] = f
        for b, basis in enumerate(bases):
            file[f"basis{b}"] = basis.Q
        lost, energy = sum(basis.lost for basis in bases), sum(basis.energy for basis in bases)
        file.attrs["left_out"] = float(np.sqrt(lost / energy)) if energy else 0.0
        file.attrs["interval"] = float(dataset.time[1] - dataset.time[0])
        file.attrs["which"] = json.dumps(which)
    return open_snapshots(path)


def open_snapshots(path: str | Path) -> Snapshots:
    """The Snapshots in the file at `path`."""
    with h5py.File(path) as file:
        bases = [file[name][()] for name in ("basis0", "basis1") if name in file]
        which = [(split, number) for split, number in json.loads(file.attrs["which"])]
        interval, left_out = float(file.attrs["interval"]), float(file.attrs["left_out"])
    return Snapshots(Path(path), which, bases, interval, left_out)
