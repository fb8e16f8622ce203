"""The modal network: dense layers that correct the linear viscoelastic answer, in modal
coordinates. NumPy alone.

    l = g + sum_k j_k s_k                  linear answer to the force as tissue remembers it
    h = f(W_0 [l; g] + b_0)                f(x) = x / (1 + exp(-x))
    p = P h,   q = p + sum_k g_k p_k       what is remembered:  p_k' = (p - p_k) / tau_k
    h = h + f(W_1 [h; q] + b_1)
    h = h + f(W_n h + b_n)                 n = 2, ...
    u = Phi (l + W h)

g = K^-1 f and l = K^-1 f~ are in the coordinates of the modes Phi (fem.online.reduced), the s_k are
filters of g with the retardation times of the creep function (fem.online.creep), and g_k, tau_k are
the Prony series: the learned features p are forgotten as the stress is. What the layers give at
rest is taken from p and from the answer, so that no force moves nothing. All depends on past forces
alone, through filters that are exact for any frame lengths: no answer comes back as an input, and
nothing can run away.

The arrays of a file `unet-fem modal 1`: those of a reduced model without points
(fem.online.reduced) and, float32, S the size of a layer:

    W0 (S, 2 R) 1/mm, b0 (S,); P (p, S); W1 (S, S + p), b1 (S,); W<n> (S, S), b<n> (S,)
    out (R, S) mm              W
    guard (4,)                 see unet_fem.runtime.guard
"""

import warnings
from pathlib import Path

import numpy as np

from fem.errors import InputError
from fem.files import load_arrays, save_arrays
from fem.online.creep import Creep, CreepFilter
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.online.stepper import State, check_interval
from unet_fem.runtime.guard import Guard

FORMAT = "unet-fem modal 1"
REMEDY = "train one with python tools/modal.py"


class Layers:
    """The dense layers of {"W0", "b0", "P", ..., "out"}, frame by frame.

    inputs (2 R,): [l; g], to be written before a call of `features`; past (p,): q, before
    `correction` of the same frame.
    """

    def __init__(self, weights: dict[str, np.ndarray]) -> None:
        count = sum(name.startswith("W") for name in weights)
        # f(2 y) = y (1 + tanh y): half the weights give y, and nothing overflows
        halves = [(weights[f"W{n}"] / 2, weights[f"b{n}"] / 2) for n in range(count)]
        self._first, self._second, *self._more = halves
        self._P, self._out = weights["P"], weights["out"]
        S = len(self._out[0])
        self.inputs = np.zeros(self._first[0].shape[1], np.float32)
        self._y, self._f, self._both = (
            np.zeros(size, np.float32) for size in (S, S, S + len(self._P))
        )
        self._h, self.past = self._both[:S], self._both[S:]
        self._p0, self._a0 = (np.zeros(len(W), np.float32) for W in (self._P, self._out))
        self._p0 = self.features()
        self._a0 = self.correction()

    def features(self) -> np.ndarray:
        """p of the inputs."""
        self._h[:] = self._activation(*self._first, self.inputs)
        return self._P @ self._h - self._p0

    def correction(self) -> np.ndarray:
        """a - l (R,) mm."""
        self._h += self._activation(*self._second, self._both)
        for W, b in self._more:
            self._h += self._activation(W, b, self._h)
        return self._out @ self._h - self._a0

    def _activation(self, W, b, x):
        y, f = self._y, self._f
        np.dot(W, x, out=y)
        y += b
        np.tanh(y, out=f)
        f += 1
        f *= y
        return f


