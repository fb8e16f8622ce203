"""Judge a constitutive network by the test and hard interactions of a dataset, effort by effort.

    python tools/constitutive.py data/paper.h5 runs/constitutive/lite/float32.tflite

`--interval 0.01 --first 8`: by the first eight of each at frames of 10 ms, against the quasi-static
solver. The network is made by python -m unet_fem.train configs/constitutive.toml: docs/method.md.
"""

import argparse
import os
from pathlib import Path

from fem.commands import command_line
from fem.data.dataset import open_dataset
from fem.ranges import checked
from unet_fem.runtime.constitutive import read_constitutive


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/constitutive.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("dataset", help="HDF5 file of fem.generate")
    parser.add_argument("file", type=Path, help="such as runs/quick/lite/float32.tflite")
    parser.add_argument("--interval", type=float, help="judge at frames of so many s")
    parser.add_argument("--first", type=int, help="judge by that many of each kind")
    options = parser.parse_args(arguments)
    if options.interval is not None:
        checked("--interval", options.interval, 1e-5, 1e5, "s")
    if options.first is not None:
        checked("--first", options.first, 1, 1_000_000, whole=True)
    dataset = open_dataset(options.dataset).for_learning()
    read_constitutive(options.file)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    from unet_fem.deployment.constitutive import judge_efforts, judge_guard

    found = judge_efforts(options.file, dataset, options.interval, options.first)
    print("effort        judged by  error %  worst %  evaluations  CPU ms a frame p50   p99")
    for (share, most), verdicts in found.items():
        for name, one in verdicts.items():
            print(
                f"{share:5g}, {most}      {name:<9} {100 * one.error:8.2f} {100 * one.worst:8.2f}"
                f" {one.evaluations:12.2f} {one.p50:19.2f} {one.p99:5.2f}"
            )
    if options.interval is None:
        print("\neffort        judged by  in the bound  flagged  above 5 % and silent, % of frames")
        for (share, most), kinds in judge_guard(options.file, dataset).items():
            for name, one in kinds.items():
                shares = "".join(f"{100 * share:11.2f}" for share in one)
                print(f"{share:5g}, {most:<2}     {name:<9} {shares}")


if __name__ == "__main__":
    main()
