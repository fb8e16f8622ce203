"""Latency of trained runs at batch 1, in every form they can be deployed in, beside the FEM.

    python tools/benchmark.py runs/<name> [runs/<other> ...] [--beside reduced.npz network.tflite]
    [--threads 1] [--rounds 300] [--out docs/benchmark]

Every figure is of one process in which the variants take turns, all with the same number of
threads: Keras call, tf.function, each .tflite (made by tools/quantize.py), the FEM per frame of 10
ms, and the files of other answers, such as the reduced solver and the constitutive network. Prints
Markdown; --out writes .md and .json.
"""

import argparse
import json
import os
from pathlib import Path

from fem.commands import command_line
from fem.errors import InputError
from fem.files import vet_stem, write_text
from unet_fem.deployment.exported import lite_files, model_file
from unet_fem.training.run import open_run


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/benchmark.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "runs", nargs="+", type=Path, help="folders of training runs, such as runs/quick"
    )
    parser.add_argument(
        "--beside",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help="also time these files of answers, such as data/wide_reduced.npz",
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
            f"--rounds {options.rounds} and --threads {options.threads} must be at least 1"
            f" and --soak {options.soak} not negative"
        )
    out = vet_stem(options.out, ".md", ".json") if options.out is not None else None
    runs = [open_run(folder) for folder in options.runs]
    for settings, _ in runs:
        model_file(settings)
        if "int8" not in lite_files(settings) and options.soak:
            raise InputError(
                f"{settings.folder} has no int8.tflite to soak; make it with"
                f" python tools/quantize.py {settings.folder}, or leave --soak out"
            )
    for path in options.beside:
        if not path.is_file():
            raise InputError(f"--beside {path} is no file; make it, or leave it out")
    # all is vetted: now TensorFlow may be imported, which takes seconds
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    from unet_fem.deployment.benchmark import benchmark, markdown

    result = benchmark(runs, options.threads, options.rounds, options.soak, options.beside)
    text = markdown(result)
    print(text)
    if out:
        folders = " ".join(map(str, options.runs))
        if options.beside:
            folders += " --beside " + " ".join(map(str, options.beside))
        command = (
            f"python tools/benchmark.py {folders}"
            f" --threads {options.threads} --rounds {options.rounds}"
        )
        md, js = out
        write_text(md, f"# Latency\n\n`{command}`\n\n{text}\n")
        write_text(js, json.dumps(result, indent=1) + "\n")
        print(f"\nwrote {md} and .json")


if __name__ == "__main__":
    main()
