"""Make a reduced model of a dataset: modes, points and a fit, in one file that steps in real time.

    python -m fem.reduce data/tumour.h5 [--out data/tumour_reduced.npz] [--modes 240] [--inputs 120]
        [--points 200] [--hard 0]

`--hard N` learns from the first N interactions of the split "hard" too and judges by the rest.

    python -m fem.reduce data/tumour.h5 --judge data/wide_reduced.npz

judges a model by the test and the hard interactions of a dataset. `--interval 0.01 --first 8`: by
the first eight of each at frames of 10 ms.
"""

import argparse
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from tqdm import tqdm

from fem.commands import command_line
from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.files import vet_output
from fem.locks import lock
from fem.online.reduced import ReducedStepper
from fem.online.reduced_model import ReducedModel
from fem.ranges import checked
from fem.reduced.assemble import material_digest
from fem.reduced.build import Choice, default_path, reduce, tested
from fem.reduced.judge import judge


@command_line
def main(arguments: Sequence[str] | None = None) -> None:
    """Reduce a dataset, as the words of a command line ask."""
    options = _options(arguments)
    choice = Choice(options.modes, options.inputs, options.points, options.hard, seed=options.seed)
    if options.interval is not None and not 0 < options.interval < math.inf:
        raise InputError(f"--interval {options.interval} s must be positive and finite")
    if options.first is not None:
        checked("--first", options.first, 1, 1_000_000, whole=True)
    dataset = open_dataset(options.data).for_learning()
    if options.judge:
        model = ReducedModel.load(options.judge)
        model.check(dataset.mesh_digest, material_digest(dataset.material))
        _show(
            {
                name: judge(
                    ReducedStepper(model), dataset, which[: options.first], options.interval
                )
                for name, which in tested(dataset).items()
            }
        )
        return
    out = options.out or default_path(dataset)
    if out.suffix != ".npz":
        raise InputError(f"--out {out} must end in .npz")
    if vet_output(out).is_file():
        raise InputError(f"{out} exists already; delete it to make it again, or give another --out")

    def progress(which: Iterable) -> Iterable:
        return tqdm(which, "reading", unit=" interactions", disable=None)

    with lock(out):
        model, verdicts = reduce(dataset, choice, print, progress)
        model.save(out)
    size = f"{out.stat().st_size / 1e6:.1f} MB"
    print(f"wrote {out} ({size}): {model.modes} modes, {model.points} points")
    _show(verdicts)
    print(f'next: unet_fem.open_stepper("{out}").step(force, dt), force in mN, dt in s')


def _show(verdicts):
    """Print how a model does."""
    print("judged by   error %   worst %   evaluations   CPU ms a frame p50   p99")
    for name, one in verdicts.items():
        print(
            f"{name:<9} {100 * one.error:9.2f} {100 * one.worst:9.2f} {one.evaluations:13.1f}"
            f" {one.p50:20.2f} {one.p99:5.2f}"
        )


def _options(arguments):
    parser = argparse.ArgumentParser(
        prog="python -m fem.reduce", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("data", help="dataset, such as data/tumour.h5")
    parser.add_argument("--out", type=Path, help="file to write (default: <data>_reduced.npz)")
    parser.add_argument(
        "--modes",
        type=float,
        default=Choice.modes,
        help="modes of the answer: how many, or below 1 what they may leave out, relative L2",
    )
    parser.add_argument("--inputs", type=int, default=Choice.inputs, help="modes that points see")
    parser.add_argument("--points", type=int, default=Choice.points, help="material points")
    parser.add_argument(
        "--hard", type=int, default=Choice.hard, help='interactions of "hard" to learn from too'
    )
    parser.add_argument("--judge", type=Path, help="model to judge by this dataset; makes none")
    parser.add_argument("--first", type=int, help="judge by that many of each kind")
    parser.add_argument(
        "--interval",
        type=float,
        help="judge at frames of so many s, against the quasi-static solver (default: the data's)",
    )
    parser.add_argument("--seed", type=int, default=Choice.seed, help="of the draws")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
