"""Train a constitutive network on a dataset and its reduced model, and export it.

    python -m fem.reduce data/wide.h5 --hard 160
    python tools/constitutive.py data/wide.h5 data/wide_reduced.npz runs/constitutive --hard 160

    python tools/constitutive.py data/tumour.h5 --judge runs/constitutive/float32.tflite

runs/constitutive/float32.tflite then steps with NumPy and LiteRT alone: docs/method.md.
"""

import argparse
import os
from pathlib import Path

from fem.commands import command_line
from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.files import vet_output
from fem.locks import lock
from fem.online.reduced_model import ReducedModel
from fem.ranges import checked
from unet_fem.runtime.constitutive import read_constitutive


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/constitutive.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("dataset", help="HDF5 file of fem.generate")
    parser.add_argument("model", nargs="?", help="reduced model of it, a file of fem.reduce")
    parser.add_argument("folder", nargs="?", type=Path, help="where to write; made if missing")
    parser.add_argument("--judge", help="file to judge by the test and hard interactions instead")
    parser.add_argument("--interval", type=float, help="judge at frames of so many s")
    parser.add_argument("--first", type=int, help="judge by that many of each kind")
    parser.add_argument("--hard", type=int, default=0, help="as it was for fem.reduce")
    parser.add_argument("--coarse", type=int, default=40, help="points a side that N sees")
    parser.add_argument("--steps", type=int, default=300, help="of training; 0: the fit alone")
    options = parser.parse_args(arguments)
    if options.coarse < 1 or options.steps < 0:
        raise InputError(
            f"--coarse {options.coarse} must be at least 1 and --steps {options.steps} not negative"
        )
    if options.first is not None:
        checked("--first", options.first, 1, 1_000_000, whole=True)
    if options.interval is not None:
        checked("--interval", options.interval, 1e-9, 1e9, "s")
    checked("--hard", options.hard, 0, 1_000_000, whole=True)
    dataset = open_dataset(options.dataset).for_learning()
    if options.judge:
        return show(options.judge, dataset, options.interval, options.first)
    if not options.folder:
        raise InputError("give a reduced model and a folder to write to, or --judge FILE")
    model = ReducedModel.load(options.model)
    vet_output(options.folder, folder=True)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    from unet_fem.deployment.constitutive import make_network
    from unet_fem.training.constitutive import Recipe

    recipe = Recipe(options.steps) if options.steps else None
    with lock(options.folder):
        files = make_network(dataset, model, options.folder, options.hard, options.coarse, recipe)
    for path in files.values():
        print(f"wrote {path} ({path.stat().st_size / 1e6:.1f} MB)")
    print(f'next: unet_fem.open_stepper("{files["float32"]}").step(force, dt)')


def show(path, dataset, interval, first):
    """Print how a file does, effort by effort."""
    read_constitutive(path)
    from unet_fem.deployment.constitutive import judge_efforts

    print("effort        judged by  error %  worst %  evaluations  CPU ms a frame p50   p99")
    for (share, most), verdicts in judge_efforts(path, dataset, interval, first).items():
        for name, one in verdicts.items():
            print(
                f"{share:5g}, {most}      {name:<9} {100 * one.error:8.2f} {100 * one.worst:8.2f}"
                f" {one.evaluations:12.2f} {one.p50:19.2f} {one.p99:5.2f}"
            )


if __name__ == "__main__":
    main()
