"""The figures of an evaluation, as PNG files."""

from pathlib import Path

import matplotlib
import matplotlib.ticker
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
from matplotlib.collections import PolyCollection  # noqa: E402

LIMIT_96 = 2.054  # standard deviations that hold 96 % of a normal distribution
plt.rcParams.update({"figure.dpi": 150, "font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "savefig.bbox": "tight"})


def draw_all(folder, dataset, samples, predictions):
    """Write every figure to `folder`; predictions: {model: (displacement (S, nx, ny, nz, 3) mm, volume (S,) mm3)}."""
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


def error_vs_depth(dataset, samples, fields):
    """Mean error of each model against the depth below the loaded surface, in mm and relative to the FEM's motion there."""
    depth = normalised_depth(dataset)
    layers = np.unique(depth.round(6))
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2))
    truth = node_distance(dataset, samples.displacement)
    for name, field in fields.items():
        error = node_distance(dataset, field, samples.displacement)
        rows = [np.isclose(depth, layer, atol=1e-5) for layer in layers]
        axes[0].plot(layers, [error[:, row].mean() for row in rows], "o-", label=name)
        relative = [np.sqrt((error[:, row] ** 2).sum() / (truth[:, row] ** 2).sum()) for row in rows]
        axes[1].plot(layers, 100 * np.array(relative), "o-", label=name)
    for axis, label in zip(axes, ("mean error (mm)", "relative L2 error (%)")):
        axis.set(xlabel="normalised depth (0: loaded surface, 1: bottom)", ylabel=label, ylim=(0, None))
    axes[0].legend()
    figure.suptitle(f"Error against depth, {len(np.unique(samples.interaction))} unseen interactions")
    return figure


def bland_altman(dataset, samples, fields):
    """Difference of nodal displacement magnitudes against their mean, with bias and 96 % limits, for each model."""
    figure, axes = plt.subplots(1, len(fields), figsize=(4 * len(fields), 3.4), sharey=True, sharex=True, squeeze=False)
    truth = node_distance(dataset, samples.displacement)
    for axis, (name, field) in zip(axes[0], fields.items()):
        found = node_distance(dataset, field)
        mean, difference = (truth + found) / 2, found - truth
        bias, spread = difference.mean(dtype=float), LIMIT_96 * difference.std(dtype=float)
        shades = axis.hexbin(mean.ravel(), difference.ravel(), gridsize=80, bins="log", mincnt=1, cmap="viridis")
        for value, style in ((bias, "-"), (bias - spread, "--"), (bias + spread, "--")):
            axis.axhline(value, color="crimson", linestyle=style, linewidth=1)
        axis.set(title=f"{name}: bias {bias:.4f} mm, 96 % limits ±{spread:.4f} mm", xlabel="mean of FEM and prediction (mm)")
        axis.title.set_size(8)
        figure.colorbar(shades, ax=axis, label="nodes")
    axes[0, 0].set_ylabel("prediction minus FEM (mm)")
    return figure


def test_interactions(dataset, samples, predictions):
    """Largest total force and largest volume violation of every test interaction, the hard ones shaded."""
    numbers = np.unique(samples.interaction)

    def largest(values):
        return np.array([values[samples.interaction == number].max() for number in numbers])

    force = np.linalg.norm(samples.last_force, axis=-1).sum(axis=(1, 2, 3))
    rest = dataset.mesh.volume()
    figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
    axes[0].bar(numbers, largest(force), color="slategray")
    axes[0].set_ylabel("largest total force (mN)")
    axes[1].plot(numbers, 100 * largest(np.abs(samples.volume / samples.volume[0] - 1)), "k.-", label="FEM", linewidth=0.8)
    for name, (_, volume) in predictions.items():
        axes[1].plot(numbers, 100 * largest(np.abs(volume / rest - 1)), ".-", label=name, linewidth=0.8)
    axes[1].axhline(7, color="crimson", linestyle="--", linewidth=1, label="7 % gate")
    axes[1].set(xlabel="test interaction", ylabel="largest volume violation (%)", ylim=(0, None))
    hard = numbers[[samples.hard[samples.interaction == number].any() for number in numbers]]
    for axis in axes:
        axis.axvspan(hard.min() - 0.5, hard.max() + 0.5, color="orange", alpha=0.2, label="harder than any in training")
    axes[1].xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(integer=True))
    axes[1].legend(ncols=3, fontsize=7)
    return figure


def displacement_fields(dataset, samples, model):
    """FEM, prediction and difference on the section of the deformed tissue through the most displaced node."""
    name, field = model
    distance = node_distance(dataset, samples.displacement)
    worst = np.unravel_index(distance.argmax(), distance.shape)
    layers = np.unique(np.unravel_index(dataset.cells, dataset.grid)[1])  # those with cells: an embedded mesh moves nodes beside it too
    j = layers[np.abs(layers - np.argwhere(dataset.free)[worst[1]][1]).argmin()]  # the section through that node
    plane = section_plane(dataset)
    truth, found = samples.displacement[worst[0]], field[worst[0]]
    quads = section_quads(dataset, j)
    figure, axes = plt.subplots(1, 3, figsize=(11, 2.6), sharey=True, sharex=True, layout="constrained")
    panels = (("FEM", truth, truth), (name, found, found), ("difference", truth, found - truth))
    limit = np.linalg.norm(truth[:, j], axis=-1).max()
    for axis, (title, shape, values) in zip(axes, panels):
        moved = (dataset.points + shape)[:, j].reshape(-1, 3) @ plane  # (nx*nz, 2) mm
        colour = np.linalg.norm(values[:, j], axis=-1).ravel()[quads].mean(axis=1)
        cells = PolyCollection(moved[quads], array=colour, cmap="viridis", edgecolors="k", linewidths=0.2)
        cells.set_clim(0, limit)
        axis.add_collection(cells)
        axis.set(title=f"{title} (max {np.linalg.norm(values[:, j], axis=-1).max():.2f} mm)", xlabel="across (mm)", aspect="equal")
        axis.autoscale_view()
    axes[0].set_ylabel("up (mm)")
    figure.colorbar(cells, ax=axes, label="displacement (mm)", shrink=0.8)
    figure.suptitle(
        f"Test interaction {samples.interaction[worst[0]]}, the largest displacement of all: section {j + 1} of {dataset.grid[1]};"
        " the difference is drawn on the FEM's shape"
    )
    return figure


def section_plane(dataset):
    """(3, 2) unit vectors across and up: along the grid's first and third axes as they run on the whole (x and z for the tumour)."""

    def mean_step(axis):
        points, mask = np.moveaxis(dataset.points, axis, 0), np.moveaxis(dataset.mask, axis, 0)
        return (points[1:] - points[:-1])[mask[1:] & mask[:-1]].mean(axis=0)

    across, up = mean_step(0), mean_step(2)
    up = up - across * (across @ up) / (across @ across)
    return np.stack([across / np.linalg.norm(across), up / np.linalg.norm(up)], axis=1)


def section_quads(dataset, j):
    """(M, 4) corners, as indices into the (nx, nz) nodes of layer j, of the cell faces that lie in that layer."""
    nx, ny, nz = dataset.grid
    i, jj, k = np.unravel_index(dataset.cells, dataset.grid)  # (E, 8)
    flat = np.where(jj == j, i * nz + k, -1)
    faces = np.array([row[row >= 0] for row in flat if (row >= 0).sum() == 4])
    faces = np.unique(np.sort(faces, axis=1), axis=0)  # a layer inside has every face twice
    return faces[:, [0, 2, 3, 1]]  # sorted by x, then z: walk around
