"""The latency of trained runs in every form that they can be deployed in, beside the FEM, as one
table."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fem.data.dataset import Dataset
from fem.measure.timing import paired_ratio, quantiles
from unet_fem.deployment.answers import muted
from unet_fem.deployment.exported import lite_file, lite_files
from unet_fem.deployment.forms import GRAPH, forms
from unet_fem.deployment.latency import (
    FRAME,
    WARM_UP,
    fem_action,
    graph_action,
    machine,
    peak_memory,
    time_steppers,
    use_threads,
)
from unet_fem.deployment.process import resident_mb
from unet_fem.runtime.surrogate import Surrogate
from unet_fem.steppers import open_stepper
from unet_fem.training.settings import Settings

Run = tuple[Settings, Dataset]
ANSWERS = "beside"  # stands in the place of a run before other answers' files


def benchmark(
    runs: Sequence[Run],
    threads: int,
    rounds: int,
    soak_steps: int = 0,
    answers: Sequence[Path] = (),
) -> dict:
    """The figures of all runs, and of the FEM on the first one's tissue, as one nested dict.

    Every form of a run answers the last frame of the first test interaction. answers: files of
    other steppers, which answer all frames of that of the first run, at 10 ms where they take any
    interval. soak_steps > 0 also soaks the int8 file of each run. Raises InputError for a file that
    is no stepper or one of another mesh.
    """
    use_threads(threads)
    steppers, forces, beside, files = {}, {}, {}, {}
    for settings, dataset in runs:
        force = dataset.read("test", ("force",), [1])["force"][0, -1:]
        for form, make in forms(settings, dataset, threads).items():
            steppers[settings.name, form], forces[settings.name, form] = make(), force
        for variant, path in lite_files(settings).items():
            files[settings.name, variant] = path
            beside[settings.name, f"{variant}, graph alone"] = graph_action(path, threads)
    for path in answers:
        name = ANSWERS, path.name
        options = {"threads": threads} if path.suffix == ".tflite" else {}
        steppers[name], files[name] = open_stepper(path, **options), path
        forces[name] = runs[0][1].read("test", ("force",), [1])["force"][0]
        steppers[name].step(forces[name][0], FRAME if steppers[name].interval is None else None)
    for kind in ("full", "reduced"):
        beside["FEM", f"{kind} float32, 10 ms"] = fem_action(runs[0][1], kind)
    times = time_steppers(steppers, forces, rounds, beside=beside)
    result = {
        "machine": machine(),
        "threads": threads,
        "rounds": rounds,
        "latency_ms": _rows(times, files, threads),
    }
    if soak_steps:
        result["soak_ms"] = {
            f"{settings.name}: int8": soak(
                lite_file(settings, "int8"), dataset, soak_steps, threads
            )
            for settings, dataset in runs
        }
    return result


def _rows(times, files, threads):
    """{"run: form": its figures in ms and MB}."""
    rows, order = {}, list(dict.fromkeys(run for run, _ in times))
    for (run, form), seconds in sorted(times.items(), key=lambda item: order.index(item[0][0])):
        rows[f"{run}: {form}"] = figures = quantiles(1e3 * seconds)
        if (run, GRAPH) in times:
            figures["speed_up"] = paired_ratio(times[run, GRAPH], seconds)
        if (run, form) in files:
            figures["MB"] = files[run, form].stat().st_size / 1e6
        if (run, form) in files and run != ANSWERS:
            figures["memory_MB"] = peak_memory(files[run, form], threads)
    return rows


def soak(path: Path, dataset: Dataset, steps: int, threads: int) -> dict:
    """`steps` calls of the surrogate at `path` on test interactions over and over: quantiles in ms,
    growth in MB."""
    surrogate = Surrogate(path, threads)
    first = dataset.number[dataset.split == "test"][:4]
    force = np.concatenate(list(dataset.read("test", ("force",), first)["force"]))
    out, times = np.empty(force.shape[1:], "float32"), np.empty(steps)
    first = resident_mb()
    with muted():
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


def markdown(result: dict) -> str:
    """The result of `benchmark` in Markdown."""
    machine = result["machine"]
    libraries = ", ".join(f"{name} {number}" for name, number in machine["libraries"].items())
    threads = f"{result['threads']} thread{'s' * (result['threads'] > 1)}"
    lines = [
        f"{machine['processor']}, {threads} for every variant (TensorFlow, LiteRT and the FEM),"
        f" load {machine['load']:g} on {machine['cores']} cores;"
        f" Python {machine['python']}, {libraries};"
        f" batch 1, warm-up {WARM_UP} calls, {result['rounds']} rounds in turn."
        " Milliseconds from force array to displacement array.",
        "",
        "| variant | p50 | p90 | p99 | worst | faster than tf.function | file MB"
        " | peak memory MB |",
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
            f"Soak of {name}, {f['steps']:,} steps: p50 {f['p50']:.2f}, p99 {f['p99']:.2f},"
            f" p99.9 {f['p99.9']:.2f}, worst {f['worst']:.2f} ms;"
            f" memory grew by {f['growth_MB']:.1f} MB.",
        ]
    lines += ["", "The paper: U-Net 22 ms, CNN-LSTM 32 ms on its CPU, FEM 10 ms (fixed)."]
    return "\n".join(lines)
