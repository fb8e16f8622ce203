"""Judge a trained run on unseen interactions: errors, volume violation and figures.

    python -m unet_fem.evaluate runs/<name>

Writes metrics.json and figures/ into the run's folder and prints a table.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from fem.commands import command_line
from fem.errors import InputError
from fem.former import moved
from fem.lazy import callable_module
from unet_fem.training.run import locked_run, model_file


def evaluate(folder: Path | str) -> dict:
    """Metrics of the run in `folder`, written there with the figures. Raises InputError if it is no
    run, does not fit its dataset, or another command writes to it."""
    with locked_run(folder) as (settings, dataset):
        if not (made := model_file(settings)).is_file():
            raise InputError(f"no model {made}; finish the run with python -m unet_fem.train")
        from unet_fem.training import judge  # brings Keras, which no refusal has to wait for

        return judge.evaluate(settings, dataset)


callable_module(__name__, evaluate)
__getattr__ = moved("unet_fem.evaluate")


@command_line
def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m unet_fem.evaluate", description=__doc__.split("\n")[0]
    )
    parser.add_argument("run", help="folder of a training run, such as runs/quick")
    folder = Path(parser.parse_args(arguments).run)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    evaluate(folder)
    print(f"\nfigures: {folder / 'figures'}   metrics: {folder / 'metrics.json'}")


if __name__ == "__main__":
    main()
