"""python -m unet_fem.runtime model.tflite data.h5: replay an interaction, and tell how well the
rate is kept."""

import argparse
from collections.abc import Sequence

import numpy as np

from fem.commands import command_line
from unet_fem.runtime.replay import read_interaction, replay, report
from unet_fem.runtime.surrogate import Surrogate


@command_line
def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m unet_fem.runtime", description="Replay an interaction at a fixed rate."
    )
    parser.add_argument("model", help="surrogate, such as runs/quick/lite/int8.tflite")
    parser.add_argument("dataset", help="HDF5 file of fem.generate")
    parser.add_argument(
        "--interaction", type=int, help="number of the test interaction (default: the first)"
    )
    parser.add_argument(
        "--rate",
        type=float,
        nargs="+",
        default=[100.0, 1000.0],
        help="calls a second (default: 100 1000)",
    )
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    number, times, force, truth = read_interaction(options.dataset, options.interaction)
    print(
        f"{options.model}, test interaction {number}: {times[-1]:g} s, {options.threads} thread(s)"
    )
    for rate in options.rate:
        timing = replay(Surrogate(options.model, options.threads, rate), force, times)
        print(report(timing, rate))
    error = np.linalg.norm(timing["displacement"] - truth) / np.linalg.norm(truth)
    print(f"relative error against the FEM at the {len(times)} frames: {100 * error:.1f} %")


if __name__ == "__main__":
    main()
