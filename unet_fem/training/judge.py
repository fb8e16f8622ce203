"""Errors and volume violation of trained models on unseen interactions."""

import json
import warnings
from dataclasses import dataclass

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.files import write_text
from fem.online.regression import Regression
from fem.online.stepper import Stepper
from unet_fem.metrics import relative_l2_of_sums
from unet_fem.networks.files import load_model
from unet_fem.networks.registry import Elastic, Linear, Model, network, resolve
from unet_fem.training import figures
from unet_fem.training.extremes import extremes_table, judge_extremes
from unet_fem.training.inputs import keep_input, run_input
from unet_fem.training.losses import deformed_volume
from unet_fem.training.regressions import linear_regression
from unet_fem.training.run import model_file
from unet_fem.training.samples import Samples, load_samples
from unet_fem.training.settings import Settings

BATCH = 32  # samples that are predicted at once
HARD_SET = "hard set"  # the split "hard" in metrics.json, where "hard" are those of the tests
COLUMNS = {  # key in metrics.json: (heading, format)
    "relative_l2": ("relative L2 %", lambda x: f"{100 * x:.1f}"),
    "mean_mm": ("mean mm", "{:.4f}".format),
    "p95_mm": ("p95 mm", "{:.3f}".format),
    "worst_mm": ("worst mm", "{:.2f}".format),
    "volume_violation_mean": ("volume % mean", lambda x: f"{100 * x:.2f}"),
    "volume_violation_max": ("max", lambda x: f"{100 * x:.2f}"),
}


def error_metrics(
    prediction: np.ndarray, samples: Samples, dataset: Dataset, volume: np.ndarray
) -> dict[str, float | None]:
    """Errors of `prediction` (S, nx, ny, nz, 3) mm against the FEM over the free nodes, and the
    violation of volume.

    volume: (S,) mm3 of the mesh displaced by the prediction. relative_l2 is sqrt(sum |error|^2 /
    sum |u|^2) over all samples and nodes; mean, p95 (95th percentile) and worst are of the nodes'
    distances to the FEM.
    """
    error = np.linalg.norm((prediction - samples.displacement)[:, dataset.free], axis=-1)  # (S, n)
    truth = np.linalg.norm(samples.displacement[:, dataset.free], axis=-1)
    sums = (np.sum(values**2, dtype=float) for values in (error, truth))
    return {
        "relative_l2": relative_l2_of_sums(*sums),
        "mean_mm": float(error.mean(dtype=float)),
        "p95_mm": float(np.percentile(error, 95)),
        "worst_mm": float(error.max()),
    } | volume_violations(volume, rest_volume(dataset))


def volume_violations(volume: np.ndarray, rest: float) -> dict[str, float]:
    """Mean and largest relative change of `volume` (S,) from `rest`."""
    violation = np.abs(volume / rest - 1)
    return {
        "volume_violation_mean": float(violation.mean()),
        "volume_violation_max": float(violation.max()),
    }


def rest_volume(dataset: Dataset) -> float:
    """Of the mesh of the grid, mm3."""
    return dataset.rest_volume


