"""A deployed network: force in mN to displacement in mm at a fixed rate, with NumPy and LiteRT
alone.

    python -m unet_fem.runtime model.tflite data.h5 [--interaction N] [--rate 100 1000] [--threads
    1]

replays an interaction and tells how well the rate is kept. A surrogate is one file, see
unet_fem.runtime.surrogate_file.
"""

import warnings
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError
from fem.online.grid import NodeGrid
from fem.online.input_field import InputField
from fem.online.stepper import State, as_field, check_interval
from fem.online.volume import VOLUME_BAND, QuadVolume
from fem.ranges import checked
from unet_fem.runtime.surrogate_file import read_surrogate


def force_size(force: np.ndarray) -> tuple[float, float]:
    """(largest total force, largest nodal force) in mN over all fields of force (..., nx, ny, nz,
    3)."""
    total = np.linalg.norm(force.sum(axis=(-4, -3, -2), dtype=float), axis=-1)
    return float(total.max()), float(np.linalg.norm(force, axis=-1).max())


_FLOAT = np.dtype("float32")


class Surrogate:
    """A network that answers call by call and keeps the window of past forces itself: a
    fem.online.stepper.Stepper.

    The frames of a window are `window_interval` seconds apart, as in training. Without a `rate`
    every call of `step` is one frame later than the one before. With `rate` in Hz calls come 1 /
    rate seconds apart: each is answered for now, from the forces now, one window interval ago, two
    ago ... which a ring of the recent calls holds. `interval` is what is between two calls.

    A network on remembered forces or on the elastic answer (see fem.online.input_field) gets them
    made here, call by call: the ring and the window then hold these, and the memory is part of the
    state.

    grid: (nx, ny, nz). nodes: the NodeGrid of the mesh's nodes in it, and points (N, 3) mm where
    they are; both None for a file of format 1 or a mesh that is embedded in the grid, which take
    forces on the grid alone. mask: (nx, ny, nz) bool, the nodes that can move. mesh: digest of the
    mesh. label: for people.

    After each step: `volume` in mm3; `outside_training_range`, whether the force's total or its
    largest node exceeds all of training; `volume_alarm`, whether the volume is off by more than 7
    %. The first time that either becomes true there is also a RuntimeWarning.
    """

    def __init__(self, path: str | Path, threads: int = 1, rate: float | None = None) -> None:
        """path: file of tools/quantize.py. threads: of the interpreter. Raises InputError for
        another file, and for a rate at which a window's interval is not a whole number of calls."""
        checked("threads", threads, 1, 1024, whole=True)
        if rate is not None:
            checked("rate", rate, 1e-3, 1e6, "Hz")
        about = read_surrogate(path)
        self.path, self.mask = Path(path), about["mask"]
        self.grid = self.mask.shape
        self.label = str(about.get("label", "")) or self.path.stem
        self.mesh = str(about.get("mesh", ""))
        index = about.get("index", np.arange(0))
        self._layout = NodeGrid(self.grid, index)
        self.nodes = self._layout if len(index) else None
        self.points = about["points"][index] if len(index) else None
        self.largest_force = tuple(about["largest_force"].tolist())
        self.window_interval = float(about["interval"])
        self.steps = self._open(threads)
        self._stride = self._calls_an_interval(rate) if self.steps > 1 else 1
        self.interval: float | None = self.window_interval if rate is None else 1 / rate
        self._field = None
        if "input_creep" in about:
            own = {name.removeprefix("input_"): array for name, array in about.items()}
            self._field = InputField.of(own, self.mask)
        field = (*self.grid, 3)
        self._recent = np.zeros(
            (self._stride * (self.steps - 1) + 1, *field), "float32"
        )  # ring of forces
        self._square, self._total = np.empty(self.mask.size, "float32"), np.empty(3, "float32")
        self._ones = np.ones(self.mask.size, "float32")
        self._volume = QuadVolume(about["points"], about["faces"], self.mask)
        self.rest_volume = self._volume(np.zeros(field, "float32"))
        if not 0 < self.rest_volume < np.inf:
            raise InputError(
                f"{path} is damaged: its faces bound {self.rest_volume:g} mm3;"
                " make it again with python tools/quantize.py runs/<name>"
            )
        self._warned: set[str] = set()
        self.reset()

    def _open(self, threads):
        """Load the graph. Returns the frames of its window, 1 if it has no window."""
        try:
            self._interpreter = Interpreter(str(self.path), num_threads=threads)
            self._interpreter.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise InputError(
                f"{self.path} cannot be loaded by LiteRT ({str(error).splitlines()[0]});"
                " make it again with python tools/quantize.py runs/<name>"
            ) from None
        source = self._interpreter.get_input_details()[0]
        result = self._interpreter.get_output_details()[0]
        taken, given = tuple(source["shape"].tolist()), tuple(result["shape"].tolist())
        field = (*self.grid, 3)
        if (taken[0], taken[-4:], len(taken) in (5, 6), given) != (1, field, True, (1, *field)):
            raise InputError(
                f"the graph in {self.path} takes {taken} and gives {given} on a grid of"
                f" {self.grid} nodes; make it again with python tools/quantize.py runs/<name>"
            )
        # views of the interpreter's memory, made anew at each call: it refuses to run while one is
        # held
        self._window = self._interpreter.tensor(source["index"])  # () -> (1, [T,] nx, ny, nz, 3)
        self._displacement = self._interpreter.tensor(result["index"])  # () -> (1, nx, ny, nz, 3)
        return taken[1] if len(taken) == 6 else 1

    def _calls_an_interval(self, rate):
        calls = 1 if rate is None else rate * self.window_interval
        if calls < 0.5 or abs(calls - round(calls)) > 1e-6 * calls:
            raise InputError(
                f"at {rate:g} Hz the {self.window_interval:g} s between the frames of a window are"
                f" not a whole number of calls; use a multiple of {1 / self.window_interval:g} Hz"
            )
        return round(calls)

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self._recent[:] = 0
        self._newest = 0
        if self._field:
            self._field.reset()
        self._clear_flags()

    def _clear_flags(self):
        self.outside_training_range = self.volume_alarm = False
        self.volume = self.rest_volume

    def step(
        self, force: np.ndarray, dt: float | None = None, *, out: np.ndarray | None = None
    ) -> np.ndarray:
        """Displacement in mm under `force` in mN and the forces of the calls before.

        force: (N, 3) at the mesh's nodes or (nx, ny, nz, 3); the displacement has the same layout.
        dt: None or `interval`. out: float32 array to write it to, for a loop that must not
        allocate; a new one if None. Raises InputError for a force of another shape or with values
        that are not finite, and for another dt; the window is then as it was.
        """
        check_interval(self.interval, dt)
        force = as_field(force)
        nodal = self._is_nodal(force)
        if out is not None and not (
            isinstance(out, np.ndarray)
            and (out.shape, out.dtype) == (force.shape, _FLOAT)
            and out.flags.writeable
        ):
            raise InputError(
                f"out must be a float32 array of shape {force.shape} that can be written to"
            )
        newest = (self._newest + 1) % len(self._recent)
        now = self._recent[newest]
        np.copyto(now, self._layout.to_grid(force) if nodal else force, casting="unsafe")
        size = self._force_size(now.reshape(-1, 3))
        if self._field:
            now[:] = self._field.step(now, self.interval or self.window_interval)
        self._newest = newest
        self._judge_force(*size)
        window = self._window()
        if window.ndim == 6:
            for t in range(self.steps):
                window[0, t] = self._recent[newest - (self.steps - 1 - t) * self._stride]
        else:
            window[0] = now
        del window
        self._interpreter.invoke()
        answer = np.empty(now.shape, "float32") if out is None or nodal else out
        np.copyto(answer, self._displacement()[0])
        if self._field and self._field.corrects:
            answer += now
        self._judge_volume(answer)
        if not nodal:
            return answer
        answer = self._layout.from_grid(answer)
        if out is None:
            return answer
        np.copyto(out, answer)
        return out

    def state(self) -> State:
        """{"forces": (calls, nx, ny, nz, 3) float32 mN}: those of the recent calls, or what is seen
        in their place, that the next answer may depend on, oldest first; and beside it the memory
        of remembered forces."""
        forces = np.roll(self._recent, -self._newest - 1, axis=0)[1:]
        return {"forces": forces} | (self._field.state() if self._field else {})

    def restore(self, state: State) -> None:
        """Go on from what `state` gave; a surrogate of the same grid, window and rate will do.
        Raises InputError for another."""
        if not isinstance(state, dict):
            raise InputError("this is not the state of a surrogate; restore what state() gave")
        forces = np.asarray(state.get("forces"))
        past = self._recent[1:]
        fits = (forces.shape, forces.dtype) == (past.shape, past.dtype)
        memory = self._field.state().keys() if self._field else set()
        if state.keys() != {"forces", *memory} or not fits or not np.isfinite(forces).all():
            raise InputError(
                f"this is not the state of a surrogate with the window of {self.path}"
                f" called every {self.interval:g} s; restore what its own state() gave"
            )
        if self._field:
            self._field.restore(state)
        past[:] = forces
        self._newest = len(past)
        self._clear_flags()

    def _is_nodal(self, force):
        if self.nodes is None and force.shape != (*self.grid, 3):
            raise InputError(
                f"the force is of shape {force.shape}; give {(*self.grid, 3)}: {self.path} has no"
                " places of the mesh's nodes in the grid. A file of format 1 gets them when it is"
                " made again with python tools/quantize.py runs/<name>"
            )
        return self._layout.is_nodal(force)

    def _force_size(self, force):
        """`force_size` of one field (nx*ny*nz, 3), without a copy. Raises InputError where float32
        does not hold it."""
        np.einsum("ni,ni->n", force, force, out=self._square)
        np.matmul(self._ones, force, out=self._total)
        total, nodal = float(self._total @ self._total) ** 0.5, float(self._square.max()) ** 0.5
        if not total + nodal < np.inf:
            raise InputError("the force is too large for float32; give it in mN")
        return total, nodal

    def _judge_force(self, total, nodal):
        most_total, most_nodal = self.largest_force
        self.outside_training_range = (
            total > 1.00001 * most_total or nodal > 1.00001 * most_nodal
        )  # but for rounding
        if self.outside_training_range:
            seen = f"trained up to {most_total:.3g} mN in total and {most_nodal:.3g} mN at a node"
            self._warn(
                "force",
                f"the force ({total:.3g} mN in total, {nodal:.3g} mN at a node) leaves the"
                f" training range: {seen}",
            )

    def _judge_volume(self, displacement):
        self.volume = self._volume(displacement)
        change = self.volume / self.rest_volume - 1
        self.volume_alarm = not abs(change) <= VOLUME_BAND  # a NaN is one
        if self.volume_alarm:
            self._warn(
                "volume",
                f"the predicted volume is off by {100 * change:+.1f} %: do not trust this"
                " displacement",
            )

    def _warn(self, what, message):
        if what not in self._warned:
            self._warned.add(what)
            warnings.warn(
                f"{message} (said once; see the flags after each step)",
                RuntimeWarning,
                stacklevel=4,
            )
