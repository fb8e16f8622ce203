"""The regressions of runs: fitted in closed form, kept in their folders, read again."""

from dataclasses import replace
from pathlib import Path

from fem.data.dataset import Dataset, open_dataset
from fem.online.regression import Regression
from unet_fem.networks.registry import Linear, Options, network
from unet_fem.training.samples import load_samples
from unet_fem.training.settings import Settings


def fit_regression(dataset: Dataset, options: Options) -> Regression:
    """The Regression of `options` on the training split, its ridge chosen on the validation split,
    with the interval and the nodes of the dataset."""
    train, validation = (
        load_samples(dataset, split, options.window) for split in ("train", "validation")
    )
    fitted = network(options.kind).fit(train, validation, dataset.free, options)
    own = dataset.fem_mesh  # embedded in the grid it has no place there for its nodes
    return replace(fitted, interval=dataset.scene.frames.interval, index=own.grid_index)


def regression_of(settings: Settings) -> Regression:
    """The regression that a run of such a kind is."""
    return Regression.load(regression_file(settings))


def regression_file(settings: Settings) -> Path:
    """Where it lies."""
    return settings.folder / "regression.npz"


def linear_regression(settings: Settings) -> Regression:
    """The linear regression on the window of a run, to compare with it; fitted where the run's
    folder has none, as in runs made before 0.2."""
    path = settings.folder / "linear.npz"
    if not path.is_file():
        options = Linear(steps=settings.model.window or 1)
        fit_regression(open_dataset(settings.data), options).save(path)
    return Regression.load(path)
