"""Train the paper's networks, small ones, on four inputs, and compare them with what they add to.

    python tools/ablation.py [key=value ...] [--seeds 1 2 3] [--out docs/ablation]

The inputs: the last forces, or the forces as creeping tissue remembers them (input.memory), either
as they are or as the linear elastic answer to them (input.physics). Prints Markdown and writes it
as .md, and the numbers as .json. What was interrupted goes on when the same command is given again.
"""

import argparse
import os
from pathlib import Path

from fem.commands import command_line
from fem.errors import InputError

EPOCHS = "train.epochs=10"
NETWORKS = ["cnn_lstm", "unet"]


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/ablation.py", description=__doc__.split("\n\n")[0]
    )
    parser.add_argument(
        "changes", nargs="*", metavar="key=value", help=f"for all networks, after {EPOCHS}"
    )
    parser.add_argument(
        "--seeds", type=int, nargs="*", default=[1, 2, 3], help="none for the baselines alone"
    )
    parser.add_argument("--networks", nargs="+", choices=NETWORKS, default=NETWORKS)
    parser.add_argument("--threads", type=int, default=1, help="of TensorFlow (default: 1)")
    parser.add_argument("--out", type=Path, default=Path("docs/ablation"))
    options = parser.parse_args(arguments)
    if options.threads < 1 or min(options.seeds, default=0) < 0:
        raise InputError(
            f"--threads {options.threads} must be at least 1, and --seeds {options.seeds} not"
            " negative"
        )
    if wrong := [word for word in options.changes if "=" not in word]:
        raise InputError(f"'{wrong[0]}' is no key=value")

    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    from unet_fem.deployment.latency import use_threads
    from unet_fem.study.measure import ablation

    use_threads(options.threads)
    rows = ablation.ablation(options.seeds, options.networks, [EPOCHS, *options.changes])
    print(ablation.table(rows))
    words = ["python tools/ablation.py", *options.changes, "--seeds", *map(str, options.seeds)]
    if options.networks != NETWORKS:
        words += ["--networks", *options.networks]
    ablation.write(rows, options.out, " ".join(words))
    print(f"wrote {options.out.with_suffix('.md')} and .json")


if __name__ == "__main__":
    main()
