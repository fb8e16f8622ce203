"""Replay an interaction of a dataset in real time, and tell how well the rate was kept."""

import time
from pathlib import Path

import numpy as np

from fem.errors import InputError
from fem.online.stepper import Stepper


def replay(
    stepper: Stepper, force: np.ndarray, times: np.ndarray, rate: float | None = None
) -> dict[str, np.ndarray]:
    """Call `stepper` at `rate` Hz with the forces (F, ...) mN of the frames at `times` (F,) s,
    linear in between.

    rate: None for that of the stepper's interval. Returns {"late": s after its due time that each
    call began, "took": s, "done": s after its due time that it ended, "displacement": (F, ...) mm
    at the frames}. Raises InputError if the stepper is made for another rate, or takes any and none
    is given.
    """
    dt = stepper.interval if rate is None else 1 / rate
    if dt is None:
        raise InputError("this stepper takes any interval; give the rate in Hz")
    rate = 1 / dt
    count = round(times[-1] * rate) + 1
    frames = np.round(times * rate).astype(int)
    at = np.interp(np.arange(count) / rate, times, np.arange(len(times)))
    before = np.minimum(at.astype(int), len(times) - 2)
    share = (at - before).astype("float32")
    now = np.empty(force.shape[1:], "float32")
    late, took = np.empty(count), np.empty(count)
    displacement = np.zeros_like(force)
    which = dict(zip(frames.tolist(), range(len(frames)), strict=True))
    for _ in range(20):  # warm-up
        stepper.step(force[0], dt)
    stepper.reset()
    start = time.perf_counter() + 0.05
    for n in range(count):
        np.subtract(force[before[n] + 1], force[before[n]], out=now)
        now *= share[n]
        now += force[before[n]]
        due = start + n * dt
        spare = due - time.perf_counter()
        if spare > 2e-3:
            time.sleep(spare - 1e-3)  # sleep wakes late; the rest is spent waiting awake
        while (begun := time.perf_counter()) < due:
            pass
        answer = stepper.step(now, dt)
        late[n], took[n] = begun - due, time.perf_counter() - begun
        if n in which:
            displacement[which[n]] = answer
    return {"late": late, "took": took, "done": late + took, "displacement": displacement}


def report(timing: dict[str, np.ndarray], rate: float) -> str:
    """One line on a replay at `rate` Hz."""
    count = len(timing["took"])
    achieved = (
        (count - 1) / ((count - 1) / rate + timing["late"][-1] - timing["late"][0])
        if count > 1
        else rate
    )
    took, late = 1e3 * timing["took"], 1e3 * timing["late"]  # ms
    p50, p99 = np.percentile(took, [50, 99])
    missed = int(np.sum(timing["done"] > 1 / rate))
    return (
        f"{rate:6g} Hz: achieved {achieved:7.1f} Hz,"
        f" step p50 {p50:.3f} p99 {p99:.3f} worst {took.max():.3f} ms,"
        f" jitter p99 {np.percentile(late, 99):.3f} worst {late.max():.3f} ms,"
        f" missed {missed} of {count} deadlines ({100 * missed / count:.2f} %)"
    )


def read_interaction(
    path: str | Path, number: int | None = None
) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """(number, times s, force mN, displacement mm) of a test interaction of a dataset; the first if
    None. Needs h5py, which the extra unet-fem[fem] brings."""
    try:
        import h5py
    except ImportError:
        raise InputError(
            "reading a dataset needs h5py; install it with pip install 'unet-fem[fem]'"
        ) from None

    if not Path(path).is_file():
        raise InputError(
            f"no dataset {path};"
            f" make it with python -m fem.generate configs/<scene>.toml --out {path}"
        )
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise InputError(
            f"{path} cannot be read as HDF5; delete it and generate it again"
        ) from None
    with file:
        try:
            return _interaction(file, path, number)
        except InputError:
            raise
        # h5py fails in many ways on what is damaged
        except (
            KeyError,
            OSError,
            RuntimeError,
            TypeError,
            ValueError,
            AttributeError,
            IndexError,
        ) as error:
            raise InputError(
                f"{path} is damaged ({error}); delete it and generate it again"
            ) from None


def _interaction(file, path, number):
    """`read_interaction` of an open file, which must hold all itself."""
    for name in ("split", "number", "time", "force", "displacement"):
        linked = "Soft" in str(file.get(name, getlink=True)) or file[name].file != file
        if linked or file[name].external or file[name].is_virtual:
            raise InputError(f"'{name}' of {path} lies in another file or place; it is not read")
    rows = np.flatnonzero(file["split"][()] == b"test")
    numbers = file["number"][()][rows]
    number = numbers[0] if number is None else number
    if number not in numbers:
        raise InputError(
            f"{path} has no test interaction {number}; it has {numbers.min()} to {numbers.max()}"
        )
    row = rows[list(numbers).index(number)]
    times, force, displacement = file["time"][()], file["force"][row], file["displacement"][row]
    if not (np.diff(times) > 0).all() or not (
        np.isfinite(force).all() and np.isfinite(displacement).all()
    ):
        raise InputError(f"{path} is damaged: interaction {number} is not finite or not in order")
    return int(number), times, force, displacement
