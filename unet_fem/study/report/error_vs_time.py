"""Error against run time: the points of every competitor, which of them no other beats, what they
cost, and the figure."""

import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter

from unet_fem.study.measure.points import pareto, points
from unet_fem.training import figures  # noqa: F401, its style

RATES = {"1 kHz": 1e-3, "100 Hz": 1e-2, "30 Hz": 1 / 30}  # s a frame
PAPER = {"U-Net": 22e-3, "CNN-LSTM": 32e-3, "FEM": 10e-3}  # s, the paper's latencies on its CPU
STYLES = {  # family: colour, marker
    "linear": ("black", "s"),
    "POD": ("dimgray", "P"),
    "POD + quadratic": ("tab:red", "p"),
    "U-Net": ("tab:blue", "o"),
    "CNN-LSTM": ("tab:orange", "^"),
    "FEM, full": ("tab:green", "D"),
    "FEM, reduced": ("tab:olive", "v"),
    "FEM, coarse": ("tab:cyan", "*"),
}
OTHER = ("tab:purple", "X")


def draw(study, results):
    """The headline figure: a column for each length of frame, a row for the test interactions and
    one for the hard ones."""
    figure, axes = plt.subplots(
        2,
        len(study.fem.frames),
        figsize=(6 * len(study.fem.frames), 9),
        sharex=True,
        sharey="row",
        squeeze=False,
        layout="constrained",
    )
    own_error = results["reference"].get("refined", {}).get("relative_l2")
    for column, frame in enumerate(study.fem.frames):
        found = points(results, frame)
        for row, split in enumerate(("test", "hard")):
            _panel(axes[row, column], found, split, own_error)
        axes[0, column].set_title(f"a new force every {1e3 * frame:g} ms", pad=24)
        axes[1, column].set_xlabel("run time a frame (ms), one thread, p50")
    judged = set(results["reference"]["numbers"])
    for row, (name, numbers) in enumerate(
        (("test", study.fem.interactions), ("hard", results["reference"]["hard_numbers"]))
    ):
        axes[row, 0].set_ylabel(
            f"relative L2 error (%), {len(judged.intersection(numbers))} {name} interactions"
        )
    shown = {
        label: handle
        for axis in axes.flat
        for handle, label in zip(*axis.get_legend_handles_labels())
    }
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=4)
    return figure


def _panel(axis, found, split, own_error):
    families = sorted(
        {p["family"] for p in found},
        key=lambda f: list(STYLES).index(f) if f in STYLES else len(STYLES),
    )
    for family in families:
        colour, marker = STYLES.get(family, OTHER)
        mine = sorted((p for p in found if p["family"] == family), key=lambda p: p["seconds"])
        x, y = [1e3 * p["seconds"] for p in mine], [100 * p[split] for p in mine]
        axis.plot(
            x,
            y,
            marker,
            color=colour,
            label=family,
            markersize=5,
            alpha=0.8,
            linestyle="-" if "FEM" in family else "",
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
    axis.set(
        xscale="log", yscale="log", ylim=(None, 600 * max(p[split] for p in found))
    )  # room for the names above
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
    for name, seconds in PAPER.items():
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
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
