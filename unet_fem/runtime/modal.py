"""The modal network beside a user: force in mN to displacement in mm at any rate, with NumPy and
LiteRT alone.

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

The file is a .tflite graph of one frame (unet_fem.deployment.modal) and behind it, as a zip archive
of NumPy arrays, a reduced model without points (fem.online.reduced) and what its guard goes by.
"""

import io
import math
import warnings
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError
from fem.files import load_arrays, write_bytes
from fem.online.creep import Creep, CreepFilter, filter_weights
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.online.stepper import State, as_field, check_interval, check_state
from unet_fem.runtime.guard import Guard
from unet_fem.runtime.surrogate_file import check_graph, graph_digest

FORMAT = "unet-fem modal 1"
REMEDY = "make it again with python tools/modal.py"


class ModalSurrogate:
    """A modal network as a fem.online.stepper.Stepper for frames of any length.

    interval: s between calls that give no dt, or None.

    After each step: `a` (R,) its coordinates in mm, `bound`, a share of the displacement that the
    error of nine of ten frames like those of training does not exceed, and `flagged` with the
    guard's `reason` where nobody vouches for the answer. The first time that it is flagged there is
    also a RuntimeWarning.
    """

    def __init__(self, path: str | Path, interval: float | None = None, threads: int = 1) -> None:
        if interval is not None:
            check_interval(None, interval)
        self.path, self.interval = Path(path), interval
        arrays = read_modal(path)
        self.model = ReducedModel.of(arrays, path)
        self.fields, self.grid = Fields(self.model), self.model.grid
        self._open(threads)
        self.guard = Guard(self.model, arrays["guard"])
        prony = tuple((float(g), float(tau)) for g, tau in self.model.prony)
        self._creep = CreepFilter(Creep.of(prony), (self.model.modes,))
        self._forgets, self._dt = Creep(prony), math.nan
        wanted, found = (len(prony) + 1, len(prony) + 2), self._weights().shape
        if found != wanted or self._inputs().shape[-1] != 2 * self.model.modes:
            raise InputError(
                f"the graph in {self.path} is another model's: its filter is {found}, not {wanted};"
                f" {REMEDY}"
            )
        self._warned = False
        self.reset()

    def _open(self, threads):
        try:
            found = Interpreter(str(self.path), num_threads=threads)
            found.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise InputError(
                f"{self.path} cannot be loaded by LiteRT ({str(error).splitlines()[0]}); {REMEDY}"
            ) from None
        # views of the interpreter's memory, made anew at each call: it refuses to run while one is
        # held
        self._invoke = found.invoke
        tensors = {d["name"]: d["index"] for d in found.get_input_details()}
        tensors |= {d["name"]: d["index"] for d in found.get_output_details()}
        names = "inputs", "kept", "weights", "a", "displacement", "largest", "new_kept"
        if missing := set(names) - tensors.keys():
            raise InputError(f"the graph in {self.path} has no {sorted(missing)[0]}; {REMEDY}")
        self._inputs, self._kept, self._weights, self._a, self._u, self._largest, self._new = (
            found.tensor(tensors[name]) for name in names
        )

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self._creep.reset()
        self.guard.reset()
        self._kept()[:] = 0
        self.a = np.zeros(self.model.modes, np.float32)

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, dt seconds after the call before, under `force` in mN that
        grew linearly since; see fem.online.stepper.Stepper."""
        if dt is None:
            dt = self.interval
        if dt is None or dt != self._dt:
            check_interval(None, dt)
            self._weights()[:] = filter_weights(self._forgets, dt)  # type: ignore[arg-type]
            self._dt = dt  # type: ignore[assignment]
        layout, g = self.fields.encode(as_field(force))
        linear = self._creep.step(g, self._dt).astype(np.float32)
        inputs = self._inputs()[0]
        inputs[: len(g)], inputs[len(g) :] = linear, g
        del inputs
        self._invoke()
        self._kept()[:] = self._new()
        self.a = self._a()[0].copy()
        self.guard.begin(self.fields, self._dt)
        self.guard.judge(linear, self.a, 0.0, float(self._largest()))
        if self.flagged and not self._warned:
            self._warned = True
            warnings.warn(
                f"do not trust this displacement: {self.guard.reason} (said once; see `flagged`"
                " after each step)",
                RuntimeWarning,
                stacklevel=2,
            )
        return self.fields.placed(self._u()[0], layout)

    @property
    def bound(self) -> float:
        """Of the last frame."""
        return self.guard.bound

    @property
    def flagged(self) -> bool:
        """Of the last frame."""
        return bool(self.guard.reason)

    def state(self) -> State:
        """All that the next answer depends on: what is remembered of forces and features."""
        return {"features": self._kept().copy()} | self._creep.state() | self.guard.state()

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another stepper."""
        check_state(state, self.state())
        self._kept()[:] = state["features"]
        self._creep.restore(state)
        self.guard.restore(state)


def read_modal(path: str | Path) -> dict[str, np.ndarray]:
    """{name: array} of what stands behind the graph in the file at `path`. Raises InputError for
    another file."""
    if not Path(path).is_file():
        raise InputError(f"no modal network {path}; {REMEDY}")
    arrays = load_arrays(path)
    if str(arrays.get("format")) != FORMAT:
        found = arrays.get("format")
        raise InputError(f"{path} is not a whole '{FORMAT}' file (format: {found}); {REMEDY}")
    check_graph(path, arrays, REMEDY)
    guard = arrays.get("guard")
    if guard is None or guard.shape != (5,) or not np.isfinite(guard).all():
        raise InputError(f"{path}: guard must be five finite numbers; {REMEDY}")
    return arrays


def write_modal(path: str | Path, graph: bytes, model: ReducedModel, guard: np.ndarray) -> None:
    """Write a file, at once or not at all."""
    archive, arrays = io.BytesIO(), model.arrays() | {"guard": guard}
    np.savez(archive, format=FORMAT, sha256=graph_digest(graph), **arrays)  # type: ignore[arg-type]
    write_bytes(path, graph + archive.getvalue())
