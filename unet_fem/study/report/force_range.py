"""The figure of the stability map."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from unet_fem.training.style import styled, subplots


class Map(NamedTuple):
    """What all panels share: edges of the frames in s and of the rows, and which of the cells
    (factors, frames) are known and whose forces are beyond training. Without the first frame, in
    which nothing has moved."""

    edges: np.ndarray
    rows: np.ndarray
    known: np.ndarray
    beyond: np.ndarray


@styled()
def draw(result: dict) -> Figure:
    """A panel for each competitor: colour is the error over time and force factor.

    A black line bounds what is within the tolerance, hatching marks volume out of its band, a
    dashed line forces beyond the training range. Grey: the truth has stopped in half of the
    interactions or more; black: the competitor has in one.
    """
    factors, time = result["factors"], np.array(result["time"])[1:]
    last = time[-1] + (time[-1] - time[-2]) / 2 if len(time) > 1 else 1.5 * time[-1]
    alive = np.array(result["alive"])[:, 1:]
    shared = Map(
        np.append(time - np.diff(time, prepend=0.0) / 2, last),
        np.arange(len(factors) + 1) - 0.5,
        alive > len(result["interactions"]) / 2,
        np.array(result["flag"])[:, 1:] >= 0.5,
    )
    names = [name for name in result["competitors"] if name != "truth"]
    columns = min(4, len(names))
    lines = -(-len(names) // columns)
    size = 3.2 * columns, 2.7 * lines + 0.8
    figure, axes = subplots(lines, columns, size, sharex=True, sharey=True, squeeze=False)
    for axis, name in zip(axes.flat, names, strict=False):
        found = result["competitors"][name]
        colours = _panel(axis, shared, found, result["tolerance"], result["band"])
        labels = [f"× {factor:g}" for factor in factors]
        axis.set(title=name, yticks=range(len(factors)), yticklabels=labels)
        axis.title.set_size(8)
        axis.grid(False)
    for axis in axes.flat[len(names) :]:
        axis.axis("off")
    figure.legend(handles=_marks(result), loc="outside lower center", ncols=3, fontsize=8)
    for axis in axes[:, 0]:
        axis.set_ylabel("contact force")
    for column in axes.T:
        lowest = [axis for axis in column if axis.axison][-1]
        lowest.set_xlabel("time (s)")
        lowest.tick_params(labelbottom=True)
    form = lambda x, _: f"{100 * x:g} %"  # noqa: E731
    figure.colorbar(colours, ax=axes, label="relative L2 error", format=form, shrink=0.7)
    return figure


def _panel(axis: Axes, shared: Map, found: dict, tolerance: float, band: float):
    edges, rows, known, beyond = shared
    error, volume = (np.array(found[key], float)[:, 1:] for key in ("relative_l2", "volume"))
    stopped = np.array(found["stopped"])[:, 1:] > 0
    _fill(axis, shared, ~known, "lightgray")
    colours = axis.pcolormesh(
        edges,
        rows,
        np.ma.array(error, mask=~known | np.isnan(error)),
        norm=LogNorm(0.01, 1),
        cmap="RdYlBu_r",
    )
    _fill(axis, shared, known & stopped, "black")
    bounded(axis, edges, rows, known & (error <= tolerance), colors="black", linewidths=1.8)
    bounded(axis, edges, rows, beyond, colors="navy", linewidths=1.2, linestyles="dashed")
    for i, j in np.argwhere(known & (volume > band)):
        width = edges[j + 1] - edges[j]
        cell = Rectangle((edges[j], rows[i]), width, 1, fill=False, hatch="////", linewidth=0)
        axis.add_patch(cell)
    return colours


def _fill(axis, shared, where, colour):
    cells = np.ma.array(np.ones(where.shape), mask=~where)
    axis.pcolormesh(shared.edges, shared.rows, cells, cmap=ListedColormap([colour]))


def _marks(result):
    within, band = (f"{100 * result[key]:g} %" for key in ("tolerance", "band"))
    beyond = "forces beyond training above\n(half of the interactions)"
    hatched = {"facecolor": "white", "edgecolor": "black", "hatch": "////"}
    return [
        Line2D([], [], color="black", linewidth=1.8, label=f"bounds error within {within}"),
        Line2D([], [], color="navy", linestyle="--", label=beyond),
        Patch(**hatched, label=f"volume off by more than {band}"),
        Patch(facecolor="lightgray", label="FEM truth stopped (half or more)"),
        Patch(facecolor="black", label="competitor stopped (any)"),
    ]


def bounded(axis: Axes, x: np.ndarray, y: np.ndarray, mask: np.ndarray, **style: Any) -> None:
    """Draw the boundary of the cells (rows, columns) of a grid with edges x and y where `mask`
    holds."""
    padded = np.pad(mask, 1)
    sides = [
        ((x[j], y[i]), (x[j], y[i + 1]))
        for i, j in np.argwhere(padded[1:-1, 1:] != padded[1:-1, :-1])
    ]
    sides += [
        ((x[j], y[i]), (x[j + 1], y[i]))
        for i, j in np.argwhere(padded[1:, 1:-1] != padded[:-1, 1:-1])
    ]
    axis.add_collection(LineCollection(sides, **style))
