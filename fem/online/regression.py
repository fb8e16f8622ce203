"""Regression from a window of forces to the displacement, in full or through a few modes.

    linear      u = W f
    POD         u = sum_k (W f)_k phi_k
    quadratic   u = sum_k (W f + Q f^2)_k phi_k

with phi_k the modes of the training displacements (proper orthogonal decomposition). There is no
intercept: no force moves nothing. unet_fem.networks.pod fits the weights; fem.solver.elastic takes
those of the linear elastic answer from the stiffness at rest.

f is the force of the window's frames, or, with the terms of a creep function, the force as creeping
tissue remembers it (fem.online.creep): a stepper of such a regression keeps that memory.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fem.errors import InputError
from fem.files import load_arrays, save_arrays
from fem.online.creep import Creep, CreepFilter
from fem.online.grid import NodeGrid
from fem.online.stepper import as_field
from fem.online.window import WindowStepper
from fem.ranges import checked

FORMAT = "unet-fem regression 2"
FORMAT_1 = "unet-fem regression 1"  # without creep and elastic, and still written where it has none
REMEDY = "make one with python -m unet_fem.train model.kind=linear name=linear"


@dataclass(frozen=True, eq=False)
class Regression:
    """A fitted regression, which is called like a network.

    mask: (nx, ny, nz) bool, the free nodes. active: (p,) components of the flattened window that
    are used. kernel: W, (p, q) or (p, r) mm/mN. modes: phi, (r, q) or None. squares: Q, (p, r)
    mm/mN^2, or None without quadratic terms. q is three times the free nodes.
    steps: frames of the window, None without a time axis. interval: s between frames, if known.
    index: (N,) places of a mesh's nodes on the grid; None for all nodes of the grid.
    creep: (K, 2) weights and times in s of a fem.online.creep.Creep, if the window is of remembered
    forces. elastic: the weights are those of the stiffness, and other forces than those on `active`
    and on fixed nodes are refused.
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
    creep: np.ndarray | None = None
    elastic: bool = False

    def __post_init__(self) -> None:
        for name, kinds, axes in (("mask", "b", 3), ("active", "iu", 1), ("kernel", "f", 2)):
            array = np.asarray(getattr(self, name))
            if array.dtype.kind not in kinds or array.ndim != axes:
                raise InputError(
                    f"{name} is {array.dtype} of shape {array.shape}; fit the regression again"
                )
        for name in ("kernel", "modes", "squares"):
            array = getattr(self, name)
            if array is not None and not np.isfinite(array).all():
                raise InputError(f"{name} has values that are not finite; fit it again")
        if self.steps is not None:
            checked("steps", self.steps, 1, 1000, whole=True)
        if self.interval is not None:
            checked("interval", self.interval, 1e-9, 1e9, "s")
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
        if self.creep is not None and (self.creep.shape[1:] != (2,) or not (self.creep > 0).all()):
            raise InputError(
                f"creep is of shape {self.creep.shape} and holds {self.creep.min(initial=1):g};"
                " give a positive weight and time of each term"
            )

    def remembering(self, creep: Creep) -> "Regression":
        """This regression on forces that are remembered by `creep`; on those of the moment where it
        has no terms."""
        return replace(self, creep=creep.array if creep.terms else None)

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
        if self.elastic:
            return "elastic"
        if self.modes is None:
            return "linear"
        return "POD" if self.squares is None else "POD + quadratic"

    @property
    def parameters(self) -> int:
        """Numbers that it holds."""
        return sum(a.size for a in (self.kernel, self.modes, self.squares) if a is not None)

    def predict(self, force: np.ndarray) -> np.ndarray:
        """Displacement (S, nx, ny, nz, 3) float32 mm from windows (S, [T,] nx, ny, nz, 3) mN of
        forces, remembered ones if it is of those. Raises InputError as `check_loads` does.
        """
        self.check_loads(force)
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

    def check_loads(self, force: np.ndarray) -> None:
        """Raises InputError where it is elastic and some of the forces (S, ..., nx, ny, nz, 3) act
        on a free node outside `active`."""
        if not self.elastic:
            return
        elsewhere = force.reshape(len(force), -1)[:, self._unknown]
        if elsewhere.any():
            component = self._unknown[np.argwhere(elsewhere)[0, 1]]
            node = np.unravel_index(component // 3, self.mask.shape)
            raise InputError(
                f"a force acts on node {tuple(map(int, node))} of the grid, which is not on the"
                " contact surface that the elastic answer is known for; leave it out"
            )

    @cached_property
    def _unknown(self):
        """Components of the force on free nodes that are not active."""
        free = np.repeat(self.mask.ravel(), 3)
        free[self.active] = False
        return np.flatnonzero(free)

    def save(self, path: Path | str) -> None:
        """Write it to `path` (.npz), at once or not at all."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        known = {name: value for name, value in arrays.items() if value is not None}
        if not known["elastic"]:
            del known["elastic"]
        new = known.keys() & {"creep", "elastic"}
        save_arrays(path, format=FORMAT if new else FORMAT_1, **known)

    @classmethod
    def load(cls, path: Path | str) -> "Regression":
        """The regression at `path`. Raises InputError for a file that is missing, damaged or
        another's."""
        if not Path(path).is_file():
            raise InputError(f"no regression {path}; {REMEDY}")
        arrays: dict[str, Any] = load_arrays(path)
        if str(arrays.pop("format", None)) not in (FORMAT, FORMAT_1):
            raise InputError(f"{path} is not a whole '{FORMAT}' file; {REMEDY}")
        try:
            for name, kind in (("steps", int), ("interval", float), ("elastic", bool)):
                if name in arrays:
                    arrays[name] = kind(arrays[name])
            found = cls(**arrays)
            found.grid  # noqa: B018 its places are checked
            return found
        except (TypeError, ValueError) as error:
            raise InputError(f"{path} is damaged ({error}); {REMEDY}") from None


class RegressionStepper(WindowStepper):
    """A Regression as a Stepper; it keeps the memory of one on remembered forces."""

    def __init__(self, regression: Regression) -> None:
        self._regression, memory = regression, None
        if regression.creep is not None:
            shape = (*regression.mask.shape, 3)
            memory = CreepFilter(Creep.from_array(regression.creep), shape)
        super().__init__(regression, regression.grid, regression.steps, regression.interval, memory)

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """As WindowStepper.step. Raises InputError also as Regression.check_loads does."""
        if self._regression.elastic:
            nodal = self.grid.is_nodal(as_field(force))
            self._regression.check_loads((self.grid.to_grid(force) if nodal else force)[None])
        return super().step(force, dt)

    @classmethod
    def open(cls, path: Path | str) -> "RegressionStepper":
        """That of the file at `path`. Raises InputError for another file."""
        return cls(Regression.load(path))
