"""The figures of an evaluation, as PNG files."""

import itertools
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt  # noqa: E402
import matplotlib.ticker
import numpy as np
from matplotlib.collections import PolyCollection  # noqa: E402

matplotlib.use("Agg")

LIMIT_96 = 2.054  # standard deviations that hold 96 % of a normal distribution
plt.rcParams.update(
    {
        "figure.dpi": 150,
        "font.size": 9,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "savefig.bbox": "tight",
    }
)


def draw_all(folder, dataset, samples, predictions):
    """Write every figure to `folder`; predictions: {model: (displacement (S, nx, ny, nz, 3) mm,
    volume (S,) mm3)}."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    fields = {name: prediction for name, (prediction, _) in predictions.items()}
    figures = {
        "error_vs_depth": error_vs_depth(dataset, samples, fields),
        "bland_altman": bland_altman(dataset, samples, fields),
        "test_interactions": test_interactions(dataset, samples, predictions),
        "fields": displacement_fields(dataset, samples, next(iter(fields.items()))),
    }
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")
        plt.close(figure)


def node_distance(dataset, a, b=0.0):
    """|a - b| at the free nodes, (S, n) mm."""
    return np.linalg.norm((a - b)[:, dataset.free], axis=-1)


def normalised_depth(dataset):
    """0 in the loaded layer of the grid, 1 in the deepest, for every free node (n,)."""
    return 1 - np.argwhere(dataset.free)[:, 2] / (dataset.grid[2] - 1)


def by_depth(dataset, field, truth):
    """{"depth": 0 in the loaded layer to 1, "mean_mm", "relative_l2"}: errors of a field (S, nx,
    ny, nz, 3) mm over each layer's free nodes.

    relative_l2 is None in a layer where the truth does not move.
    """
    error, size = node_distance(dataset, field, truth), node_distance(dataset, truth)
    depth = normalised_depth(dataset).round(6)
    layers = np.unique(depth)
    rows = [depth == layer for layer in layers]
    squares = [
        [np.sum(values[:, row] ** 2, dtype=float) for values in (error, size)] for row in rows
    ]
    relative = [float(np.sqrt(e / s)) if s > 0 else None for e, s in squares]
    return {
        "depth": layers.tolist(),
        "mean_mm": [float(error[:, row].mean(dtype=float)) for row in rows],
        "relative_l2": relative,
    }


def error_vs_depth(dataset, samples, fields):
    """Mean error of each model against the depth below the loaded surface, in mm and relative to
    the FEM's motion there."""
    curves = {
        name: by_depth(dataset, field, samples.displacement) for name, field in fields.items()
    }
    return depth_curves(
        curves, f"Error against depth, {len(np.unique(samples.interaction))} unseen interactions"
    )


def depth_curves(curves, title):
    """The figure of {name: what `by_depth` gives}."""
    figure, axes = plt.subplots(1, 2, figsize=(8.6, 4), layout="constrained")
    for (name, curve), marker in zip(curves.items(), itertools.cycle("osv^Dx+")):
        axes[0].plot(
            curve["depth"], curve["mean_mm"], f"{marker}-", markersize=4, linewidth=1, label=name
        )
        percent = [np.nan if value is None else 100 * value for value in curve["relative_l2"]]
        axes[1].plot(curve["depth"], percent, f"{marker}-", markersize=4, linewidth=1, label=name)
    for axis, label in zip(axes, ("mean error (mm)", "relative L2 error (%)")):
        axis.set(
            xlabel="normalised depth (0: loaded surface, 1: bottom)", ylabel=label, ylim=(0, None)
        )
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7
    )
    figure.suptitle(title)
    return figure


