"""A deployed network: force in mN to displacement in mm at a fixed rate, with NumPy and LiteRT
alone.

    python -m unet_fem.runtime model.tflite data.h5 [--interaction N] [--rate 100 1000] [--threads
    1]

replays an interaction and tells how well the rate is kept. A surrogate is one file: the .tflite
with normalisation and mask in its graph, and behind it, as a zip archive of NumPy arrays, what the
graph does not say.
"""

import io
import os
import warnings
import zipfile
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError
from fem.online.volume import VOLUME_BAND, QuadVolume

FORMAT = "unet-fem surrogate 1"


def write_surrogate(path, model, *, mask, points, faces, interval, largest_force):
    """Write a surrogate to `path`, at once or not at all.

    model: bytes of a .tflite file. mask: (nx, ny, nz) bool, the free material nodes. points:
    (nx*ny*nz, 3) mm.
    faces: (M, 4) nodes of the boundary quads, counter-clockwise seen from outside. interval: s
    between the frames of a force window. largest_force: (total, nodal) mN seen in training, see
    `force_size`.
    """
    path = Path(path)
    archive = io.BytesIO()
    arrays = {
        "mask": mask,
        "points": points,
        "faces": faces,
        "interval": interval,
        "largest_force": largest_force,
    }
    np.savez_compressed(archive, format=FORMAT, **arrays)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with open(partial, "wb") as file:
            file.write(model)
            file.write(archive.getvalue())
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def force_size(force):
    """(largest total force, largest nodal force) in mN over all fields of force (..., nx, ny, nz,
    3)."""
    total = np.linalg.norm(force.sum(axis=(-4, -3, -2), dtype=float), axis=-1)
    return float(total.max()), float(np.linalg.norm(force, axis=-1).max())


