"""Train a network on a scene's interactions, from missing data to figures.

    python -m unet_fem.train [config.toml] [key=value ...] [--resume]

Without arguments: configs/quick.toml. Everything goes to runs/<name>/. A run that was interrupted
goes on when the same command is given again.
"""

import argparse
import itertools
import os
import time
from collections.abc import Sequence

from fem.commands import command_line
from fem.errors import InputError
from fem.former import moved
from fem.lazy import callable_module
from fem.locks import lock
from unet_fem.networks.registry import network
from unet_fem.training.inputs import keep_input, run_input
from unet_fem.training.readings import read_as
from unet_fem.training.run import (
    begun,
    ensure_dataset,
    finished,
    model_file,
    prepare_folder,
    vet,
)
from unet_fem.training.samples import scales, training_samples
from unet_fem.training.settings import QUICK, Settings, load_settings
from unet_fem.training.surface import volume_surface


def train(settings: Settings, resume: bool = False) -> dict:
    """Everything that `settings` asks for, into settings.folder; an unfinished run of the same
    settings goes on. Returns the metrics of unet_fem.evaluate.

    resume: also where the run is finished, and refuse where there is none. Raises InputError before
    anything is made for a scene, dataset, network or folder that does not serve.
    """
    vet(settings, resume)
    runs, compared = [settings, *settings.others], bool(settings.beside)
    say = _stages(len(runs) + 2) if compared else lambda what: None
    say(f"data, {settings.data}")
    dataset = ensure_dataset(settings)
    for run in runs:
        say(f"{network(run.model.kind).label}, {run.folder}")
        if run is settings:
            metrics = _train(run, dataset, resume, compared)
        elif not finished(run):
            _train(run, dataset, begun(run), compared)
    if compared:
        say("comparison on unseen interactions")
        from unet_fem.deployment.comparison import compare  # brings Keras

        with lock(settings.folder):
            compare(runs, dataset)
    return metrics


def _train(settings, dataset, resume, quiet):
    """One run on its dataset; quiet: its metrics are not shown."""
    if settings.stepped:
        with lock(settings.folder):
            prepare_folder(settings, dataset, resume)
            from unet_fem.deployment.constitutive_run import train_constitutive  # brings Keras

            return train_constitutive(settings, dataset, quiet)
    field = run_input(settings, dataset)
    samples = training_samples(dataset, settings.model.window, field, settings.samples.hard)
    samples = read_as(*samples, len(dataset.time), settings.samples)
    scales(samples[0])  # refuses forces that are all zero
    volume_surface(dataset, settings.loss.volume_of)  # refuses a set that is not there
    with lock(settings.folder):
        prepare_folder(settings, dataset, resume)
        keep_input(settings, dataset, field)
        from unet_fem.training.fit import train_run  # brings Keras, no refusal has to wait for it

        return train_run(settings, dataset, samples, field, quiet)


def _stages(total):
    """say(what): prints that the next of `total` stages begins."""
    start, numbers = time.monotonic(), itertools.count(1)

    def say(what):
        spent = time.monotonic() - start
        print(f"\n[{next(numbers)}/{total}, after {spent:.0f} s] {what}", flush=True)

    return say


callable_module(__name__, train)
__getattr__ = moved("unet_fem.train")


@command_line
def main(arguments: Sequence[str] | None = None) -> dict:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m unet_fem.train", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "words", nargs="*", metavar="config.toml or key=value", help="settings; later ones win"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="also where it is finished: go on with the run of this name, or judge it again",
    )
    options = parser.parse_args(arguments)
    files = [word for word in options.words if "=" not in word]
    if len(files) > 1:
        raise InputError(f"give one configuration file, not {' and '.join(files)}")
    settings = load_settings(
        files[0] if files else QUICK, [word for word in options.words if "=" in word], print
    )
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # read when TensorFlow is imported
    try:
        metrics = train(settings, options.resume)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "finished interactions and epochs are kept; give the same command again to go on"
        ) from None
    folder = settings.folder
    print(f"\nfigures: {folder / 'figures'}   metrics: {folder / 'metrics.json'}")
    if settings.stepped or settings.fitted:
        print(f'next: unet_fem.open_stepper("{model_file(settings)}").step(force, dt)')
    else:
        print(f"curves: tensorboard --logdir {folder / 'tensorboard'}")
        print(f"next: python tools/quantize.py {folder}   (TFLite models for a CPU)")
    return metrics


if __name__ == "__main__":
    main()
