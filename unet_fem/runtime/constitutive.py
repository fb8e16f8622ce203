"""The constitutive network beside a user: force in mN to displacement in mm at any rate, with NumPy
and LiteRT alone.

The file is a .tflite graph of one frame (unet_fem.deployment.constitutive_graph) and behind it, as
a zip archive of NumPy arrays, the reduced model that the network stands on (fem.online.reduced),
the learned arrays, and what its guard goes by.
"""

import io
import warnings
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError
from fem.files import load_arrays, write_bytes
from fem.online.constitutive import SECANTS, bulk_of, learned_of, limited
from fem.online.creep import steps_within
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.online.retissue import with_tissue
from fem.online.secants import Secants
from fem.online.stepper import State, as_field, check_interval, check_state
from fem.ranges import checked, checked_array
from unet_fem.runtime.guard import Guard
from unet_fem.runtime.rates import rates
from unet_fem.runtime.surrogate_file import check_graph, graph_digest

MEMORY = ("history", "slow", "correction")
RATES = ("c", "past", "advance", "creep", "remembered")
REMEDY = "make it again with python -m unet_fem.train configs/constitutive.toml"
# where the guard's bound is above DOUBT, a frame settles to share / CARE, if that is not finer than
# FINEST; chosen on validation
DOUBT, CARE, FINEST = 0.01, 5.0, 1e-3

FORMAT = "unet-fem constitutive 2"


class ConstitutiveSurrogate:
    """A constitutive network as a fem.online.stepper.Stepper for frames of any length.

    interval: s between calls that give no dt, or None. effort: (share, most): a frame whose last
    step or residual was longer than `share` of |a| gets another evaluation, up to `most`, and where
    the guard's bound is above 1 % than a fifth of it; the file's own if None; (1, 1) is always one.

    After each step: `a` (R,) its coordinates in mm, `evaluations`, and where the file has a guard
    `bound`, a share of the displacement that the error of nine of ten frames like those of training
    does not exceed, and `flagged` with its `reason` where nobody vouches for the answer. The first
    time that it is flagged there is also a RuntimeWarning, if it `warns`.
    """

    def __init__(
        self,
        path: str | Path,
        interval: float | None = None,
        effort: tuple[float, int] | None = None,
        threads: int = 1,
    ) -> None:
        checked("threads", threads, 1, 1024, whole=True)
        if interval is not None:
            check_interval(None, interval)
        self.path, self.interval = Path(path), interval
        arrays = read_constitutive(path)
        self.model = ReducedModel.of(arrays, path)
        self.fields, self.grid = Fields(self.model), self.model.grid
        self._threads = threads
        self._open(self.path.read_bytes())
        self._learned = learned_of(self.model, arrays, path)
        asked = self._learned["effort"] if effort is None else effort
        share, most = checked_array("effort", asked, (2,))
        if not (0 < share <= 1 and 1 <= most <= 1000 and most == int(most)):
            raise InputError(
                f"effort = {(share, most)} must be a share up to 1 and evaluations from 1 to 1000"
            )
        self.share, self.most = float(share), int(most)
        self._bulk = bulk_of(self.model.law)  # of the data
        self._secants = Secants(self.model.modes, SECANTS)
        self._take_tissue()
        self.reset()

    def _take_tissue(self):
        self._in["bulk"]()[:] = bulk_of(self.model.law)
        self._prony = tuple((float(g), float(tau)) for g, tau in self.model.prony)
        self._dt: float | None = None
        fitted = self._learned.get("guard")
        self._guarded = fitted is not None
        stretched = float(np.abs(np.log(bulk_of(self.model.law) / self._bulk)).max())
        row = np.zeros(5) if fitted is None else fitted[int(self.most == 1)]
        self.guard = Guard(self.model, row, stretched)
        self.warns = True

    def _open(self, graph):
        self._graph = graph
        try:
            found = Interpreter(model_content=graph, num_threads=self._threads)
            found.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise InputError(
                f"{self.path} cannot be loaded by LiteRT ({str(error).splitlines()[0]}); {REMEDY}"
            ) from None
        # views of the interpreter's memory, made anew at each call: it refuses to run while one is
        # held
        self._invoke = found.invoke
        self._in = {d["name"]: found.tensor(d["index"]) for d in found.get_input_details()}
        self._out = {d["name"]: found.tensor(d["index"]) for d in found.get_output_details()}
        self._moves = [(self._in[name], self._out[f"new_{name}"]) for name in MEMORY]
        self._g, self._a = self._in["g"], self._out["a"]
        self._u, self._signs = self._out["displacement"], self._out["signs"]

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        for name in (*MEMORY, "given", "again"):
            self._in[name]()[:] = 0
        self.a, self.evaluations = np.zeros(self.model.modes, "float32"), 0
        self.guard.reset()

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, dt seconds after the call before, under `force` in mN that
        grew linearly since; see fem.online.stepper.Stepper."""
        if dt is None:
            dt = self.interval
        if dt != self._dt or dt is None:
            check_interval(None, dt)
            self._steps = steps_within(self._prony, float(dt))  # type: ignore[arg-type]
            new = rates(self._prony, float(dt) / self._steps)  # type: ignore[arg-type]
            for name, value in zip(RATES, new, strict=True):
                place(value[0], self._in[name]()[0])
            self._dt = dt
        layout, g = self.fields.encode(as_field(force))
        if self._guarded:
            self.guard.begin(self.fields, float(dt))  # type: ignore[arg-type]
        if self._steps > 1:
            old = self._in["slow"]()[0, -1].copy()
            for step in range(1, self._steps):
                self._frame(old + step / self._steps * (g - old))
        self._frame(g)
        self.a = self._a()[0].copy()
        if self.flagged and self.warns:
            self.warns = False
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

    def set_material(
        self,
        mu: float | None = None,
        K: float | None = None,
        prony: tuple[tuple[float, float], ...] | None = None,
    ) -> None:
        """Another tissue from here on, at rest: moduli in Pa and ((g, tau s), ...); what is None
        stays. Nothing is trained; a common factor on mu and K is exact.

        Raises InputError for what has no meaning or does not hold, see fem.online.retissue, for
        more Prony terms than the graph has, and for another K / mu in a graph with int8 weights.
        """
        model, learned = with_tissue(self.model, self._learned, mu, K, prony)
        terms = self._in["history"]().shape[1] - 1
        if len(model.prony) > terms:
            raise InputError(
                f"prony has {len(model.prony)} terms and the graph in {self.path} room for {terms}"
            )
        if learned is not self._learned:
            pairs = [(f"N{b}", self._learned, learned) for b in range(len(model.blocks))]
            changed = [(old[name], new[name]) for name, old, new in pairs]
            blocks = zip(self.model.blocks, model.blocks, strict=True)
            self._open(patched(self._graph, changed + [(b.M, new.M) for b, new in blocks]))
        self.model, self._learned, self.fields = model, learned, Fields(model)
        self._take_tissue()
        self.reset()

    def _frame(self, g):
        """A step, or the frame, to the force whose elastic answer is g (R,) mm."""
        self._g()[0] = g
        self._invoke()
        self.evaluations, start, kept, best = 1, None, None, np.inf
        while self._unsettled():
            if self._unrest < best:
                kept, best = start, self._unrest
            if self.evaluations == self.most:
                if self._unrest > best or np.isnan(self._unrest):
                    self._evaluate(kept)
                    self._unsettled()
                if self._guarded and self.most > 1:
                    self.guard.flag(2)
                break
            start = self._next(start)
            self._evaluate(start)
            self.evaluations += 1
        for into, out in self._moves:
            np.copyto(into(), out())

    def _unsettled(self):
        """Whether the frame asks for another evaluation."""
        self._unrest, share = float(self._signs().max()), self.share
        if self._guarded:
            a = self._a()[0]
            linear = a - self._out["new_correction"]()[0]
            self.guard.judge(linear, a, self._unrest, float(np.abs(self._u()).max()))
            if self.guard.bound > DOUBT:
                share = min(share, max(share / CARE, FINEST))
        return not self._unrest <= share

    def _next(self, start):
        """Where the next evaluation starts, after one from `start`, None for the first."""
        a = self._a()[0].copy()
        if start is None:
            linear = a - self._out["new_correction"]()[0]
            start = linear + self._learned["gain"] * self._in["correction"]()[0]
            self._secants.clear()
        step = a - start
        return start + limited(self._secants.step(start, step), start)

    def _evaluate(self, start):
        """Evaluate the frame again, from `start`, None for its own."""
        again = self._in["again"]
        if start is not None:
            self._in["given"]()[0] = start
            again()[:] = 1
        self._invoke()
        again()[:] = 0

    def state(self) -> State:
        """All that the next answer depends on: stress history, creep filter, last correction."""
        return {name: self._in[name]()[0].copy() for name in MEMORY} | self.guard.state()

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another stepper."""
        check_state(state, self.state())
        for name in MEMORY:
            self._in[name]()[0] = state[name]
        self.guard.restore(state)


