"""Errors and volume violation of trained networks on unseen interactions."""

import json

import numpy as np

from fem.errors import InputError

COLUMNS = {  # key in metrics.json: (heading, format)
    "relative_l2": ("relative L2 %", lambda x: f"{100 * x:.1f}"),
    "mean_mm": ("mean mm", "{:.4f}".format),
    "p95_mm": ("p95 mm", "{:.3f}".format),
    "worst_mm": ("worst mm", "{:.2f}".format),
    "volume_violation_mean": ("volume % mean", lambda x: f"{100 * x:.2f}"),
    "volume_violation_max": ("max", lambda x: f"{100 * x:.2f}"),
}


def error_metrics(prediction, samples, dataset, volume):
    """Errors of `prediction` (S, nx, ny, nz, 3) mm against the FEM over the free nodes, and the
    violation of volume.

    volume: (S,) mm3 of the mesh displaced by the prediction. relative_l2 is sqrt(sum |error|^2 /
    sum |u|^2) over all samples and nodes; mean, p95 (95th percentile) and worst are of the nodes'
    distances to the FEM.
    """
    error = np.linalg.norm((prediction - samples.displacement)[:, dataset.free], axis=-1)  # (S, n)
    truth = np.linalg.norm(samples.displacement[:, dataset.free], axis=-1)
    violation = np.abs(volume / rest_volume(dataset) - 1)
    return {
        "relative_l2": float(
            np.sqrt(np.sum(error**2, dtype=float) / np.sum(truth**2, dtype=float))
        ),
        "mean_mm": float(error.mean(dtype=float)),
        "p95_mm": float(np.percentile(error, 95)),
        "worst_mm": float(error.max()),
        "volume_violation_mean": float(violation.mean()),
        "volume_violation_max": float(violation.max()),
    }


def rest_volume(dataset):
    return dataset.rest_volume


def predict(model, samples, dataset):
    """(displacement (S, nx, ny, nz, 3) mm, volume (S,) mm3) that `model` gives. Raises InputError
    if it is not finite."""
    from unet_fem.training.losses import deformed_volume

    if tuple(model.input_shape[1:]) != samples.force.shape[1:]:
        raise InputError(
            f"the model takes force windows {tuple(model.input_shape[1:])}, the dataset gives {samples.force.shape[1:]}:"
            " it was trained on another grid or window; train again"
        )
    prediction = np.concatenate(
        [np.asarray(model(samples.force[i : i + 32])) for i in range(0, len(samples), 32)]
    )
    if not np.isfinite(prediction).all():
        raise InputError(
            "the model's prediction is not finite; its training has diverged: lower train.learning_rate"
        )
    return prediction, np.asarray(deformed_volume(prediction, *dataset.surface), float)


def evaluate(settings, dataset):
    """Metrics of the run's best model and of its linear regression, written to its folder with the
    figures."""
    from fem.files import write_text
    from unet_fem.training import figures
    from unet_fem.training.checkpoint import load_model
    from unet_fem.training.extremes import extremes_table, judge_extremes
    from unet_fem.training.samples import load_samples

    folder = settings.folder
    models = {
        settings.model.kind: load_model(folder / "best.keras"),
        "linear regression": load_model(folder / "linear.keras"),
    }
    parts = {
        split: load_samples(dataset, split, settings.model.window)
        for split in ("validation", "test")
    }
    metrics = {name: {} for name in (*models, "FEM")}
    test_predictions = {}
    for split, samples in parts.items():
        print(f"evaluating {len(samples)} {split} samples", flush=True)
        for name, model in models.items():
            prediction, volume = predict(model, samples, dataset)
            metrics[name][split] = error_metrics(prediction, samples, dataset, volume)
            if split == "test":
                hard = samples.hard
                metrics[name]["hard"] = error_metrics(
                    prediction[hard], samples.select(hard), dataset, volume[hard]
                )
                test_predictions[name] = prediction, volume
        for which, rows in (
            (split, slice(None)),
            *((("hard", samples.hard),) if split == "test" else ()),
        ):
            violation = np.abs(
                samples.volume[rows] / samples.volume[0] - 1
            )  # the first sample is at rest
            metrics["FEM"][which] = {
                "volume_violation_mean": float(violation.mean()),
                "volume_violation_max": float(violation.max()),
            }
    metrics["extremes"] = judge_extremes(models, dataset, settings.model.window)
    write_text(folder / "metrics.json", json.dumps(metrics, indent=1))
    figures.draw_all(folder / "figures", dataset, parts["test"], test_predictions)
    print(table(metrics, dataset))
    print(extremes_table(metrics["extremes"], models))
    return metrics


def table(metrics, dataset):
    """The metrics as text, a block for each split."""
    counts = {
        "validation": (dataset.split == "validation").sum(),
        "test": (dataset.split == "test").sum(),
        "hard": dataset.hard.sum(),
    }
    lines = []
    rows = {name: splits for name, splits in metrics.items() if name != "extremes"}
    for split, count in counts.items():
        lines += [
            "",
            f"{split} ({count} interactions)"
            + "".join(f"  {heading}" for heading, _ in COLUMNS.values()),
        ]
        pad = len(f"{split} ({count} interactions)")
        for name, splits in rows.items():
            cells = [
                form(splits[split][key]) if key in splits[split] else "-"
                for key, (_, form) in COLUMNS.items()
            ]
            row = "".join(
                f"  {cell:>{len(heading)}}" for cell, (heading, _) in zip(cells, COLUMNS.values())
            )
            lines.append(name.ljust(pad) + row)
    return "\n".join(lines)