def bland_altman(dataset, samples, fields):
    """Difference of nodal displacement magnitudes against their mean, with bias and 96 % limits,
    for each model."""
    columns = len(fields) if len(fields) < 4 else -(-len(fields) // 2)
    lines = -(-len(fields) // columns)
    figure, axes = plt.subplots(
        lines,
        columns,
        figsize=(4 * columns, 3.4 * lines),
        sharey=True,
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    truth = node_distance(dataset, samples.displacement)
    for axis, (name, field) in zip(axes.flat, fields.items()):
        found = node_distance(dataset, field)
        mean, difference = (truth + found) / 2, found - truth
        bias, spread = difference.mean(dtype=float), LIMIT_96 * difference.std(dtype=float)
        shades = axis.hexbin(
            mean.ravel(), difference.ravel(), gridsize=80, bins="log", mincnt=1, cmap="viridis"
        )
        for value, style in ((bias, "-"), (bias - spread, "--"), (bias + spread, "--")):
            axis.axhline(value, color="crimson", linestyle=style, linewidth=1)
        axis.set_title(f"{name}\nbias {bias:.4f} mm, 96 % limits ±{spread:.4f} mm", size=8)
        figure.colorbar(shades, ax=axis, label="nodes")
    for axis in axes.flat[len(fields) :]:
        axis.remove()
    for axis in axes[-1]:
        axis.set_xlabel("mean of FEM and prediction (mm)")
    for axis in axes[:, 0]:
        axis.set_ylabel("prediction minus FEM (mm)")
    return figure


def test_interactions(dataset, samples, predictions):
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
    return interaction_curves(numbers, numbers[hard], largest(force), violations)


def interaction_curves(numbers, hard, force, violations):
    """The figure of each interaction's largest total force (mN) and of {name: its largest relative
    change of volume}; hard: their numbers."""
    figure, axes = plt.subplots(2, 1, figsize=(8, 5.5), sharex=True, layout="constrained")
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
    axes[1].axhline(7, color="crimson", linestyle="--", linewidth=1, label="7 % gate")
    axes[1].set(xlabel="test interaction", ylabel="largest volume violation (%)", ylim=(0, None))
    for axis in axes:
        axis.axvspan(
            min(hard) - 0.5,
            max(hard) + 0.5,
            color="orange",
            alpha=0.2,
            label="harder than any in training",
        )
    axes[1].xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(integer=True))
    figure.legend(
        *axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7
    )
    return figure


def displacement_fields(dataset, samples, model):
    """FEM, prediction and difference on the section of the deformed tissue through the most
    displaced node."""
    name, field = model
    sample, j = most_displaced(dataset, samples)
    truth, found = samples.displacement[sample], field[sample]
    figure, axes = plt.subplots(
        1, 3, figsize=(11, 2.6), sharey=True, sharex=True, layout="constrained"
    )
    limit = np.linalg.norm(truth[:, j], axis=-1).max()
    for axis, (title, shape, values) in zip(
        axes, (("FEM", truth, truth), (name, found, found), ("difference", truth, found - truth))
    ):
        cells = draw_section(axis, dataset, j, shape, values, limit)
        axis.set(
            title=f"{title} (max {np.linalg.norm(values[:, j], axis=-1).max():.2f} mm)",
            xlabel="across (mm)",
        )
    axes[0].set_ylabel("up (mm)")
    figure.colorbar(cells, ax=axes, label="displacement (mm)", shrink=0.8)
    figure.suptitle(
        f"Test interaction {samples.interaction[sample]}, the largest displacement of all: section {j + 1} of {dataset.grid[1]};"
        " the difference is drawn on the FEM's shape"
    )
    return figure


def most_displaced(dataset, samples):
    """(sample, j) of the FEM's largest displacement: the section of the grid through that node, or
    the nearest that has cells."""
    distance = node_distance(dataset, samples.displacement)
    sample, node = np.unravel_index(distance.argmax(), distance.shape)
    layers = np.unique(
        np.unravel_index(dataset.cells, dataset.grid)[1]
    )  # those with cells: an embedded mesh moves nodes beside it too
    return int(sample), int(layers[np.abs(layers - np.argwhere(dataset.free)[node][1]).argmin()])


def draw_section(axis, dataset, j, shape, values, limit):
    """Section j of the tissue displaced by `shape`, coloured from 0 to `limit` by the size of
    `values`, both (nx, ny, nz, 3) mm.

    Returns the PolyCollection, which `move_section` changes.
    """
    cells = PolyCollection([], cmap="viridis", edgecolors="k", linewidths=0.2)
    move_section(cells, dataset, j, shape, values)
    cells.set_clim(0, limit)
    axis.add_collection(cells)
    axis.set_aspect("equal")
    axis.set_axisbelow(True)
    axis.autoscale_view()
    return cells


def move_section(cells, dataset, j, shape, values):
    moved = (dataset.points + shape)[:, j].reshape(-1, 3) @ section_plane(dataset)  # (nx*nz, 2) mm
    quads = section_quads(dataset, j)
    cells.set_verts(moved[quads])
    cells.set_array(np.linalg.norm(values[:, j], axis=-1).ravel()[quads].mean(axis=1))


def section_plane(dataset):
    """(3, 2) unit vectors across and up: along the grid's first and third axes as they run on the
    whole (x and z for the tumour)."""

    def mean_step(axis):
        points, mask = np.moveaxis(dataset.points, axis, 0), np.moveaxis(dataset.mask, axis, 0)
        return (points[1:] - points[:-1])[mask[1:] & mask[:-1]].mean(axis=0)

    across, up = mean_step(0), mean_step(2)
    up = up - across * (across @ up) / (across @ across)
    return np.stack([across / np.linalg.norm(across), up / np.linalg.norm(up)], axis=1)


def section_quads(dataset, j):
    """(M, 4) corners, as indices into the (nx, nz) nodes of layer j, of the cell faces that lie in
    that layer."""
    nx, ny, nz = dataset.grid
    i, jj, k = np.unravel_index(dataset.cells, dataset.grid)  # (E, 8)
    flat = np.where(jj == j, i * nz + k, -1)
    faces = np.array([row[row >= 0] for row in flat if (row >= 0).sum() == 4])
    faces = np.unique(np.sort(faces, axis=1), axis=0)  # a layer inside has every face twice
    return faces[:, [0, 2, 3, 1]]  # sorted by x, then z: walk around