def predict(model: Model, samples: Samples, dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """(displacement (S, nx, ny, nz, 3) mm, volume (S,) mm3) that `model` gives. Raises InputError
    if it is not finite."""
    takes = tuple(model.input_shape[1:])
    if takes != samples.input.shape[1:]:
        raise InputError(
            f"the model takes force windows {takes}, the dataset gives {samples.input.shape[1:]}:"
            " it was trained on another grid or window; train again"
        )
    fields, volumes = [], []
    batch = model.batch if isinstance(model, Followed) else BATCH
    for start in range(0, len(samples), batch):
        field = np.asarray(model(samples.input[start : start + batch]))
        if not np.isfinite(field).all():
            raise InputError(
                "the model's prediction is not finite; its training has diverged:"
                " lower train.learning_rate"
            )
        fields.append(field)
        volumes.append(np.asarray(deformed_volume(field, *dataset.surface), float))
    return np.concatenate(fields), np.concatenate(volumes)


@dataclass(frozen=True, eq=False)
class Followed:
    """As a model: what a stepper answers to an interaction, frame by frame from rest.

    interval: s between frames; batch: frames of an interaction, all of which it is given at once.
    """

    stepper: Stepper
    interval: float
    batch: int
    input_shape: tuple[int | None, ...]

    def __call__(self, force: np.ndarray) -> np.ndarray:
        """(F, nx, ny, nz, 3) mm of (F, nx, ny, nz, 3) mN."""
        self.stepper.reset()
        dt = self.interval if self.stepper.interval is None else None
        with warnings.catch_warnings():  # the truth stands beside it
            warnings.simplefilter("ignore", RuntimeWarning)
            return np.stack([self.stepper.step(frame, dt) for frame in force])


@dataclass(frozen=True)
class LastFrame:
    """As a model: the last frame of its input, which is the elastic answer where that is seen."""

    input_shape: tuple[int | None, ...]

    def __call__(self, force: np.ndarray) -> np.ndarray:
        """(S, nx, ny, nz, 3) of (S, [T,] nx, ny, nz, 3)."""
        return force if force.ndim == 5 else force[:, -1]


def competitors(settings: Settings, dataset: Dataset) -> dict[str, Model]:
    """{name: model}: what the run has made, and the linear regression on the same window, or the
    elastic answer that a network corrects; a stepper alone."""
    kind = settings.model.kind
    if opens := network(kind).stepper:
        stepper = resolve(opens)(model_file(settings))
        frames = dataset.scene.frames
        shape = (None, *dataset.grid, 3)
        return {kind: Followed(stepper, frames.interval, frames.count, shape)}
    models: dict[str, Model] = {
        kind: (Regression.load if settings.fitted else load_model)(model_file(settings))
    }
    if settings.input.physics == "elastic":
        models["elastic answer"] = LastFrame(models[kind].input_shape)
    elif kind not in (Linear.kind, Elastic.kind):
        models["linear regression"] = linear_regression(settings, dataset)
    return models


def evaluate(settings: Settings, dataset: Dataset, quiet: bool = False) -> dict:
    """Metrics of the run's best model and of its linear regression, written to its folder with the
    figures, and printed unless `quiet`."""
    models, window = competitors(settings, dataset), settings.model.window
    seen = run_input(settings, dataset)
    keep_input(settings, dataset, seen)
    metrics: dict[str, dict] = {name: {} for name in (*models, "FEM")}
    numbers: dict[str, np.ndarray | None] = {"validation": None, "test": None}
    if (unseen := _hard_set(settings, dataset)).size:
        numbers["hard"] = unseen
    for split, some in numbers.items():
        samples = load_samples(dataset, split, window, seen, some)
        print(f"evaluating {len(samples)} {split} samples", flush=True)
        predictions = {name: predict(model, samples, dataset) for name, model in models.items()}
        parts: dict[str, slice | np.ndarray] = {HARD_SET if split == "hard" else split: slice(None)}
        if split == "test" and samples.hard.any():
            parts["hard"] = samples.hard
        for part, rows in parts.items():
            chosen = samples.select(rows)
            for name, (field, volume) in predictions.items():
                metrics[name][part] = error_metrics(field[rows], chosen, dataset, volume[rows])
            at_rest = samples.volume[0]  # the first sample is at rest
            metrics["FEM"][part] = volume_violations(chosen.volume, at_rest)
        if split == "test":
            gate = settings.loss.volume_threshold
            figures.draw_all(settings.folder / "figures", dataset, samples, predictions, gate)
    metrics["extremes"] = judge_extremes(models, dataset, window, seen)
    write_text(settings.folder / "metrics.json", json.dumps(metrics, indent=1))
    if not quiet:
        print(table(metrics, dataset, settings.samples.hard))
        print(extremes_table(metrics["extremes"], models))
    return metrics


def _hard_set(settings, dataset):
    """The numbers of the split "hard" that are not learned from, maybe none."""
    numbers = dataset.number[dataset.split == "hard"]
    return numbers[numbers > settings.samples.hard]


def table(metrics: dict, dataset: Dataset, hard: int = 0) -> str:
    """The metrics as text, a block for each split and one for the hard ones of the tests; hard:
    interactions of the split "hard" that were learned from."""
    counts = {
        "validation": (dataset.split == "validation").sum(),
        "test": (dataset.split == "test").sum(),
        "hard": (dataset.hard & (dataset.split == "test")).sum(),
        HARD_SET: (dataset.split == "hard").sum() - hard,
    }
    rows = {name: splits for name, splits in metrics.items() if name != "extremes"}
    lines = []
    for split, count in counts.items():
        if not count:
            continue
        title = f"{split} ({count} interactions)"
        headings = "".join(f"  {heading}" for heading, _ in COLUMNS.values())
        lines += ["", title + headings]
        for name, splits in rows.items():
            row = "".join(
                f"  {form(splits[split][key]) if key in splits[split] else '-':>{len(heading)}}"
                for key, (heading, form) in COLUMNS.items()
            )
            lines.append(name.ljust(len(title)) + row)
    return "\n".join(lines)
