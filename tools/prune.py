"""Make a trained network smaller, by zeros or by whole filters, fine-tune it, and measure what that
gives.

    python tools/prune.py runs/<name> [--filters] [--sparsity 0.5 0.8] [--epochs 10]

Without --filters: magnitude pruning of the convolutions (TensorFlow Model Optimization), the
paper's study. With it: the least filters (U-Net) or units (CNN-LSTM) are removed. Each result is a
run of its own, runs/<name>_pruned50 or runs/<name>_thin50, for every other tool to work on. Its
figures go to pruning.json there.
"""

import argparse
import json
import os
from pathlib import Path

from fem.commands import command_line
from fem.errors import InputError
from fem.files import write_text
from unet_fem.deployment.exported import model_file
from unet_fem.training.run import locked_run


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/prune.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("run", type=Path, help="folder of a training run, such as runs/quick")
    parser.add_argument(
        "--filters",
        action="store_true",
        help="remove whole filters or units instead of single weights",
    )
    parser.add_argument(
        "--sparsity",
        type=float,
        nargs="+",
        default=[0.5, 0.8],
        help="shares to remove (default: 0.5 0.8)",
    )
    parser.add_argument("--epochs", type=int, default=10, help="of fine-tuning (default: 10)")
    parser.add_argument(
        "--learning-rate",
        type=float,
        default=3e-4,
        help="of fine-tuning, falling to zero (default: 3e-4)",
    )
    parser.add_argument(
        "--rounds", type=int, default=200, help="paired timings of each (default: 200)"
    )
    options = parser.parse_args(arguments)
    if not all(0 < s < 1 for s in options.sparsity) or options.epochs < 1 or options.rounds < 1:
        raise InputError(
            f"--sparsity {options.sparsity} must lie between 0 and 1,"
            " --epochs and --rounds be at least 1"
        )
    if len({f"{100 * share:.0f}" for share in options.sparsity}) < len(options.sparsity):
        raise InputError(
            f"--sparsity {options.sparsity}: two give one run, named in whole percents"
        )
    with locked_run(options.run) as (settings, dataset):
        model_file(settings)
        # all is vetted: now TensorFlow may be imported, which takes seconds
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        from unet_fem.deployment.smaller_runs import compare, smaller_run, table

        small = [
            smaller_run(
                settings, dataset, share, options.filters, options.epochs, options.learning_rate
            )
            for share in options.sparsity
        ]
        figures = compare([settings, *small], dataset, options.rounds)
        written = settings.folder / f"pruning_{'filters' if options.filters else 'weights'}.json"
        write_text(written, json.dumps(figures, indent=1))
    print(f"\n{table(figures)}\n\nwrote {written}")
    print(f"next: python tools/benchmark.py {' '.join(str(s.folder) for s in [settings, *small])}")


if __name__ == "__main__":
    main()
