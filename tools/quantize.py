"""Export a trained run to TensorFlow Lite in four variants and measure what each costs.

    python tools/quantize.py runs/<name> [--windows 64] [--margin 1.5] [--layers]

Writes lite/{float32,float16,dynamic,int8}.tflite and quantization.json into the run's folder; the
files are for unet_fem.runtime.Surrogate. Each is audited: only builtin operators, and int8 where
its name promises it.
"""

import argparse
import os

from fem.commands import command_line
from fem.errors import InputError
from unet_fem.deployment.exported import model_file
from unet_fem.training.run import locked_run


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/quantize.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("run", help="folder of a training run, such as runs/quick")
    parser.add_argument(
        "--windows", type=int, default=64, help="training windows that calibrate int8 (default: 64)"
    )
    parser.add_argument(
        "--margin",
        type=float,
        default=1.5,
        help="how far beyond the strongest int8 reaches (default: 1.5 x)",
    )
    parser.add_argument(
        "--layers", action="store_true", help="also print what each layer's output loses"
    )
    options = parser.parse_args(arguments)
    if options.windows < 2 or not options.margin >= 1:
        raise InputError(
            f"--windows {options.windows} must be at least 2"
            f" and --margin {options.margin:g} at least 1"
        )
    with locked_run(options.run) as (settings, dataset):
        model_file(settings)
        # all is vetted: now TensorFlow may be imported, which takes seconds
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        from unet_fem.deployment.quantize import quantize

        out = quantize(settings, dataset, options.windows, options.margin, options.layers)
    print(f"\nfiles: {out}   next: python -m unet_fem.runtime {out / 'int8.tflite'} <dataset>.h5")


if __name__ == "__main__":
    main()
