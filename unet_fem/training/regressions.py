"""The regressions of runs: fitted in closed form, kept in their folders, read again."""

from dataclasses import replace

from fem.data.dataset import Dataset, open_dataset
from fem.online.regression import Regression
from unet_fem.networks.registry import Linear, Options, network
from unet_fem.training.samples import Samples, training_samples
from unet_fem.training.settings import Settings


def fit_regression(
    dataset: Dataset, options: Options, samples: tuple[Samples, Samples] | None = None
) -> Regression:
    """The Regression of `options` on the training split, its ridge chosen on the validation split,
    with the interval and the nodes of the dataset.

    samples: those of both splits, read if None.
    """
    train, validation = samples or training_samples(dataset, options.window)
    fitted = network(options.kind).fit(train, validation, dataset.free, options)
    own = dataset.fem_mesh  # embedded in the grid it has no place there for its nodes
    return replace(fitted, interval=dataset.scene.frames.interval, index=own.grid_index)


def linear_regression(
    settings: Settings,
    dataset: Dataset | None = None,
    samples: tuple[Samples, Samples] | None = None,
) -> Regression:
    """The linear regression on the window of a run, to compare with it; fitted where the run's
    folder has none, as in runs made before 0.2.

    dataset, samples: of the run, opened and read if None.
    """
    path = settings.folder / "linear.npz"
    if not path.is_file():
        options = Linear(steps=settings.model.window or 1)
        dataset = dataset or open_dataset(settings.data).for_learning()
        fit_regression(dataset, options, samples).save(path)
    return Regression.load(path)
