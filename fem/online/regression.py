"""Regression from a window of forces to the displacement, in full or through a few modes.

    linear      u = W f
    POD         u = sum_k (W f)_k phi_k
    quadratic   u = sum_k (W f + Q f^2)_k phi_k

with phi_k the modes of the training displacements (proper orthogonal decomposition). There is no
intercept: no force moves nothing. unet_fem.networks.pod fits the weights.
"""

import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from fem.errors import InputError
from fem.files import save_arrays
from fem.online.grid import NodeGrid
from fem.online.window import WindowStepper

FORMAT = "unet-fem regression 1"
REMEDY = "make one with python -m unet_fem.train model.kind=linear name=linear"


@dataclass(frozen=True, eq=False)
class Regression:
    """A fitted regression, which is called like a network.

    mask: (nx, ny, nz) bool, the free nodes. active: (p,) components of the flattened window that
    are used. kernel: W, (p, q) or (p, r) mm/mN. modes: phi, (r, q) or None. squares: Q, (p, r)
    mm/mN^2, or None without quadratic terms. q is three times the free nodes.
    steps: frames of the window, None without a time axis. interval: s between frames, if known.
    index: (N,) places of a mesh's nodes on the grid; None for all nodes of the grid.
    Raises InputError for arrays that do not fit each other.
    """

    mask: np.ndarray
    active: np.ndarray
    kernel: np.ndarray
    modes: np.ndarray | None = None
    squares: np.ndarray | None = None
    steps: int | None = None
    interval: float | None = None
    index: np.ndarray | None = None

    def __post_init__(self) -> None:
        inputs, outputs = len(self.active), 3 * int(self.mask.sum())
        modes = outputs if self.modes is None else len(self.modes)
        expected = {
            "kernel": (inputs, modes),
            "modes": (modes, outputs),
            "squares": (inputs, modes),
        }
        for name, shape in expected.items():
            found = getattr(self, name)
            if found is not None and found.shape != shape:
                raise InputError(
                    f"{name} has shape {found.shape} and {inputs} forces on {outputs // 3} free"
                    f" nodes need {shape}; fit the regression again"
                )
        size = (self.steps or 1) * 3 * self.mask.size
        if inputs and not 0 <= self.active.min() <= self.active.max() < size:
            raise InputError(
                f"active names component {self.active.max()} of a window with {size};"
                " fit the regression again"
            )

    @property
    def input_shape(self) -> tuple[int | None, ...]:
        """(None, [T,] nx, ny, nz, 3), as Keras gives it."""
        window = () if self.steps is None else (self.steps,)
        return (None, *window, *self.mask.shape, 3)

    @property
    def grid(self) -> NodeGrid:
        """Of the nodes that forces and displacements may be given at."""
        index = np.arange(self.mask.size) if self.index is None else self.index
        return NodeGrid(self.mask.shape, index)

    @property
    def family(self) -> str:
        """What it is called."""
        if self.modes is None:
            return "linear"
        return "POD" if self.squares is None else "POD + quadratic"

    @property
    def parameters(self) -> int:
        """Numbers that it holds."""
        return sum(a.size for a in (self.kernel, self.modes, self.squares) if a is not None)

    def predict(self, force: np.ndarray) -> np.ndarray:
        """Displacement (S, nx, ny, nz, 3) float32 mm from force windows (S, [T,] nx, ny, nz, 3)
        mN."""
        f = force.reshape(len(force), -1)[:, self.active]
        u = f @ self.kernel
        if self.squares is not None:
            u += f**2 @ self.squares
        if self.modes is not None:
            u = u @ self.modes
        result = np.zeros((len(force), *self.mask.shape, 3), "float32")
        result[:, self.mask] = u.reshape(len(force), -1, 3)
        return result

    __call__ = predict

    def save(self, path: Path | str) -> None:
        """Write it to `path` (.npz), at once or not at all."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        known = {name: value for name, value in arrays.items() if value is not None}
        save_arrays(path, format=FORMAT, **known)

    @classmethod
    def load(cls, path: Path | str) -> "Regression":
        """The regression at `path`. Raises InputError for a file that is missing, damaged or
        another's."""
        if not Path(path).is_file():
            raise InputError(f"no regression {path}; {REMEDY}")
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
        except (zipfile.BadZipFile, ValueError, EOFError, OSError, TypeError):
            arrays = {}
        if str(arrays.pop("format", None)) != FORMAT:
            raise InputError(f"{path} is not a whole '{FORMAT}' file; {REMEDY}")
        for name, kind in (("steps", int), ("interval", float)):
            if name in arrays:
                arrays[name] = kind(arrays[name])
        try:
            return cls(**arrays)
        except TypeError as error:
            raise InputError(f"{path} is damaged ({error}); {REMEDY}") from None


class RegressionStepper(WindowStepper):
    """A Regression as a Stepper."""

    def __init__(self, regression: Regression) -> None:
        super().__init__(regression, regression.grid, regression.steps, regression.interval)

    @classmethod
    def open(cls, path: Path | str) -> "RegressionStepper":
        """That of the file at `path`. Raises InputError for another file."""
        return cls(Regression.load(path))
