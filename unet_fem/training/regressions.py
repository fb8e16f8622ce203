"""The regressions of runs: fitted in closed form, kept in their folders, read again."""

from dataclasses import replace

from fem.data.dataset import Dataset, open_dataset
from fem.online.input_field import InputField
from fem.online.regression import Regression
from unet_fem.networks.registry import Linear, Options, network, resolve
from unet_fem.training.inputs import run_input
from unet_fem.training.samples import Samples, training_samples
from unet_fem.training.settings import Settings


def fit_regression(
    dataset: Dataset,
    options: Options,
    samples: tuple[Samples, Samples] | None = None,
    field: InputField | None = None,
) -> Regression:
    """The Regression of `options` on the training split, its ridge chosen on the validation split,
    with the interval and the nodes of the dataset; the linear elastic answer, which is not fitted.

    field: of remembered forces, None for forces as they are. samples: of this field in both splits,
    read if None.
    """
    row = network(options.kind)
    if row.maker:
        made = resolve(row.maker)(dataset)
    else:
        train, validation = samples or training_samples(dataset, options.window, field)
        fitted = row.fit(train, validation, dataset.free, options)
        own = dataset.fem_mesh  # embedded in the grid it has no place there for its nodes
        made = replace(fitted, interval=dataset.scene.frames.interval, index=own.grid_index)
    return made.remembering(field.creep) if field else made


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
        field = run_input(settings, dataset)
        samples = samples or training_samples(dataset, options.window, field, settings.samples.hard)
        fit_regression(dataset, options, samples, field).save(path)
    return Regression.load(path)
