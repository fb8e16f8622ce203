"""Latency of trained runs at batch 1, in every form they can be deployed in, beside the FEM.

    python tools/benchmark.py runs/<name> [runs/<other> ...] [--rounds 300] [--out docs/benchmark]

Every figure is of one process in which the variants take turns: Keras call, tf.function, each .tflite with one and two
threads (made by tools/quantize.py), and the FEM per frame of 10 ms. Prints Markdown; --out writes .md and .json.
"""

import argparse
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np

from fem.dataset import versions
from fem.errors import InputError, command_line
from fem.material import Material
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
                actions[f"{settings.name}: {path.stem}, graph alone"] = lambda s=surrogate: s.invoke()
    return actions, places


def fem_actions(dataset):
    """One frame of 10 ms of the same tissue, warm-started, by explicit steps at fixed latency."""
    scene = dataset.scene
    mesh = scene.mesh.build()
    tissue = Material(scene.material.mu, scene.material.nu, scene.material.density, scene.material.prony)
    load = np.zeros((3, mesh.n_nodes))
    top = np.unique(mesh.free_faces)
    load[2, top] = -1e-3 / len(top)
    actions = {}
    for kind in ("full", "reduced"):
        solver = Solver(mesh, tissue, kind, "float32", damping=50.0)
        actions[f"FEM, {kind} float32, {STEPS} steps"] = lambda s=solver: s.advance(FRAME, lambda t: load, steps=STEPS)
    return actions


def peak_memory(path, dataset):
    """Peak resident memory in MB of a process that loads the surrogate at `path` and steps it, TensorFlow left out."""
    code = (
        "import resource, sys, numpy as np; from unet_fem.runtime import Surrogate; s = Surrogate(sys.argv[1]);"
        " f = np.zeros((*s.grid, 3), 'float32'); [s.step(f) for _ in range(50)];"
        " print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    return float(subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True).stdout)


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
    lines += ["", "The paper: U-Net 22 ms, CNN-LSTM 32 ms on its CPU, FEM 10 ms (fixed)."]
    return "\n".join(lines)


def benchmark(folders, rounds):
    """The figures of all runs and of the FEM, as one nested dict."""
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
                latency[name]["memory_MB"] = peak_memory(place, runs[0][1])
    return {"machine": machine(rounds), "latency_ms": latency}


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
    parser.add_argument("--out", type=Path, help="write <out>.md and <out>.json")
    options = parser.parse_args(arguments)
    if options.rounds < 1:
        raise InputError(f"--rounds {options.rounds} must be at least 1")
    result = benchmark(options.runs, options.rounds)
    text = markdown(result)
    print(text)
    if options.out:
        options.out.with_suffix(".md").write_text(f"# Latency\n\n`python tools/benchmark.py {' '.join(map(str, options.runs))}`\n\n{text}\n")
        options.out.with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
        print(f"\nwrote {options.out.with_suffix('.md')} and .json")


if __name__ == "__main__":
    main()
