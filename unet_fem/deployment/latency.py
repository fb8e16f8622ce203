"""What is timed when a run's latency is measured: {name: action} for fem.measure.timing.alternate,
all with the same threads.

Every action answers one force array with one displacement array at batch 1, as a control loop would
call it.
"""

import os
import subprocess
import sys
from importlib.metadata import version

import numpy as np
from threadpoolctl import threadpool_limits

from fem.errors import InputError
from fem.measure.machine import processor, versions
from fem.solver.explicit import Solver

FRAME = 0.010  # s, of the FEM
LIBRARIES = ("tensorflow", "keras", "ai-edge-litert", "numpy", "scipy")


def use_threads(threads):
    """Hold TensorFlow and the BLAS of this process to `threads` threads; LiteRT is told by each
    interpreter.

    Raises InputError where TensorFlow has run already, for then it keeps the threads that it has.
    """
    import tensorflow as tf

    try:
        tf.config.threading.set_intra_op_parallelism_threads(threads)
        tf.config.threading.set_inter_op_parallelism_threads(threads)
    except RuntimeError:
        raise InputError(
            f"TensorFlow has run in this process before it was held to {threads} thread(s); measure in a process of its own"
        ) from None
    threadpool_limits(threads)


def network_actions(settings, dataset, threads=1):
    """{"Keras call": action, "tf.function": action, "float32": action, ...}: the forms of one run,
    each .tflite by its name.

    Each answers the last frame of the first test interaction. threads: of LiteRT; TensorFlow's are
    set by `use_threads`. Raises InputError for a run without .tflite files.
    """
    import tensorflow as tf

    from unet_fem.training.checkpoint import load_model
    from unet_fem.training.samples import windows

    files = lite_files(settings)
    model = load_model(settings.folder / "best.keras")
    force = dataset.read("test")["force"][:1]
    window = windows(force, settings.model.window)[-1:]
    graph = tf.function(lambda x: model(x, training=False))
    actions = {
        "Keras call": lambda: np.asarray(model(window)) is None,
        "tf.function": lambda: graph(tf.constant(window)).numpy() is None,
    }
    return actions | {
        name: surrogate_action(path, force[0, -1], threads) for name, path in files.items()
    }


def lite_files(settings):
    """{variant: path} of a run's .tflite files. Raises InputError if there are none."""
    files = sorted((settings.folder / "lite").glob("*.tflite"))
    if not files:
        raise InputError(
            f"{settings.folder / 'lite'} holds no .tflite files; make them with python tools/quantize.py {settings.folder}"
        )
    return {path.stem: path for path in files}


def surrogate_action(path, force, threads=1):
    """One step of the surrogate at `path` under force (nx, ny, nz, 3) mN, with its window and its
    checks."""
    from unet_fem.runtime.surrogate import Surrogate

    surrogate, out = Surrogate(path, threads), np.empty(force.shape, "float32")
    return lambda: surrogate.step(force, out=out) is None


def graph_action(path, threads=1):
    """The interpreter's own work on the surrogate at `path`, without the window, the checks and the
    copies around it."""
    from ai_edge_litert.interpreter import Interpreter

    interpreter = Interpreter(str(path), num_threads=threads)
    interpreter.allocate_tensors()
    return lambda: interpreter.invoke()


def fem_action(dataset, kind):
    """FRAME seconds of the dataset's tissue in float32 elements of `kind`, at its stable step and
    true mass, from the state before."""
    scene = dataset.scene
    mesh = scene.mesh.build()
    load = np.zeros((3, mesh.n_nodes))
    top = np.unique(mesh.free_faces)
    load[2, top] = -1e-3 / len(top)
    solver = Solver(mesh, scene.material, kind, "float32", damping=50.0)
    return lambda: solver.advance(FRAME, lambda t: load)


def peak_memory(path, threads=1):
    """Peak resident memory in MB of a process that loads the surrogate at `path` and steps it,
    TensorFlow left out."""
    code = (
        "import sys, numpy as np; from unet_fem.runtime import Surrogate; s = Surrogate(sys.argv[1], int(sys.argv[2]));"
        " f = np.zeros((*s.grid, 3), 'float32'); [s.step(f) for _ in range(50)];"
        " print(next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    # VmHWM, since ru_maxrss of a child starts at the size of the process that forked it
    command = [sys.executable, "-c", code, str(path), str(threads)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout) / 1024


def machine():
    """What a latency is worth nothing without: processor, cores, load, threads and versions."""
    import tensorflow as tf

    return {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "load": round(
            os.getloadavg()[0], 1
        ),  # processes that ran or waited in the last minute, this one among them
        "tensorflow_threads": tf.config.threading.get_intra_op_parallelism_threads() or "default",
        "python": versions()["python"],
        "libraries": {name: version(name) for name in LIBRARIES},
    }
