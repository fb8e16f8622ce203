"""The headline figure: error against run time of every competitor."""

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from unet_fem.study.dataset import SUBSETS
from unet_fem.study.measure.points import pareto, points
from unet_fem.study.settings import Study
from unet_fem.training.style import ALERT, styled, subplots

QUESTION = "Which answer follows the FEM of this mesh best in so much time?"
RATES = {"1 kHz": 1e-3, "100 Hz": 1e-2, "30 Hz": 1 / 30}  # s a frame
PALETTES = {  # kind of a competitor: (colour, marker) of its families, in order
    "FEM": (
        ("#0072B2", "D"),
        ("#56B4E9", "v"),
        ("#5D5D5D", "*"),
        ("#003B5C", "s"),
        ("#A9A9A9", "P"),
        ("#7A9CC6", "h"),
    ),
    "regression": (
        ("#E69F00", "s"),
        ("#8C6D1F", "P"),
        ("#C9A227", "p"),
        ("#5C4A1F", "d"),
        ("#FFD166", "H"),
        ("#B06500", "v"),
    ),
    "network": (
        ("#D55E00", "^"),
        ("#9E3D00", "o"),
        ("#F28E5B", "X"),
        ("#6B2A00", "h"),
        ("#FFB68A", "<"),
    ),
    "answer": (("#CC79A7", "X"), ("#7B3F7D", "h"), ("#4B0055", ">"), ("#E3B7D3", "8")),
}
Style = tuple[str, str]


@styled()
def draw(study: Study, results: dict) -> Figure:
    """A column for each length of frame, a row for the usual interactions and one for the hard
    ones."""
    columns = {frame: points(results, frame) for frame in study.fem.frames}
    style = styles([point for found in columns.values() for point in found])
    size = 6 * len(columns), 9.5
    figure, axes = subplots(2, len(columns), size, sharex=True, sharey="row", squeeze=False)
    refined = results["reference"].get("refined")
    tissue = refined["tissue"][refined["element"]]["relative_l2"] if refined else None
    for column, (frame, found) in enumerate(columns.items()):
        for row, subset in enumerate(SUBSETS):
            _panel(axes[row, column], found, subset, style)
            _marks(axes[row, column], study.paper_latency, tissue)
        axes[0, column].set_title(f"a new force every {1e3 * frame:g} ms", pad=24)
        axes[1, column].set_xlabel("run time a frame (ms), one thread, p50")
    stopped = set(results["reference"]["stopped"])
    for axis, (name, cases) in zip(
        axes[:, 0], results["reference"]["subsets"].items(), strict=True
    ):
        count = len(set(cases) - stopped)
        axis.set_ylabel(f"relative L2 error (%), {count} {name} interactions")
    shown: dict[str, Artist] = {}
    for axis in axes.flat:
        handles, labels = axis.get_legend_handles_labels()
        shown |= dict(zip(labels, handles, strict=True))
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=3)
    figure.suptitle(QUESTION)
    return figure


def styles(found: list[dict]) -> dict[str, Style]:
    """{family: (colour, marker)} of points: each kind's palette in the order in which its families
    come, and from its start again where they are more. Drawn in this order: the networks with the
    first, the paper's best, on top."""
    chosen: dict[str, Style] = {}
    for kind, palette in PALETTES.items():
        families = list(dict.fromkeys(p["family"] for p in found if p["kind"] == kind))
        own = [(family, palette[n % len(palette)]) for n, family in enumerate(families)]
        chosen |= dict(reversed(own) if kind == "network" else own)
    return chosen


def learned_from(point: dict) -> str:
    """What a competitor has learned from, in words; "" for one that does not learn."""
    if not point["interactions"]:
        return ""
    return f"{point['interactions']:,} interactions{', hard ones too' * point['hard_in_training']}"


def _panel(axis: Axes, found: list[dict], subset: str, style: dict[str, Style]):
    """Filled: no training, or with hard forces in it; hollow: learned from usual forces alone."""
    known = [p for p in found if p[subset] is not None]
    for family, (colour, marker) in style.items():
        for taught in dict.fromkeys(learned_from(p) for p in known if p["family"] == family):
            mine = [p for p in known if (p["family"], learned_from(p)) == (family, taught)]
            mine.sort(key=lambda p: p["seconds"])
            hollow = bool(taught) and not mine[0]["hard_in_training"]
            axis.plot(
                [1e3 * p["seconds"] for p in mine],
                [100 * p[subset] for p in mine],
                marker,
                color=colour,
                markerfacecolor="white" if hollow else colour,
                label=f"{family} ({taught})" if taught else family,
                markersize=5,
                alpha=0.85,
                linestyle="-" if mine[0]["kind"] == "FEM" else "",
                linewidth=0.6,
            )
            for p in mine:
                own = p["errors"][subset]
                if own["low"] is not None:
                    ends = [100 * own["low"], 100 * own["high"]]
                    axis.plot([1e3 * p["seconds"]] * 2, ends, color=colour, alpha=0.3, linewidth=1)
    front = pareto(known, subset)
    axis.step(
        [1e3 * p["seconds"] for p in front],
        [100 * p[subset] for p in front],
        where="post",
        color=ALERT,
        linewidth=1.2,
        label="no other is better in both",
        zorder=0,
    )
    highest = 600 * max((p[subset] for p in known), default=1)  # room for the names above
    axis.set(xscale="log", yscale="log", ylim=(None, highest))
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _marks(axis: Axes, paper_latency: dict[str, float], tissue: float | None):
    """Rates that are asked for, the paper's latencies, and the distance of this mesh to the
    tissue's yardstick."""
    for name, seconds in RATES.items():
        axis.axvline(1e3 * seconds, color="gray", linestyle=":", linewidth=1)
        axis.annotate(
            name,
            (1e3 * seconds, 1),
            xycoords=("data", "axes fraction"),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color="gray",
        )
    for name, seconds in paper_latency.items():
        axis.plot(
            1e3 * seconds,
            1,
            "v",
            color=ALERT,
            transform=axis.get_xaxis_transform(),
            clip_on=False,
            markersize=5,
        )
        axis.annotate(
            f"paper's {name}",
            (1e3 * seconds, 1),
            xycoords=("data", "axes fraction"),
            xytext=(2, -4),
            textcoords="offset points",
            fontsize=6,
            rotation=-90,
            va="top",
            color=ALERT,
        )
    if tissue:
        axis.axhspan(
            axis.get_ylim()[0],
            100 * tissue,
            color="gray",
            alpha=0.12,
            label="nearer to the reference than that is to the tissue's yardstick",
        )
