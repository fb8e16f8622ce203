"""Latency of trained runs at batch 1, in every form they can be deployed in, beside the FEM.

    python tools/benchmark.py runs/<name> [runs/<other> ...] [--rounds 300] [--out docs/benchmark]

Every figure is of one process in which the variants take turns: Keras call, tf.function, each .tflite with one and two
threads (made by tools/quantize.py), and the FEM per frame of 10 ms. Prints Markdown; --out writes .md and .json.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fem.dataset import versions
from fem.errors import InputError, command_line
from fem.solver import Solver
from fem.timing import alternate, paired_ratio, processor, quantiles

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

WARM_UP = 20  # calls of each variant before the clock runs
FRAME, STEPS = 0.010, 44  # s and steps of the FEM's frame


def network_actions(settings, dataset):
    """({name: action}, {name: file or None}) of one run: each action is one displacement field from one force field."""
    import tensorflow as tf

    from unet_fem.checkpoint import load_model
    from unet_fem.data import windows
    from unet_fem.runtime import Surrogate

    lite = settings.folder / "lite"
    files = sorted(lite.glob("*.tflite"))
    if not files:
        raise InputError(f"{lite} holds no .tflite files; make them with python tools/quantize.py {settings.folder}")
    model = load_model(settings.folder / "best.keras")
    force = dataset.read("test")["force"][:1]
    window = windows(force, settings.model.window)[-1:]
    graph = tf.function(lambda x: model(x, training=False))
    actions = {
        f"{settings.name}: Keras call": lambda: np.asarray(model(window)) is None,
        f"{settings.name}: tf.function": lambda: graph(tf.constant(window)).numpy() is None,
    }
    places = {f"{settings.name}: Keras call": settings.folder / "best.keras", f"{settings.name}: tf.function": None}
    for path in files:
        for threads in (1, 2):
            surrogate, out = Surrogate(path, threads), np.empty(force.shape[2:], "float32")
            name = f"{settings.name}: {path.stem}, {threads} thread{'s' * (threads > 1)}"
            actions[name] = lambda s=surrogate, out=out: s.step(force[0, -1], out) is None
            places[name] = path
            if threads == 1:
                actions[f"{settings.name}: {path.stem}, graph alone"] = graph_alone(path)
    return actions, places


def graph_alone(path):
    """The interpreter's own work, without the window, the checks and the copies around it."""
    from ai_edge_litert.interpreter import Interpreter

    interpreter = Interpreter(str(path), num_threads=1)
    interpreter.allocate_tensors()
    return lambda: interpreter.invoke()


def soak(path, dataset, steps):
    """`steps` calls of the surrogate at `path` on a test interaction over and over: quantiles in ms, growth in MB."""
    from unet_fem.runtime import Surrogate

    surrogate = Surrogate(path)
    force = np.concatenate(list(dataset.read("test")["force"][:4]))
    out, times = np.empty(force.shape[1:], "float32"), np.empty(steps)
    first = None
    for n in tqdm(range(steps), desc=f"soaking {path}", unit="step", mininterval=2):
        start = time.perf_counter()
        surrogate.step(force[n % len(force)], out)
        times[n] = time.perf_counter() - start
        if n == steps // 100:
            first = resident_mb()
    return quantiles(1e3 * times, (50, 99, 99.9)) | {"steps": steps, "growth_MB": round(resident_mb() - first, 2)}


def resident_mb():
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def fem_actions(dataset):
    """One frame of 10 ms of the same tissue, warm-started, by explicit steps at fixed latency."""
    scene = dataset.scene
    mesh = scene.mesh.build()
    load = np.zeros((3, mesh.n_nodes))
    top = np.unique(mesh.free_faces)
    load[2, top] = -1e-3 / len(top)
    actions = {}
    for kind in ("full", "reduced"):
        solver = Solver(mesh, scene.material, kind, "float32", damping=50.0)
        actions[f"FEM, {kind} float32, {STEPS} steps"] = lambda s=solver: s.advance(FRAME, lambda t: load, steps=STEPS)
    return actions


def peak_memory(path):
    """Peak resident memory in MB of a process that loads the surrogate at `path` and steps it, TensorFlow left out."""
    code = (
        "import sys, numpy as np; from unet_fem.runtime import Surrogate; s = Surrogate(sys.argv[1]);"
        " f = np.zeros((*s.grid, 3), 'float32'); [s.step(f) for _ in range(50)];"
        " print(next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    # VmHWM, since ru_maxrss of a child starts at the size of the process that forked it
    return float(subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True).stdout) / 1024


