"""What a network sees in place of the force of each frame: the force as creeping tissue remembers
it, or the linear elastic answer to either."""

from pathlib import Path

import numpy as np

from fem.errors import InputError
from fem.files import load_arrays, save_arrays
from fem.online.creep import Creep, CreepFilter
from fem.online.regression import Regression
from fem.online.stepper import State

FORMAT = "unet-fem input 1"
FILE = "input.npz"  # beside the network that sees it


class InputField:
    """f~, K^-1 f or K^-1 f~ on the node grid, made call by call from the force f.

    creep: of f~; without terms f itself is taken, and no state is kept. elastic: K^-1, see
    fem.solver.elastic, or None. corrects: whether a network on it learns the correction to it,
    which is where there is K^-1.
    """

    def __init__(
        self, grid: tuple[int, ...], creep: Creep, elastic: Regression | None = None
    ) -> None:
        self.creep, self.elastic, self.corrects = creep, elastic, elastic is not None
        self._filter = CreepFilter(creep, (*grid, 3)) if creep.terms else None

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        if self._filter:
            self._filter.reset()

    def step(self, force: np.ndarray, dt: float) -> np.ndarray:
        """(nx, ny, nz, 3) float32, mN or mm, of the force (nx, ny, nz, 3) mN that has come dt
        seconds after the last one.

        Raises InputError as CreepFilter.step and Regression.check_loads do; the state is then as it
        was.
        """
        if self.elastic:
            self.elastic.check_loads(force[None])
        if self._filter:
            force = self._filter.step(force, dt)
        force = force.astype("float32")
        return self.elastic.predict(force[None])[0] if self.elastic else force

    def sequences(self, force: np.ndarray, interval: float) -> np.ndarray:
        """What `step` gives on interactions (I, F, nx, ny, nz, 3) mN, each from rest, their frames
        `interval` s apart. The state is afterwards that of the last one."""
        result = np.empty(force.shape, "float32")
        for frames, seen in zip(force, result, strict=True):
            self.reset()
            for n, frame in enumerate(frames):
                seen[n] = self._filter.step(frame, interval) if self._filter else frame
            if self.elastic:
                self.elastic.check_loads(frames)
                seen[:] = self.elastic.predict(seen)
        return result

    def state(self) -> State:
        """That of the memory; empty without one."""
        return self._filter.state() if self._filter else {}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another."""
        if self._filter:
            self._filter.restore(state)

    def arrays(self) -> dict[str, np.ndarray]:
        """What a file holds of it: creep (K, 2), and with K^-1 its active (p,) and kernel (p, q);
        the mask of free nodes is not among them."""
        found = {"creep": self.creep.array}
        if self.elastic:
            found |= {"active": self.elastic.active, "kernel": self.elastic.kernel}
        return found

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray], mask: np.ndarray) -> "InputField":
        """That of `arrays` on a grid with free nodes at `mask` (nx, ny, nz). Raises InputError for
        arrays that do not fit each other."""
        elastic = None
        if "kernel" in arrays:
            elastic = Regression(mask, arrays["active"], arrays["kernel"], elastic=True)
        return cls(mask.shape, Creep.from_array(arrays["creep"]), elastic)

    def save(self, path: Path | str, mask: np.ndarray) -> None:
        """Write it to `path` (.npz), at once or not at all; mask: (nx, ny, nz), the free nodes."""
        save_arrays(path, format=FORMAT, mask=mask, **self.arrays())

    @classmethod
    def load(cls, path: Path | str) -> "InputField":
        """That at `path`. Raises InputError for a file that is damaged or another's."""
        arrays = load_arrays(path)
        if str(arrays.get("format")) != FORMAT or not {"mask", "creep"} <= arrays.keys():
            raise InputError(
                f"{path} is not a whole '{FORMAT}' file; delete it and judge its run again with"
                f" python -m unet_fem.evaluate {Path(path).parent}"
            )
        return cls.of(arrays, arrays["mask"])

    @classmethod
    def beside(cls, path: Path | str) -> "InputField | None":
        """That of the network in the file at `path`, which lies beside it; None if none does."""
        found = Path(path).with_name(FILE)
        return cls.load(found) if found.is_file() else None
