"""The headline figure: error against run time of every competitor."""

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from unet_fem.study.measure.points import pareto, points
from unet_fem.study.settings import Study
from unet_fem.training.style import styled, subplots

RATES = {"1 kHz": 1e-3, "100 Hz": 1e-2, "30 Hz": 1 / 30}  # s a frame
PALETTES = {  # kind of a learned competitor: (colour, marker) of its families, in order
    "regression": (("black", "s"), ("dimgray", "P"), ("tab:red", "p")),
    "network": (
        ("tab:orange", "^"),
        ("tab:blue", "o"),
        ("tab:purple", "X"),
        ("tab:brown", "h"),
        ("tab:pink", "<"),
    ),
}
FEM = {
    "FEM, full": ("tab:green", "D"),
    "FEM, reduced": ("tab:olive", "v"),
    "FEM, coarse": ("tab:cyan", "*"),
}
Style = tuple[str, str]


@styled()
def draw(study: Study, results: dict) -> Figure:
    """A column for each length of frame, a row for the test interactions and one for the hard
    ones."""
    columns = {frame: points(results, frame) for frame in study.fem.frames}
    style = styles([point for found in columns.values() for point in found])
    size = 6 * len(columns), 9
    figure, axes = subplots(2, len(columns), size, sharex=True, sharey="row", squeeze=False)
    own_error = results["reference"].get("refined", {}).get("relative_l2")
    for column, (frame, found) in enumerate(columns.items()):
        for row, split in enumerate(("test", "hard")):
            _panel(axes[row, column], found, split, style)
            _marks(axes[row, column], study.paper_latency, own_error)
        axes[0, column].set_title(f"a new force every {1e3 * frame:g} ms", pad=24)
        axes[1, column].set_xlabel("run time a frame (ms), one thread, p50")
    judged = set(results["reference"]["numbers"])
    rows = {"test": study.fem.interactions, "hard": results["reference"]["hard_numbers"]}
    for axis, (name, numbers) in zip(axes[:, 0], rows.items(), strict=True):
        count = len(judged.intersection(numbers))
        axis.set_ylabel(f"relative L2 error (%), {count} {name} interactions")
    shown: dict[str, Artist] = {}
    for axis in axes.flat:
        handles, labels = axis.get_legend_handles_labels()
        shown |= dict(zip(labels, handles, strict=True))
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=4)
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
    shown = {point["family"] for point in found}
    return chosen | {family: style for family, style in FEM.items() if family in shown}


def _panel(axis: Axes, found: list[dict], split: str, style: dict[str, Style]):
    for family, (colour, marker) in style.items():
        mine = sorted((p for p in found if p["family"] == family), key=lambda p: p["seconds"])
        if not mine:
            continue
        axis.plot(
            [1e3 * p["seconds"] for p in mine],
            [100 * p[split] for p in mine],
            marker,
            color=colour,
            label=family,
            markersize=5,
            alpha=0.8,
            linestyle="-" if mine[0]["kind"] == "FEM" else "",
            linewidth=0.6,
        )
    front = pareto(found, split)
    axis.step(
        [1e3 * p["seconds"] for p in front],
        [100 * p[split] for p in front],
        where="post",
        color="crimson",
        linewidth=1.2,
        label="no other is better in both",
        zorder=0,
    )
    highest = 600 * max(p[split] for p in found)  # room for the names above
    axis.set(xscale="log", yscale="log", ylim=(None, highest))
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _marks(axis: Axes, paper_latency: dict[str, float], own_error: float | None):
    """Rates that are asked for, the paper's latencies, and the reference's own error."""
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
            color="crimson",
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
            color="crimson",
        )
    if own_error:
        axis.axhspan(
            axis.get_ylim()[0],
            100 * own_error,
            color="gray",
            alpha=0.12,
            label="below the reference's own distance to a refined mesh",
        )
