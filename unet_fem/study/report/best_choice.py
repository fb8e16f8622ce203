"""The figure of best choices: at every run time the answer that errs least."""

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from unet_fem.study.dataset import SUBSETS
from unet_fem.study.measure.points import LONGEST, SHORTEST, best_choices, points
from unet_fem.study.report.error_vs_time import Style, styles
from unet_fem.study.settings import Study
from unet_fem.training.style import styled, subplots

Choices = dict[float, dict[str, list[dict]]]


def choices(study: Study, results: dict) -> Choices:
    """{frame s: {"usual", "hard": see points.best_choices}}."""
    return {
        frame: {subset: best_choices(study, points(results, frame), subset) for subset in SUBSETS}
        for frame in study.fem.frames
    }


@styled()
def draw(study: Study, results: dict) -> Figure:
    """A column for each length of frame, a row for the usual interactions and one for the hard
    ones."""
    found = choices(study, results)
    every = [point for frame in study.fem.frames for point in points(results, frame)]
    style = styles(every)
    size = 5.6 * len(found), 6.4
    figure, axes = subplots(2, len(found), size, sharex=True, sharey="row", squeeze=False)
    for column, (frame, of_frame) in zip(axes.T, found.items(), strict=True):
        for axis, subset in zip(column, SUBSETS, strict=True):
            _panel(axis, of_frame[subset], style)
        column[0].set_title(f"a new force every {1e3 * frame:g} ms")
        column[-1].set_xlabel("run time a frame (ms), one thread, p50")
    for axis, subset in zip(axes[:, 0], SUBSETS, strict=True):
        axis.set_ylabel(f"least relative L2 error (%), {subset}")
    shown: dict[str, Artist] = {}
    for axis in axes.flat:
        handles, labels = axis.get_legend_handles_labels()
        shown |= dict(zip(labels, handles, strict=True))
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=3)
    figure.suptitle("Which answer is the best choice for so much time, or for such an error?")
    return figure


def _panel(axis: Axes, found: list[dict], style: dict[str, Style]):
    """Steps in the colours of families, over a band of the same for as long as each is the best."""
    for one in found:
        colour, marker = style[one["family"]]
        ends = [1e3 * one["from"], 1e3 * one["to"]]
        level = 100 * one["error"]
        axis.axvspan(*ends, color=colour, alpha=0.18, linewidth=0)
        axis.plot(ends, [level, level], color=colour, linewidth=2.5)
        axis.plot(ends[:1], [level], marker, color=colour, markersize=5, label=one["family"])
    for one, after in zip(found[:-1], found[1:], strict=True):
        step = [100 * one["error"], 100 * after["error"]]
        axis.plot([1e3 * one["to"]] * 2, step, color="gray", linewidth=0.8, zorder=1)
    if found:
        fastest = 1e3 * found[0]["from"]
        nobody = axis.axvspan(1e3 * SHORTEST, fastest, facecolor="none", edgecolor="lightgray")
        nobody.set(hatch="//", linewidth=0)
    axis.set(xscale="log", yscale="log", xlim=(1e3 * SHORTEST, 1e3 * LONGEST))
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
