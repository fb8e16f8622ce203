"""The figure of a comparison: error against run time, and one unseen interaction as each answers
it."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from fem.data.dataset import Dataset
from unet_fem.training.section import draw_section
from unet_fem.training.style import COLOURS, styled

OWN = [COLOURS[i] for i in (0, 1, 4, 5, 6)]  # no two that are alike
MARKERS = {"usual": "o", "hard": "^"}


class Shown(NamedTuple):
    """One interaction: its name, time (F,) s, force (F, nx, ny, nz, 3) mN, the FEM's displacement
    and that of each answer, (F, nx, ny, nz, 3) mm."""

    name: str
    time: np.ndarray
    force: np.ndarray
    truth: np.ndarray
    answers: dict[str, np.ndarray]


@styled()
def comparison_figure(
    points: Mapping[str, tuple[float, Mapping[str, float | None]]], shown: Shown, dataset: Dataset
) -> Figure:
    """points: {label: (ms a frame, {"usual", "hard": relative L2})}."""
    figure = Figure(figsize=(11, 5.8), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.8, 1))
    above, below = parts
    axes = above.subplots(1, 2)
    colours = dict(zip(points, OWN, strict=False))
    _draw_points(axes[0], points, colours)
    frame, node = _most_moved(dataset, shown.truth)
    _draw_curves(axes[1], shown, node, colours)
    _draw_sections(below, dataset, shown, frame, node)
    return figure


def _draw_points(axis, points, colours):
    for label, (ms, errors) in points.items():
        found = {kind: 100 * error for kind, error in errors.items() if error}
        axis.plot([ms] * len(found), list(found.values()), color=colours[label], linewidth=1)
        for kind, error in found.items():
            axis.plot(ms, error, MARKERS[kind], color=colours[label], markersize=8)
        if found:
            low = min(found.values())
            axis.annotate(
                label, (ms, low), (0, -14), textcoords="offset points", ha="center", size=8
            )
    for kind in MARKERS:
        axis.plot([], [], MARKERS[kind], color="grey", label=f"{kind} interactions")
    axis.set(xscale="log", yscale="log", title="Down and to the left is better")
    axis.set(xlabel="CPU time a frame (ms)", ylabel="error on unseen interactions (%)")
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(LogLocator(subs=(1, 2, 5)))
        side.set_major_formatter(StrMethodFormatter("{x:g}"))
        side.set_minor_formatter(NullFormatter())
    axis.margins(0.25)
    axis.legend(fontsize=8, loc="center right")


def _most_moved(dataset, truth):
    """(frame, (i, j, k)) of the largest displacement of a free node."""
    size = np.where(dataset.free, np.linalg.norm(truth, axis=-1), 0)
    frame, *node = np.unravel_index(size.argmax(), size.shape)
    return int(frame), tuple(map(int, node))


def _draw_curves(axis, shown, node, colours):
    def curve(field):
        return np.linalg.norm(field[(slice(None), *node)], axis=-1)

    axis.plot(shown.time, curve(shown.truth), "k-", linewidth=3, alpha=0.3, label="FEM")
    for label, answer in shown.answers.items():
        axis.plot(shown.time, curve(answer), color=colours[label], linewidth=1.2, label=label)
    total = np.linalg.norm(shown.force.sum(axis=(1, 2, 3)), axis=-1)
    beside = axis.twinx()
    beside.fill_between(shown.time, total, color="grey", alpha=0.15, linewidth=0)
    beside.set(ylabel="force of the contacts (mN), shaded", ylim=(0, 2.2 * max(total.max(), 1e-9)))
    beside.grid(False)
    axis.set(xlabel="time (s)", ylabel="displacement of one node (mm)", ylim=(0, None))
    axis.set_title(f"{shown.name}, where the tissue moves most")
    axis.legend(fontsize=8)


def _draw_sections(figure, dataset, shown, frame, node):
    fields = {"FEM": shown.truth} | shown.answers
    axes = figure.subplots(1, len(fields), sharex=True, sharey=True, squeeze=False)[0]
    truth = shown.truth[frame]
    layers = np.unique(np.unravel_index(dataset.cells, dataset.grid)[1])
    j = int(layers[np.abs(layers - node[1]).argmin()])  # one that has cells
    limit = np.linalg.norm(truth[:, j], axis=-1).max()
    for axis, (label, field) in zip(axes, fields.items(), strict=True):
        cells = draw_section(axis, dataset, j, field[frame], field[frame], limit)
        wrong = np.linalg.norm((field[frame] - truth)[dataset.free], axis=-1)
        off = "" if label == "FEM" else f"\nup to {wrong.max():.2f} mm off"
        axis.set_title(label + off, size=9)
        axis.set_xlabel("across (mm)")
    axes[0].set_ylabel("up (mm)")
    figure.colorbar(cells, ax=axes, label="displacement (mm)", shrink=0.6)