class Surrogate:
    """A network that answers call by call and keeps the window of past forces itself.

    The frames of a window are `interval` seconds apart, as in training. Without a `rate` every call
    of `step` is one frame later than the one before. With `rate` in Hz calls come 1 / rate seconds
    apart: each is answered for now, from the forces now, one interval ago, two intervals ago ...
    which a ring of the recent calls holds.

    After each step: `volume` in mm3; `outside_training_range`, whether the force's total or its
    largest node exceeds all of training; `volume_alarm`, whether the volume is off by more than 7
    %. The first time that either becomes true there is also a RuntimeWarning.

    path: file of tools/quantize.py. threads: of the interpreter. Raises InputError for another
    file, and for a rate at which an interval is not a whole number of calls.
    """

    def __init__(self, path, threads=1, rate=None):
        if threads < 1 or rate is not None and not rate > 0:
            raise InputError(f"threads = {threads} and rate = {rate} must be positive")
        about = _read(path)
        self.mask, self.interval, self.largest_force = (
            about["mask"],
            float(about["interval"]),
            about["largest_force"],
        )
        self.grid = self.mask.shape
        self._interpreter = Interpreter(str(path), num_threads=threads)
        self._interpreter.allocate_tensors()
        source, result = (
            self._interpreter.get_input_details()[0],
            self._interpreter.get_output_details()[0],
        )
        self.steps = int(source["shape"][1]) if len(source["shape"]) == 6 else 1
        # views of the interpreter's memory, made anew at each call: it refuses to run while one is
        # held
        self._window = self._interpreter.tensor(source["index"])  # () -> (1, [T,] nx, ny, nz, 3)
        self._displacement = self._interpreter.tensor(result["index"])  # () -> (1, nx, ny, nz, 3)
        self._stride = self._calls_an_interval(rate) if self.steps > 1 else 1
        field = (*self.grid, 3)
        self._recent = np.zeros(
            (self._stride * (self.steps - 1) + 1, *field), "float32"
        )  # ring of forces
        self._finite = np.empty(field, bool)
        self._square, self._total = np.empty(self.mask.size, "float32"), np.empty(3, "float32")
        self._ones = np.ones(self.mask.size, "float32")
        self._volume = QuadVolume(about["points"], about["faces"], self.mask)
        self.rest_volume = self._volume(np.zeros(field, "float32"))
        self._warned = set()
        self.reset()

    def _calls_an_interval(self, rate):
        calls = 1 if rate is None else rate * self.interval
        if calls < 0.5 or abs(calls - round(calls)) > 1e-6 * calls:
            raise InputError(
                f"at {rate:g} Hz the {self.interval:g} s between the frames of a window are not a whole number of calls;"
                f" use a multiple of {1 / self.interval:g} Hz"
            )
        return round(calls)

    def reset(self):
        """Back to rest: no force in the past."""
        self._recent[:] = 0
        self._newest = 0
        self.outside_training_range = self.volume_alarm = False
        self.volume = self.rest_volume

    def step(self, force, out=None):
        """Displacement (nx, ny, nz, 3) mm under force (nx, ny, nz, 3) mN and the forces of the
        calls before.

        out: float32 array to write it to, for a loop that must not allocate; a new one if None.
        Raises InputError for a force of another shape or with values that are not finite; the
        window is then as it was.
        """
        force = np.asarray(force)
        if force.shape != self._finite.shape or force.dtype.kind not in "fiu":
            raise InputError(
                f"force is {force.dtype} of shape {force.shape}; give real numbers of shape {self._finite.shape}"
            )
        newest = (self._newest + 1) % len(self._recent)
        now = self._recent[newest]
        np.copyto(now, force, casting="same_kind" if force.dtype.kind == "f" else "unsafe")
        if not np.isfinite(now, out=self._finite).all():
            node = tuple(int(n) for n in np.argwhere(~self._finite)[0])
            raise InputError(
                f"force is {force[node]} at {node} (node x, y, z, component); give finite values"
            )
        self._newest = newest
        self._judge_force(now.reshape(-1, 3))
        window = self._window()
        if window.ndim == 6:
            for t in range(self.steps):
                window[0, t] = self._recent[newest - (self.steps - 1 - t) * self._stride]
        else:
            window[0] = now
        del window
        self._interpreter.invoke()
        if out is None:
            out = np.empty(self._finite.shape, "float32")
        np.copyto(out, self._displacement()[0])
        self._judge_volume(out)
        return out

    def _judge_force(self, force):
        np.einsum("ni,ni->n", force, force, out=self._square)
        np.matmul(self._ones, force, out=self._total)
        nodal, total = float(self._square.max()) ** 0.5, float(self._total @ self._total) ** 0.5
        most_total, most_nodal = self.largest_force
        self.outside_training_range = bool(
            total > 1.00001 * most_total or nodal > 1.00001 * most_nodal
        )  # but for rounding
        if self.outside_training_range:
            seen = f"trained up to {most_total:.3g} mN in total and {most_nodal:.3g} mN at a node"
            self._warn(
                "force",
                f"the force ({total:.3g} mN in total, {nodal:.3g} mN at a node) leaves the training range: {seen}",
            )

    def _judge_volume(self, displacement):
        self.volume = self._volume(displacement)
        change = self.volume / self.rest_volume - 1
        self.volume_alarm = abs(change) > VOLUME_BAND
        if self.volume_alarm:
            self._warn(
                "volume",
                f"the predicted volume is off by {100 * change:+.1f} %: do not trust this displacement",
            )

    def _warn(self, what, message):
        if what not in self._warned:
            self._warned.add(what)
            warnings.warn(
                f"{message} (said once; see the flags after each step)",
                RuntimeWarning,
                stacklevel=4,
            )


def _read(path):
    """The arrays behind the graph of the surrogate at `path`."""
    if not Path(path).is_file():
        raise InputError(f"no surrogate {path}; make it with python tools/quantize.py runs/<name>")
    try:
        with open(path, "rb") as file, np.lib.npyio.NpzFile(file) as archive:
            about = {name: archive[name] for name in archive.files}
    except (zipfile.BadZipFile, ValueError):
        about = {}
    if about.get("format") != FORMAT:
        raise InputError(
            f"{path} is not a '{FORMAT}' file; make one with python tools/quantize.py runs/<name>"
        )
    return about
