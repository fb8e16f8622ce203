"""The figure of time dependence."""

import numpy as np


def draw(result):
    """Error, size and the share of time dependence against time: a row for the short interactions,
    one for the long."""
    from unet_fem.training.figures import plt

    figure, axes = plt.subplots(2, 3, figsize=(12.5, 7), layout="constrained")
    for row, (name, title) in zip(
        axes, (("short", "as long as in training"), ("long", "longer than any in training"))
    ):
        part = result[name]
        time = part["time"][1:]
        row[1].plot(time, values(part["creep"]), "k", linewidth=2.5, label="viscoelastic FEM")
        for n, (key, answer) in enumerate(part["answers"].items()):
            style = {
                "color": f"C{n}",
                "label": answer["label"],
                "linestyle": ":" if key in ("elastic", "scaled") else "-",
            }
            row[0].plot(time, 100 * values(answer["relative_l2"]), **style)
            row[1].plot(time, values(answer["creep"]), **style)
            if key not in ("elastic", "scaled"):
                row[2].plot(time, 100 * values(answer["along"]), **style)
                row[2].fill_between(
                    time,
                    100 * values(answer["common"]),
                    100 * values(answer["along"]),
                    color=f"C{n}",
                    alpha=0.08,
                )
        row[0].set(
            ylabel="relative L2 error (%)",
            title=f"{part['interactions']} test interactions, {title}",
            ylim=(0, None),
        )
        row[1].set(ylabel="size of the answer / elastic FEM")
        row[2].set(
            ylabel="share of squared error (%)",
            title="time dependence: at most (line), at least (foot of the shade)",
            ylim=(0, 100),
        )
        for axis in row:
            axis.title.set_size(9)
            axis.set(xlabel="time (s)", xlim=(0, part["time"][-1]))
            if part["time"][-1] > result["trained_s"]:
                axis.axvline(result["trained_s"], color="gray", linestyle="--", linewidth=1)
                axis.axvspan(0, result["trained_s"], color="gray", alpha=0.08)
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def values(column):
    """A list with None as an array with gaps, without the first frame: nothing has moved there."""
    return np.array(column, float)[1:]
