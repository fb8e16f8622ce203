"""Latency of trained runs at batch 1, in every form they can be deployed in, beside the FEM.

    python tools/benchmark.py runs/<name> [runs/<other> ...] [--threads 1] [--rounds 300] [--out
    docs/benchmark]

Every figure is of one process in which the variants take turns, all with the same number of
threads: Keras call, tf.function, each .tflite (made by tools/quantize.py), and the FEM per frame of
10 ms. Prints Markdown; --out writes .md and .json.
"""

import argparse
import json
import os
import resource
import time
import warnings
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fem.commands import command_line
from fem.errors import InputError
from fem.measure.timing import alternate, paired_ratio, quantiles

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

WARM_UP = 20  # calls of each variant before the clock runs


def soak(path, dataset, steps, threads):
    """`steps` calls of the surrogate at `path` on a test interaction over and over: quantiles in
    ms, growth in MB."""
    from unet_fem.runtime.surrogate import Surrogate

    surrogate = Surrogate(path, threads)
    force = np.concatenate(list(dataset.read("test")["force"][:4]))
    out, times = np.empty(force.shape[1:], "float32"), np.empty(steps)
    first = None
    for n in tqdm(range(steps), desc=f"soaking {path}", unit="step", mininterval=2):
        start = time.perf_counter()
        surrogate.step(force[n % len(force)], out=out)
        times[n] = time.perf_counter() - start
        if n == steps // 100:
            first = resident_mb()
    return quantiles(1e3 * times, (50, 99, 99.9)) | {
        "steps": steps,
        "growth_MB": round(resident_mb() - first, 2),
    }


def resident_mb():
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def markdown(result):
    machine = result["machine"]
    libraries = ", ".join(f"{name} {number}" for name, number in machine["libraries"].items())
    threads = f"{result['threads']} thread{'s' * (result['threads'] > 1)}"
    lines = [
        f"{machine['processor']}, {threads} for every variant (TensorFlow, LiteRT and the FEM), load {machine['load']:g} on {machine['cores']} cores; "
        f"Python {machine['python']}, {libraries}; batch 1, warm-up {WARM_UP} calls, {result['rounds']} rounds in turn. "
        "Milliseconds from force array to displacement array.",
        "",
        "| variant | p50 | p90 | p99 | worst | faster than tf.function | file MB | peak memory MB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, f in result["latency_ms"].items():
        cells = [f"{f[q]:.2f}" for q in ("p50", "p90", "p99", "worst")]
        cells += [
            f"{f['speed_up']:.1f}x" if "speed_up" in f else "",
            f"{f['MB']:.2f}" if "MB" in f else "",
            f"{f['memory_MB']:.0f}" if "memory_MB" in f else "",
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    for name, f in result.get("soak_ms", {}).items():
        lines += [
            "",
            f"Soak of {name}, {f['steps']:,} steps: p50 {f['p50']:.2f}, p99 {f['p99']:.2f}, p99.9 {f['p99.9']:.2f}, worst {f['worst']:.2f} ms; memory grew by {f['growth_MB']:.1f} MB.",
        ]
    lines += ["", "The paper: U-Net 22 ms, CNN-LSTM 32 ms on its CPU, FEM 10 ms (fixed)."]
    return "\n".join(lines)


def benchmark(folders, threads, rounds, soak_steps):
    """The figures of all runs and of the FEM, as one nested dict; soak_steps > 0 also soaks the
    int8 file of each."""
    from unet_fem.deployment import latency
    from unet_fem.training.run import open_run

    latency.use_threads(threads)
    runs = [open_run(folder) for folder in folders]
    actions, files = {}, {}
    for settings, dataset in runs:
        for variant, action in latency.network_actions(settings, dataset, threads).items():
            actions[settings.name, variant] = action
        for variant, path in latency.lite_files(settings).items():
            files[settings.name, variant] = path
            actions[settings.name, f"{variant}, graph alone"] = latency.graph_action(path, threads)
    for kind in ("full", "reduced"):
        actions["FEM", f"{kind} float32, 10 ms"] = latency.fem_action(runs[0][1], kind)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RuntimeWarning
        )  # the last frame of a test interaction may leave the training range
        times = {name: 1e3 * values for name, values in alternate(actions, rounds, WARM_UP).items()}
        soaks = {
            f"{run.name}: int8": soak(run.folder / "lite/int8.tflite", dataset, soak_steps, threads)
            for run, dataset in runs
            if soak_steps
        }
    table = {}
    for (run, variant), values in times.items():
        table[f"{run}: {variant}"] = figures = quantiles(values)
        if (run, "tf.function") in times:
            figures["speed_up"] = paired_ratio(times[run, "tf.function"], values)
        if (run, variant) in files:
            figures["MB"] = files[run, variant].stat().st_size / 1e6
            figures["memory_MB"] = latency.peak_memory(files[run, variant], threads)
    result = {
        "machine": latency.machine(),
        "threads": threads,
        "rounds": rounds,
        "latency_ms": table,
    }
    return result | ({"soak_ms": soaks} if soaks else {})


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/benchmark.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "runs", nargs="+", type=Path, help="folders of training runs, such as runs/quick"
    )
    parser.add_argument("--threads", type=int, default=1, help="of every variant (default: 1)")
    parser.add_argument(
        "--rounds", type=int, default=300, help="timings of each variant (default: 300)"
    )
    parser.add_argument(
        "--soak",
        type=int,
        default=0,
        metavar="STEPS",
        help="also call each int8 file this often, such as 100000",
    )
    parser.add_argument("--out", type=Path, help="write <out>.md and <out>.json")
    options = parser.parse_args(arguments)
    if options.rounds < 1 or options.threads < 1 or options.soak < 0:
        raise InputError(
            f"--rounds {options.rounds} and --threads {options.threads} must be at least 1 and --soak {options.soak} not negative"
        )
    result = benchmark(options.runs, options.threads, options.rounds, options.soak)
    text = markdown(result)
    print(text)
    if options.out:
        command = f"python tools/benchmark.py {' '.join(map(str, options.runs))} --threads {options.threads} --rounds {options.rounds}"
        options.out.with_suffix(".md").write_text(f"# Latency\n\n`{command}`\n\n{text}\n")
        options.out.with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
        print(f"\nwrote {options.out.with_suffix('.md')} and .json")


if __name__ == "__main__":
    main()
