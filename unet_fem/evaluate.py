"""Judge a trained run on unseen interactions: errors, volume violation and figures.

    python -m unet_fem.evaluate runs/<name>

Writes metrics.json and figures/ into the run's folder and prints a table.
"""

import argparse
import os

from fem.commands import command_line
from unet_fem.training.judge import evaluate
from unet_fem.training.run import open_run

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python -m unet_fem.evaluate", description=__doc__.split("\n")[0]
    )
    parser.add_argument("run", help="folder of a training run, such as runs/quick")
    settings, dataset = open_run(parser.parse_args(arguments).run)
    evaluate(settings, dataset)
    print(f"\nfigures: {settings.folder / 'figures'}   metrics: {settings.folder / 'metrics.json'}")


if __name__ == "__main__":
    main()
