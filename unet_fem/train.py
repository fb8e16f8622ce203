"""Train a network on a scene's interactions, from missing data to figures.

    python -m unet_fem.train [config.toml] [key=value ...] [--resume]

Without arguments: configs/quick.toml. Everything goes to runs/<name>/.
"""

import argparse
import os

from fem.commands import command_line
from fem.errors import InputError
from unet_fem.training import settings as config
from unet_fem.training.fit import train

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python -m unet_fem.train", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "words", nargs="*", metavar="config.toml or key=value", help="settings; later ones win"
    )
    parser.add_argument("--resume", action="store_true", help="go on with the run of this name")
    options = parser.parse_args(arguments)
    files = [word for word in options.words if "=" not in word]
    if len(files) > 1:
        raise InputError(f"give one configuration file, not {' and '.join(files)}")
    settings = config.load_settings(
        files[0] if files else config.QUICK, [w for w in options.words if "=" in w]
    )
    metrics = train(settings, options.resume)
    folder = settings.folder
    print(
        f"\nfigures: {folder / 'figures'}   metrics: {folder / 'metrics.json'}   curves: tensorboard --logdir {folder / 'tensorboard'}"
    )
    print(f"next: python tools/quantize.py {folder}   (TFLite models for a CPU)")
    return metrics


if __name__ == "__main__":
    main()
