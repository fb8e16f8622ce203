"""Train a modal network on a dataset and its reduced model.

    python -m fem.reduce data/wide.h5 --hard 160 --modes 320 --inputs 120 --points 300
    python tools/modal.py data/wide.h5 data/wide_reduced.npz runs/modal.tflite --hard 160

    python tools/modal.py data/tumour.h5 --judge runs/modal.tflite

runs/modal.tflite then steps with NumPy and LiteRT alone: docs/modal.md.
"""

import argparse
import os

from tqdm import tqdm

from fem.commands import command_line
from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.files import vet_output
from fem.online.reduced_model import ReducedModel
from unet_fem.runtime.modal import ModalSurrogate


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python tools/modal.py", description=__doc__.split("\n")[0]
    )
    parser.add_argument("dataset", help="HDF5 file of fem.generate")
    parser.add_argument("model", nargs="?", help="reduced model of it, a file of fem.reduce")
    parser.add_argument("out", nargs="?", help="where to write the network (.tflite)")
    parser.add_argument("--judge", help="file to judge by the test and hard interactions instead")
    parser.add_argument("--interval", type=float, help="judge at frames of so many s")
    parser.add_argument("--first", type=int, help="judge by that many of each kind")
    parser.add_argument("--hard", type=int, default=0, help="as it was for fem.reduce")
    parser.add_argument("--taught", type=int, default=6000, help="interactions of the model")
    parser.add_argument("--modes", type=int, default=120, help="of its own")
    parser.add_argument("--width", type=int, default=256, help="of the layers")
    parser.add_argument("--epochs", type=int, default=20, help="of training")
    options = parser.parse_args(arguments)
    for name in ("modes", "width", "epochs"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name} {getattr(options, name)} must be at least 1")
    if options.taught < 0:
        raise InputError(f"--taught {options.taught} must not be negative")
    dataset = open_dataset(options.dataset).for_learning()
    if options.judge:
        stepper = ModalSurrogate(options.judge)
        return show(stepper, dataset, None, options.interval, options.first)
    if not options.out:
        raise InputError("give a reduced model and a file to write to, or --judge FILE")
    model = ReducedModel.load(options.model)
    vet_output(options.out)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    from fem.reduced.build import held_out
    from unet_fem.deployment.modal import Choice, Recipe, make_modal

    choice = Choice(options.taught, options.modes, options.width)
    recipe = Recipe(options.epochs)
    stepper = make_modal(
        dataset, model, options.out, options.hard, choice, recipe, progress=answered
    )
    print("interactions held out:")
    show(stepper, dataset, held_out(dataset, options.hard))
    print(f'next: unet_fem.open_stepper("{options.out}").step(force, dt)')


def answered(numbers):
    """`numbers` with a bar."""
    return tqdm(numbers, desc="answered by the reduced model", unit="interaction")


def show(stepper, dataset, groups, interval=None, first=None):
    """Print how a stepper does."""
    from unet_fem.deployment.modal import judge_modal

    print("judged by  error %  worst %  CPU ms a frame p50   p99")
    for name, one in judge_modal(stepper, dataset, groups, interval, first).items():
        errors = f"{100 * one.error:8.2f} {100 * one.worst:8.2f}"
        print(f"{name:<9} {errors} {one.p50:19.3f} {one.p99:5.2f}")


if __name__ == "__main__":
    main()
