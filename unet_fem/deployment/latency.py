"""How long one answer takes: steppers in turn, from force array to displacement array, at batch 1
as a control loop would call them; beside them LiteRT's bare graph and the FEM."""

import itertools
import subprocess
import sys
from collections.abc import Callable, Hashable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

import numpy as np
import psutil
import tensorflow as tf
from ai_edge_litert.interpreter import Interpreter
from threadpoolctl import threadpool_limits

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.measure.machine import processor, versions
from fem.measure.timing import alternate
from fem.online.stepper import Stepper
from fem.solver.explicit import Solver
from fem.workers import available_cores
from unet_fem.deployment.answers import muted

FRAME = 0.010  # s, of the FEM and of whatever takes any interval
WARM_UP = 20  # calls of each before the clock runs
Name = TypeVar("Name", bound=Hashable)
LIBRARIES = ("tensorflow", "keras", "ai-edge-litert", "numpy", "scipy")


def use_threads(threads: int) -> None:
    """Hold TensorFlow and the BLAS of this process to `threads` threads; LiteRT is told by each
    interpreter.

    Raises InputError where TensorFlow has run already, for then it keeps the threads that it has.
    """
    try:
        tf.config.threading.set_intra_op_parallelism_threads(threads)
        tf.config.threading.set_inter_op_parallelism_threads(threads)
    except RuntimeError:
        raise InputError(
            f"TensorFlow has run in this process before it was held to {threads} thread(s);"
            " measure in a process of its own"
        ) from None
    threadpool_limits(threads)


def time_steppers(
    steppers: Mapping[Name, Stepper],
    forces: Mapping[Name, np.ndarray],
    rounds: int,
    *,
    calls: int = 1,
    warm_up: int = WARM_UP,
    beside: Mapping[Name, Callable] | None = None,
) -> dict[Name, np.ndarray]:
    """Seconds that one call of each takes, {name: (rounds,)}: the steppers take turns, so that a
    disturbance of the machine meets all alike.

    forces: for each stepper (K, ...) mN, given to and fro without end, so that no force jumps.
    calls: in a row in one turn, as the stepper's own loop would make them, so that its weights are
    in the caches that it can have. warm_up: turns before the clock runs. beside: other actions, see
    fem.measure.timing.alternate. The steppers' warnings are held back.
    """
    turns = {name: _turn(stepper, forces[name], calls) for name, stepper in steppers.items()}
    with muted():
        return alternate(turns | dict(beside or {}), rounds, warm_up)


def _turn(stepper, forces, calls):
    """An action that answers the next `calls` of `forces` (K, ...), to and fro without end."""
    dt = FRAME if stepper.interval is None else None
    frames = itertools.cycle([*forces, *forces[::-1]])
    period = 2 * len(forces) if len(forces) > 1 else np.inf
    done = 0

    def turn():
        nonlocal done
        for _ in range(calls):
            if done == period:
                # or tissue would creep on from round to round, farther than any force takes it
                stepper.reset()
                done = 0
            stepper.step(next(frames), dt)
            done += 1
        return calls

    return turn


def graph_action(path: str | Path, threads: int = 1) -> Callable:
    """The interpreter's own work on the surrogate at `path`, without the window, the checks and the
    copies around it."""
    interpreter = Interpreter(str(path), num_threads=threads)
    interpreter.allocate_tensors()
    return lambda: interpreter.invoke()


def fem_action(dataset: Dataset, kind: str) -> Callable:
    """FRAME seconds of the dataset's tissue in float32 elements of `kind`, at its stable step and
    true mass, from the state before."""
    mesh = dataset.fem_mesh
    load = np.zeros((3, mesh.n_nodes))
    top = np.unique(mesh.contact_faces)
    load[2, top] = -1e-3 / len(top)
    solver = Solver(mesh, dataset.material, kind, "float32", damping=50.0)

    def frame():
        solver.advance(FRAME, lambda t: load)

    return frame


def peak_memory(path: str | Path, threads: int = 1) -> float:
    """Peak resident memory in MB of a process that loads the surrogate at `path` and steps it,
    TensorFlow left out."""
    code = (
        "import sys, numpy as np; from unet_fem.deployment.process import peak_mb;"
        " from unet_fem.runtime import Surrogate; s = Surrogate(sys.argv[1], int(sys.argv[2]));"
        " f = np.zeros((*s.grid, 3), 'float32'); [s.step(f) for _ in range(50)]; print(peak_mb())"
    )
    command = [sys.executable, "-c", code, str(path), str(threads)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def machine() -> dict[str, object]:
    """What a latency is worth nothing without: processor, cores, load, threads and versions."""
    return {
        "processor": processor(),
        "cores": available_cores(),
        "load": round(
            psutil.getloadavg()[0], 1
        ),  # processes that ran or waited in the last minute, this one among them
        "tensorflow_threads": tf.config.threading.get_intra_op_parallelism_threads() or "default",
        "python": versions()["python"],
        "libraries": {name: version(name) for name in LIBRARIES},
    }
