"""The figure of the stability map."""

import numpy as np


def draw(result):
    """A panel for each competitor: colour is the error over time and force factor.

    A black line bounds what is within the tolerance, hatching marks volume out of its band, a
    dashed line forces beyond the training range. Grey: the truth has stopped in half of the
    interactions or more; black: the competitor has in one.
    """
    from matplotlib.colors import ListedColormap, LogNorm
    from matplotlib.patches import Patch, Rectangle

    from unet_fem.training.figures import plt

    factors, time = (
        result["factors"],
        np.array(result["time"])[1:],
    )  # nothing has moved in the first frame
    edges = np.append(
        time - np.diff(time, prepend=0.0) / 2,
        time[-1] + (time[-1] - time[-2]) / 2 if len(time) > 1 else 1.5 * time[-1],
    )
    rows, flag, alive = (
        np.arange(len(factors) + 1) - 0.5,
        np.array(result["flag"])[:, 1:],
        np.array(result["alive"])[:, 1:],
    )
    known = alive > len(result["interactions"]) / 2
    names = [name for name in result["competitors"] if name != "truth"]
    columns = min(4, len(names))
    lines = -(-(len(names) + 1) // columns)
    figure, axes = plt.subplots(
        lines,
        columns,
        figsize=(3.2 * columns, 2.9 * lines),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis, name in zip(axes.flat, names):
        found = result["competitors"][name]
        error, volume = (np.array(found[key], float)[:, 1:] for key in ("relative_l2", "volume"))
        axis.pcolormesh(
            edges,
            rows,
            np.ma.array(np.ones(known.shape), mask=known),
            cmap=ListedColormap(["lightgray"]),
        )
        colours = axis.pcolormesh(
            edges,
            rows,
            np.ma.array(error, mask=~known | np.isnan(error)),
            norm=LogNorm(0.01, 1),
            cmap="RdYlBu_r",
        )
        stopped = np.array(found["stopped"])[:, 1:] > 0
        axis.pcolormesh(
            edges,
            rows,
            np.ma.array(np.ones(known.shape), mask=~(known & stopped)),
            cmap=ListedColormap(["black"]),
        )
        held = known & (error <= result["tolerance"])
        bounded(axis, edges, rows, held, colors="black", linewidths=1.8)
        bounded(axis, edges, rows, flag >= 0.5, colors="navy", linewidths=1.2, linestyles="dashed")
        for i, j in np.argwhere(known & (volume > result["band"])):
            axis.add_patch(
                Rectangle(
                    (edges[j], rows[i]),
                    edges[j + 1] - edges[j],
                    1,
                    fill=False,
                    hatch="////",
                    linewidth=0,
                )
            )
        axis.set(
            title=name,
            yticks=range(len(factors)),
            yticklabels=[f"× {factor:g}" for factor in factors],
        )
        axis.title.set_size(9)
        axis.grid(False)
    for axis in axes.flat[len(names) :]:
        axis.axis("off")
    marks = [
        plt.Line2D(
            [],
            [],
            color="black",
            linewidth=1.8,
            label=f"bounds error within {100 * result['tolerance']:g} %",
        ),
        plt.Line2D(
            [],
            [],
            color="navy",
            linestyle="--",
            label="forces beyond training above\n(half of the interactions)",
        ),
        Patch(
            facecolor="white",
            edgecolor="black",
            hatch="////",
            label=f"volume off by more than {100 * result['band']:g} %",
        ),
        Patch(facecolor="lightgray", label="FEM truth stopped (half or more)"),
        Patch(facecolor="black", label="competitor stopped (any)"),
    ]
    axes.flat[len(names)].legend(handles=marks, loc="center", fontsize=8, frameon=False)
    for axis in axes[:, 0]:
        axis.set_ylabel("contact force")
    for column in axes.T:
        lowest = [axis for axis in column if axis.axison][-1]
        lowest.set_xlabel("time (s)")
        lowest.tick_params(labelbottom=True)
    figure.colorbar(
        colours,
        ax=axes,
        label="relative L2 error",
        format=lambda x, _: f"{100 * x:g} %",
        shrink=0.7,
    )
    return figure


def bounded(axis, x, y, mask, **style):
    """Draw the boundary of the cells (rows, columns) of a grid with edges x and y where `mask`
    holds."""
    from matplotlib.collections import LineCollection

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