class ModalStepper:
    """A modal network as a fem.online.stepper.Stepper for frames of any length.

    model: without points; weights: the arrays of the module's head. interval: s between calls that
    give no dt, or None.

    After each step: `a` (R,) its coordinates in mm, `bound`, a share of the displacement that the
    error of nine of ten frames like those of training does not exceed, and `flagged` with the
    guard's `reason` where nobody vouches for the answer. The first time that it is flagged there is
    also a RuntimeWarning.
    """

    def __init__(
        self,
        model: ReducedModel,
        weights: dict[str, np.ndarray],
        interval: float | None = None,
    ) -> None:
        if interval is not None:
            check_interval(None, interval)
        self.model, self.weights, self.interval = model, weights, interval
        self.fields, self.grid = Fields(model), model.grid
        self.layers, self.guard = Layers(weights), Guard(model, weights["guard"])
        prony = tuple((float(g), float(tau)) for g, tau in model.prony)
        self._creep = CreepFilter(Creep.of(prony), (model.modes,))
        self._past = CreepFilter(Creep(prony), weights["P"].shape[:1])
        self._warned = False
        self.reset()

    @classmethod
    def open(cls, path: Path | str, interval: float | None = None) -> "ModalStepper":
        """That of the file at `path`. Raises InputError for another file."""
        return cls(*load_modal(path), interval)

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self._creep.reset()
        self._past.reset()
        self.guard.reset()
        self.a = np.zeros(self.model.modes, np.float32)

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, dt seconds after the call before, under `force` in mN that
        grew linearly since; see fem.online.stepper.Stepper."""
        if dt is None:
            dt = self.interval
        check_interval(None, dt)
        layout, g = self.fields.encode(np.asarray(force))
        layers, elapsed = self.layers, float(dt)  # type: ignore[arg-type]
        linear, inputs = layers.inputs[: len(g)], layers.inputs
        linear[:], inputs[len(g) :] = self._creep.step(g, elapsed), g
        layers.past[:] = self._past.step(layers.features(), elapsed)
        self.a = layers.correction()
        self.a += linear
        u = self.fields.decode(self.a, layout)
        size = max(float(u.max()), -float(u.min())) ** 3
        self.guard(self.fields, linear, 0.0, size, elapsed)
        if self.flagged and not self._warned:
            self._warned = True
            warnings.warn(
                f"do not trust this displacement: {self.guard.reason} (said once; see `flagged`"
                " after each step)",
                RuntimeWarning,
                stacklevel=2,
            )
        return u

    @property
    def bound(self) -> float:
        """Of the last frame."""
        return self.guard.bound

    @property
    def flagged(self) -> bool:
        """Of the last frame."""
        return bool(self.guard.reason)

    def _memories(self):
        return {"force": self._creep, "features": self._past, "guard": self.guard.memory}

    def state(self) -> State:
        """All that the next answer depends on: what is remembered of forces and features."""
        found = {f"{n}_{k}": v for n, m in self._memories().items() for k, v in m.state().items()}
        return found | {"astray": np.array(self.guard.astray)}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another stepper."""
        wanted = {name: np.shape(values) for name, values in self.state().items()}
        found = {name: np.shape(values) for name, values in state.items()}
        if found != wanted or not all(np.isfinite(values).all() for values in state.values()):
            raise InputError(
                "the state is of another stepper; restore what state() of the same stepper gave"
            )
        for name, memory in self._memories().items():
            own = f"{name}_"
            memory.restore({k.removeprefix(own): v for k, v in state.items() if k.startswith(own)})
        self.guard.astray = bool(state["astray"])


def save_modal(path: Path | str, model: ReducedModel, weights: dict[str, np.ndarray]) -> None:
    """Write a network to `path` (.npz), at once or not at all."""
    save_arrays(path, format=FORMAT, **model.arrays(), **weights)


def load_modal(path: Path | str) -> tuple[ReducedModel, dict[str, np.ndarray]]:
    """(model, weights) of the file at `path`. Raises InputError for one that is missing, damaged or
    another's."""
    if not Path(path).is_file():
        raise InputError(f"no modal network {path}; {REMEDY}")
    arrays = load_arrays(path)
    if str(arrays.pop("format", None)) != FORMAT:
        raise InputError(f"{path} is not a whole '{FORMAT}' file; {REMEDY}")
    model = ReducedModel.of(arrays, path)
    return model, _weights(model, arrays, path)


def _weights(model, arrays, path):
    """The layers and the guard among `arrays`. Raises InputError where they do not fit."""
    layers = sum(f"W{n}" in arrays for n in range(len(arrays)))
    size, kept = (np.shape(arrays.get(name, 0.0))[:1] for name in ("W0", "P"))
    if layers < 2 or not size or not kept:
        raise InputError(f"{path} does not hold W0, W1 and P; {REMEDY}")
    S, R = size[0], model.modes
    shapes = {"W0": (S, 2 * R), "P": (kept[0], S), "W1": (S, S + kept[0])}
    shapes |= {f"W{n}": (S, S) for n in range(2, layers)}
    shapes |= {f"b{n}": (S,) for n in range(layers)} | {"out": (R, S), "guard": (4,)}
    for name, shape in shapes.items():
        found = arrays.get(name)
        fits = found is not None and found.shape == shape and found.dtype.kind == "f"
        if not (fits and np.isfinite(found).all()):
            raise InputError(f"{path}: {name} must be finite and of shape {shape}; {REMEDY}")
    return {name: np.ascontiguousarray(arrays[name], np.float32) for name in shapes}