def markdown(result):
    machine = result["machine"]
    lines = [
        f"{machine['processor']}; Python {machine['versions']['python']}, {machine['libraries']}; batch 1, warm-up {WARM_UP} calls, "
        f"{machine['rounds']} rounds in turn. Milliseconds from force array to displacement array; TensorFlow uses its default threads.",
        "",
        "| variant | p50 | p90 | p99 | worst | faster than tf.function | file MB | peak memory MB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, f in result["latency_ms"].items():
        cells = [f"{f[q]:.2f}" for q in ("p50", "p90", "p99", "worst")]
        cells += [f"{f['speed_up']:.1f}x" if "speed_up" in f else "", f"{f['MB']:.2f}" if "MB" in f else "", f"{f['memory_MB']:.0f}" if "memory_MB" in f else ""]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    for name, f in result.get("soak_ms", {}).items():
        lines += ["", f"Soak of {name}, {f['steps']:,} steps: p50 {f['p50']:.2f}, p99 {f['p99']:.2f}, p99.9 {f['p99.9']:.2f}, worst {f['worst']:.2f} ms; memory grew by {f['growth_MB']:.1f} MB."]
    lines += ["", "The paper: U-Net 22 ms, CNN-LSTM 32 ms on its CPU, FEM 10 ms (fixed)."]
    return "\n".join(lines)


def benchmark(folders, rounds, soak_steps):
    """The figures of all runs and of the FEM, as one nested dict; soak_steps > 0 also soaks the int8 file of each."""
    from unet_fem.evaluate import open_run

    runs = [open_run(folder) for folder in folders]
    actions, places = {}, {}
    for settings, dataset in runs:
        new, where = network_actions(settings, dataset)
        actions |= new
        places |= where
    actions |= fem_actions(runs[0][1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the last frame of a test interaction may leave the training range
        times = {name: 1e3 * values for name, values in alternate(actions, rounds, WARM_UP).items()}
    latency = {}
    for name, values in times.items():
        latency[name] = quantiles(values)
        base = times.get(f"{name.split(':')[0]}: tf.function")
        if base is not None:
            latency[name]["speed_up"] = paired_ratio(base, values)
        place = places.get(name)
        if place:
            latency[name]["MB"] = place.stat().st_size / 1e6
            if place.suffix == ".tflite" and "1 thread" in name:
                latency[name]["memory_MB"] = peak_memory(place)
    result = {"machine": machine(rounds), "latency_ms": latency}
    if soak_steps:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            soaks = {f"{run.name}: int8": soak(run.folder / "lite/int8.tflite", dataset, soak_steps) for run, dataset in runs}
        result["soak_ms"] = soaks
    return result


def machine(rounds):
    from importlib.metadata import version

    names = ("tensorflow", "keras", "ai-edge-litert", "numpy")
    return {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "versions": versions(),
        "libraries": ", ".join(f"{name} {version(name)}" for name in names),
        "rounds": rounds,
    }


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(prog="python tools/benchmark.py", description=__doc__.split("\n")[0])
    parser.add_argument("runs", nargs="+", type=Path, help="folders of training runs, such as runs/quick")
    parser.add_argument("--rounds", type=int, default=300, help="timings of each variant (default: 300)")
    parser.add_argument("--soak", type=int, default=0, metavar="STEPS", help="also call each int8 file this often, such as 100000")
    parser.add_argument("--out", type=Path, help="write <out>.md and <out>.json")
    options = parser.parse_args(arguments)
    if options.rounds < 1 or options.soak < 0:
        raise InputError(f"--rounds {options.rounds} must be at least 1 and --soak {options.soak} not negative")
    result = benchmark(options.runs, options.rounds, options.soak)
    text = markdown(result)
    print(text)
    if options.out:
        options.out.with_suffix(".md").write_text(f"# Latency\n\n`python tools/benchmark.py {' '.join(map(str, options.runs))}`\n\n{text}\n")
        options.out.with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
        print(f"\nwrote {options.out.with_suffix('.md')} and .json")


if __name__ == "__main__":
    main()
