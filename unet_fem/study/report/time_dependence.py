"""The figure of time dependence."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from unet_fem.training.style import COLOURS, styled, subplots

FEM = ("elastic", "scaled")  # answers that are not learned
DASHES = ("-", "--", "-.")  # of those that share a colour
OTHERS = [colour for colour in COLOURS if colour != "#000000"]  # black is the tissue


@styled()
def draw(result: dict) -> Figure:
    """Error, size and the share of time dependence against time: a row for the short interactions,
    one for each set of longer ones."""
    parts = result["parts"]
    figure, axes = subplots(len(parts), 3, (12.5, 3.2 * len(parts) + 0.8), squeeze=False)
    for row, part in zip(axes, parts, strict=True):
        row[0].set(
            ylabel="relative L2 error (%)",
            title=f"{part['interactions']} interactions {title(part, result['trained_s'])}",
        )
        row[1].set(ylabel="size of the answer / elastic FEM")
        row[2].set(
            ylabel="share of squared error (%)",
            title="time dependence: at most (line), at least (foot of the shade)",
        )
        _curves(row, part)
        row[0].set_yscale("log")
        row[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        row[2].set_ylim(0, 100)
        for axis in row:
            axis.title.set_size(9)
            axis.set(xlabel="time (s)", xlim=(0, part["time"][-1]))
            if part["time"][-1] > result["trained_s"]:
                axis.axvline(result["trained_s"], color="gray", linestyle="--", linewidth=1)
                axis.axvspan(0, result["trained_s"], color="gray", alpha=0.08)
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def title(part: dict, trained_s: float) -> str:
    """How long the interactions of a part are, in words."""
    longest = part["time"][-1]
    return "as long as in training" if longest <= trained_s else f"up to {longest:g} s"


def _curves(row, part):
    time = part["time"][1:]
    row[1].plot(time, values(part["creep"]), "k", linewidth=2.5, label="viscoelastic FEM")
    for n, (key, answer) in enumerate(part["answers"].items()):
        again, place = divmod(n, len(OTHERS))
        colour = OTHERS[place]
        line = ":" if key in FEM else DASHES[again % len(DASHES)]
        style = {"color": colour, "label": answer["label"], "linestyle": line}
        row[0].plot(time, 100 * values(answer["relative_l2"]), **style)
        row[1].plot(time, values(answer["creep"]), **style)
        if key not in FEM:
            most, least = (100 * values(answer[share]) for share in ("along", "common"))
            row[2].plot(time, most, **style)
            row[2].fill_between(time, least, most, color=colour, alpha=0.08)


def values(column: list) -> np.ndarray:
    """A list with None as an array with gaps, without the first frame: nothing has moved there."""
    return np.array(column, float)[1:]