def place(value: np.ndarray, into: np.ndarray) -> None:
    """A matrix of `rates` into one for more Prony terms, which have no share."""
    if value.shape == into.shape:
        into[:] = value
        return
    into[:] = 0
    extra = [n - m for n, m in zip(into.shape, value.shape, strict=True)]
    rows = _places(len(value), extra[0], 1)
    columns = _places(value.shape[1], extra[1], 1 if len(value) == 1 else 2)
    into[np.ix_(rows, columns)] = value


def _places(count, extra, last):
    """Of `count` rows, the `last` ones at the end, `extra` ones left out before them."""
    return np.arange(count) + extra * (np.arange(count) >= count - last)


def patched(graph: bytes, pairs: list[tuple[np.ndarray, np.ndarray]]) -> bytes:
    """A graph with the weights of each (old, new) pair exchanged. Raises InputError where the old
    ones do not stand in it as they are."""
    for old, new in pairs:
        for kind in ("<f4", "<f2"):
            found = np.ascontiguousarray(old, kind).tobytes()
            if found in graph:
                graph = graph.replace(found, np.ascontiguousarray(new, kind).tobytes())
                break
        else:
            raise InputError(
                "another K / mu changes weights, and this graph does not hold them as they are;"
                " use the float32 or float16 file"
            )
    return graph


def read_constitutive(path: str | Path) -> dict[str, np.ndarray]:
    """{name: array} of what stands behind the graph in the file at `path`. Raises InputError for
    another file."""
    if not Path(path).is_file():
        raise InputError(f"no surrogate {path}; {REMEDY}")
    arrays = load_arrays(path)
    if str(arrays.get("format")) != FORMAT:
        found = arrays.get("format")
        raise InputError(f"{path} is not a whole '{FORMAT}' file (format: {found}); {REMEDY}")
    check_graph(path, arrays, REMEDY)
    return arrays


def write_constitutive(path: str | Path, graph: bytes, arrays: dict[str, np.ndarray]) -> None:
    """Write a file, at once or not at all: the bytes of a .tflite, and the arrays of a ReducedModel
    and of the guard."""
    archive = io.BytesIO()
    np.savez(archive, format=FORMAT, sha256=graph_digest(graph), **arrays)  # type: ignore[arg-type]
    write_bytes(path, graph + archive.getvalue())
