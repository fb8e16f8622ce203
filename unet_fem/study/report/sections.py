"""One hard interaction on a section through the tissue: the FEM, the competitors and their
errors."""

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

from fem.data.dataset import Dataset
from unet_fem.metrics import relative_l2
from unet_fem.study.report.numbers import percent
from unet_fem.training.samples import Samples
from unet_fem.training.section import draw_section, most_displaced, move_section, section_plane
from unet_fem.training.style import ALERT, styled, subplots

MILLISECONDS = 250  # of a frame of the animation


def hard_interaction(test: Samples) -> tuple[np.ndarray, int]:
    """(rows of `test` of the hard interaction that the FEM displaces most, its number)."""
    largest = np.abs(test.displacement[test.hard]).max(axis=(1, 2, 3, 4)).argmax()
    number = int(test.interaction[np.flatnonzero(test.hard)[largest]])
    return test.interaction == number, number


@styled()
def side_by_side(dataset: Dataset, test: Samples, fields: dict[str, np.ndarray]) -> Figure:
    """FEM and each of `fields` on one section of a hard interaction at its largest displacement,
    and below each its error."""
    rows, number = hard_interaction(test)
    own = test.select(rows)
    sample, j = most_displaced(dataset, own)
    truth = own.displacement[sample]
    size = 2.9 * (len(fields) + 1), 3.9
    figure, axes = subplots(2, len(fields) + 1, size, sharex=True, sharey=True)
    limit = np.linalg.norm(truth[:, j], axis=-1).max()
    cells = draw_section(axes[0, 0], dataset, j, truth, truth, limit)
    axes[0, 0].set_title(f"FEM (max {limit:.2f} mm)", size=8)
    for (above, below), (name, field) in zip(axes[:, 1:].T, fields.items(), strict=True):
        found = field[rows][sample]
        draw_section(above, dataset, j, found, found, limit)
        above.set_title(name, size=8)
        draw_section(below, dataset, j, truth, found - truth, limit)
        share = relative_l2(found[dataset.free], truth[dataset.free])
        largest = np.linalg.norm((found - truth)[:, j], axis=-1).max()
        below.set_title(
            f"error: max {largest:.2f} mm, relative L2 {percent(share, 0)} %",
            size=8,
        )
    axes[1, 0].set_visible(False)
    for axis in (axes[0, 0], axes[1, 1]):
        axis.set_ylabel("up (mm)")
    axes[0, 0].tick_params(labelbottom=True)
    for axis in (axes[0, 0], *axes[1, 1:]):
        axis.set_xlabel("across (mm)")
    figure.colorbar(cells, ax=axes, label="displacement or error (mm)", shrink=0.7)
    figure.suptitle(
        f"Test interaction {number} at its largest displacement, section {j + 1} of"
        f" {dataset.grid[1]}; errors on the FEM's shape",
        size=10,
    )
    return figure


@styled()
def animate(dataset: Dataset, test: Samples, fields: dict[str, np.ndarray], path: Path) -> None:
    """Write a GIF of one hard interaction to `path`: FEM and each of `fields` on a section, their
    errors and the force below."""
    rows, number = hard_interaction(test)
    own = test.select(rows)
    truth, (_, j) = own.displacement, most_displaced(dataset, own)
    limit = np.linalg.norm(truth[:, :, j], axis=-1).max()
    columns = len(fields) + 1
    figure, axes = subplots(2, columns, (2.8 * columns, 3.8))
    figure.set_dpi(100)
    parts = [(axes[0, 0], "FEM", truth, truth)]
    for (above, below), (name, field) in zip(axes[:, 1:].T, fields.items(), strict=True):
        found = field[rows]
        parts += [
            (above, name, found, found),
            (below, f"error of the {name}", truth, found - truth),
        ]
    cells = []
    for axis, title, shape, values in parts:
        cells.append(draw_section(axis, dataset, j, shape[0], values[0], limit))
        axis.set_title(title, size=9)
        axis.set_ylim(*_range(dataset, j, truth))
        axis.tick_params(labelsize=7)
    figure.colorbar(cells[0], ax=axes[:, -1], label="displacement or error (mm)")
    force = np.linalg.norm(own.force, axis=-1).sum(axis=(1, 2, 3))
    axes[1, 0].plot(dataset.time, force, "-", color="slategray")
    (now,) = axes[1, 0].plot([0], force[:1], "o", color=ALERT)
    axes[1, 0].set(xlabel="time (s)", ylabel="total force (mN)")
    heading = figure.suptitle(f"Test interaction {number}", size=10)

    def show(frame: int) -> None:
        for part, (_, _, shape, values) in zip(cells, parts, strict=True):
            move_section(part, dataset, j, shape[frame], values[frame])
        now.set_data([dataset.time[frame]], [force[frame]])
        heading.set_text(
            f"Test interaction {number}, section {j + 1} of {dataset.grid[1]} (mm):"
            f" {dataset.time[frame]:.2f} s"
        )

    with rc_context({"savefig.bbox": None}):  # frames of one size
        FuncAnimation(figure, show, frames=len(truth), interval=MILLISECONDS).save(
            path, PillowWriter(fps=1000 // MILLISECONDS)
        )


def _range(dataset, j, truth):
    up = (dataset.points + truth)[:, :, j] @ section_plane(dataset)[:, 1]  # (F, nx, nz) mm
    inside = up[:, dataset.mask[:, j]]
    margin = 0.1 * np.ptp(inside)
    return inside.min() - margin, inside.max() + margin
