"""The figures of an evaluation, as PNG files."""

import itertools
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fem.data.dataset import Dataset
from fem.online.volume import VOLUME_BAND
from unet_fem.training.depth import by_depth, node_distance
from unet_fem.training.samples import Samples
from unet_fem.training.section import displacement_fields
from unet_fem.training.style import ALERT, save, styled, subplots

LIMIT_SHARE = 0.96  # of a normal distribution, which lies within LIMIT standard deviations
LIMIT = 2.054


def draw_all(
    folder: Path | str,
    dataset: Dataset,
    samples: Samples,
    predictions: dict[str, tuple[np.ndarray, np.ndarray]],
    gate: float = VOLUME_BAND,
) -> None:
    """Write every figure to `folder`; predictions: {model: (displacement (S, nx, ny, nz, 3) mm,
    volume (S,) mm3)}; gate: threshold of the volume loss."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    fields = {name: prediction for name, (prediction, _) in predictions.items()}
    figures = {
        "error_vs_depth": error_vs_depth(dataset, samples, fields),
        "bland_altman": bland_altman(dataset, samples, fields),
        "test_interactions": test_interactions(dataset, samples, predictions, gate),
        "fields": displacement_fields(dataset, samples, next(iter(fields.items()))),
    }
    for name, figure in figures.items():
        save(figure, folder / f"{name}.png")


def error_vs_depth(dataset: Dataset, samples: Samples, fields: dict[str, np.ndarray]) -> Figure:
    """Mean error of each model against the depth below the loaded surface, in mm and relative to
    the FEM's motion there."""
    curves = {
        name: by_depth(dataset, field, samples.displacement) for name, field in fields.items()
    }
    return depth_curves(
        curves, f"Error against depth, {len(np.unique(samples.interaction))} unseen interactions"
    )


@styled()
def depth_curves(curves: dict[str, dict], title: str) -> Figure:
    """The figure of {name: what `by_depth` gives}."""
    figure, axes = subplots(1, 2, (8.6, 4))
    for (name, curve), marker in zip(curves.items(), itertools.cycle("osv^Dx+"), strict=False):
        axes[0].plot(
            curve["depth"], curve["mean_mm"], f"{marker}-", markersize=4, linewidth=1, label=name
        )
        percent = [np.nan if value is None else 100 * value for value in curve["relative_l2"]]
        axes[1].plot(curve["depth"], percent, f"{marker}-", markersize=4, linewidth=1, label=name)
    for axis, label in zip(axes, ("mean error (mm)", "relative L2 error (%)"), strict=True):
        axis.set(
            xlabel="normalised depth (0: loaded surface, 1: bottom)", ylabel=label, ylim=(0, None)
        )
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7
    )
    figure.suptitle(title)
    return figure


@styled()
def bland_altman(dataset: Dataset, samples: Samples, fields: dict[str, np.ndarray]) -> Figure:
    """Difference of nodal displacement magnitudes against their mean, with bias and 96 % limits,
    for each model."""
    columns = len(fields) if len(fields) < 4 else -(-len(fields) // 2)
    lines = -(-len(fields) // columns)
    size = 4 * columns, 3.4 * lines
    figure, axes = subplots(lines, columns, size, sharey=True, sharex=True, squeeze=False)
    truth = node_distance(dataset, samples.displacement)
    for axis, (name, field) in zip(axes.flat, fields.items(), strict=False):
        found = node_distance(dataset, field)
        mean, difference = (truth + found) / 2, found - truth
        bias, spread = difference.mean(dtype=float), LIMIT * difference.std(dtype=float)
        shades = axis.hexbin(
            mean.ravel(), difference.ravel(), gridsize=80, bins="log", mincnt=1, cmap="viridis"
        )
        for value, style in ((bias, "-"), (bias - spread, "--"), (bias + spread, "--")):
            axis.axhline(value, color=ALERT, linestyle=style, linewidth=1)
        axis.set_title(
            f"{name}\nbias {bias:.4f} mm, {100 * LIMIT_SHARE:g} % limits ±{spread:.4f} mm", size=8
        )
        figure.colorbar(shades, ax=axis, label="nodes")
    for axis in axes.flat[len(fields) :]:
        axis.remove()
    for axis in axes[-1]:
        axis.set_xlabel("mean of FEM and prediction (mm)")
    for axis in axes[:, 0]:
        axis.set_ylabel("prediction minus FEM (mm)")
    return figure


def test_interactions(
    dataset: Dataset,
    samples: Samples,
    predictions: dict[str, tuple[np.ndarray, np.ndarray]],
    gate: float = VOLUME_BAND,
) -> Figure:
    """Largest total force and largest volume violation of every test interaction, the hard ones
    shaded."""
    numbers = np.unique(samples.interaction)

    def largest(values):
        return np.array([values[samples.interaction == number].max() for number in numbers])

    force = np.linalg.norm(samples.last_force, axis=-1).sum(axis=(1, 2, 3))
    rest = dataset.rest_volume
    violations = {"FEM": largest(np.abs(samples.volume / samples.volume[0] - 1))}
    violations |= {
        name: largest(np.abs(volume / rest - 1)) for name, (_, volume) in predictions.items()
    }
    hard = [samples.hard[samples.interaction == number].any() for number in numbers]
    return interaction_curves(numbers, numbers[hard], largest(force), violations, gate)


@styled()
def interaction_curves(
    numbers: np.ndarray,
    hard: np.ndarray,
    force: np.ndarray,
    violations: dict[str, np.ndarray],
    gate: float = VOLUME_BAND,
) -> Figure:
    """The figure of each interaction's largest total force (mN) and of {name: its largest relative
    change of volume}; hard: their numbers; gate: a line to compare with."""
    figure, axes = subplots(2, 1, (8, 5.5), sharex=True)
    axes[0].bar(numbers, force, color="slategray")
    axes[0].set_ylabel("largest total force (mN)")
    for name, violation in violations.items():
        axes[1].plot(
            numbers,
            100 * np.array(violation),
            "k.-" if name == "FEM" else ".-",
            label=name,
            linewidth=0.8,
            markersize=4,
        )
    line = {"color": ALERT, "linestyle": "--", "linewidth": 1}
    axes[1].axhline(100 * gate, **line, label=f"{100 * gate:g} % gate")
    axes[1].set(xlabel="test interaction", ylabel="largest volume violation (%)", ylim=(0, None))
    for axis in axes if len(hard) else ():
        axis.axvspan(
            min(hard) - 0.5,
            max(hard) + 0.5,
            color="#E69F00",
            alpha=0.2,
            label="harder than any in training",
        )
    axes[1].xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(
        *axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7
    )
    return figure
