"""The figure and the text of the map of limits, from the cells that fem.measure.limits gives."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fem.files import replacing, write_text
from fem.measure.limits import Cell, counts

COLOURS = colormaps["YlGnBu"]
SCALE = LogNorm(1e-8, 1e-1)

INTRODUCTION = """# Where the solver is accurate, where it stops, and what the gate rejects

    python tools/stability.py    # three minutes on one core; --quick for a few cells of most rows

Every cell of the map is one run at an extreme setting. It ends as **accurate**, with its relative
error against a reference, as **stopped**, with the solver's reason, or as **rejected**, with the
sign by which the gate of a dataset finds it out. An error above the tolerance of its row would be
WRONG, and so would be a run that does not end, or one that stops although it goes on with smaller
steps: the command then fails. This map: {counts}.

![the map](stability.png)

The block has 6 x 6 x 4 cells of 1 mm, held at the bottom and the sides, with the material of the
paper; x1 is a push of 1 mN on a circle of radius 2.2 mm, 0.12 mm deep. Errors in time are root
mean squares of the displacement under the footprint over the run; the others are norms of the
final displacement.

## What to take from it

- **Step.** Up to the critical step the runs are accurate, also while tissue stiffens: the step is
  estimated again and the run goes on by smaller ones. A step past the critical is refused, with a
  fixed number of steps (`advance(steps=...)`) as soon as the tissue has stiffened that far: leave
  `solver.safety` at 0.85 and fix the number of steps for a state under load.
- **Mass scaling.** Energies do not tell when it is too much: on the tumour's mesh a factor of
  65536 leaves the answer 57 % wrong with kinetic energy at 2 % of strain energy and the energy in
  balance. The *disequilibrium* tells: the largest inertial and damping force over the largest
  load, both as norms over the free nodes. The error is 0.4 to 1.4 times as large wherever it
  exceeds 2 %, damped or not. The limit, 3 %, keeps errors below 4 %; the shipped scenes are at 0.4
  to 1 %. With the true mass it is no error but the motion itself, so the solver warns of it where
  the mass is scaled, and the gate of a dataset, whose pushes are slow, judges it always.
- **Hourglass stiffness.** Too little of it leaves the hourglass modes free, and their energy tells
  nothing, since it falls with the stiffness. *Hourglass motion* tells: the energy that the same
  motion would have at a stiffness of mu, over strain energy (limit 20 %). Too much carries the
  load, which the energy itself shows, the *hourglass share* (limit 5 %). Both limits belong to
  errors of 5 to 10 %. Where every stiffness is beyond one of them, the cells are too coarse for the
  reduced element. The other elements have no such modes; their error on a coarse mesh is that of
  the table below, and no sign of a run shows it.
- **nu.** The full element locks (table below) and is refused above nu = 0.45. Take
  `mean_dilatation`, or `reduced`; both hold to 0.4999. On coarser footprints the full element is
  too stiff below 0.45 already.
- **Force.** Sooner or later a cell is crushed (J < 0.05) or turned inside out at a corner; both
  stop the run, for by then the displacement means nothing. Corners are looked at with every
  estimate of the step, at least once in 256 steps, and at every frame. The gate asks for *corner
  J*, the volume ratio at the worst corner, of at least 0.1, which J at the points of integration
  does not show: 0.29 there was 0.02 at a corner. Of 36 hard draws on the published mesh (1.3 to
  1.6 times 1.2 mN, radii of 1.8 to 3.2 mm) 30 keep it. The 16 of them that were simulated again at
  the true mass in float64, all with less than 0.3 among them, are the same to 0.5 %; the 3 from
  0.02 to 0.1 are to 0.4 to 0.6 %, and 3 invert in both. Widen the footprint, or refine the mesh
  where it bends.
- **Impact.** A sudden force starts with small steps and takes as many as the deformation asks
  for. What is left is the timing of waves as short as a cell: with `solver.safety` = 0.2 the 6 %
  become 1 %.
- **Viscosity.** Relaxation times far below the step and far above the run, and sums of g up to
  0.999, need no care. A sum of 1 would be a fluid and is refused.
- **Contrasts and bad cells.** Densities (`mass_scaling` takes one factor a cell) and cell sizes
  of 1:100, slivers of 1:10 000 and a corner Jacobian of a millionth cost steps, not accuracy.
  Inverted cells are refused with their number. A sliver so thin that one call of `advance` would
  take more than 1e8 steps is stopped.
- **Quasi-static.** The same block without inertia stands beside the block at rest after damping,
  in tissue from soft to stiff and up to nu = 0.4999, and stops where that stops. One call may be a
  tenth of a millisecond or a million seconds long. Pushes that rise within less than a tenth of a
  second are beyond it, and no sign of a run shows that: docs/fem.md has the error. The reduced
  solver and the networks, which learn from a body, are judged on the tumour, under other loads, in
  other tissues and at other lengths of a frame: docs/results.md.
- **float32** costs no accuracy down to the smallest strains, and an hour of a held force comes
  out as the creep function says, in both precisions and all elements, at `mass_scaling` = 1e5.
"""

HEADER = """
## Every cell

| sweep | value | outcome | error | tolerance | reference |
|---|---|---|---|---|---|
"""

LOCKING = """
## Volumetric locking

Error of the depth of an indentation with 4.4 cells to the footprint's radius, against cells of
half the size with mean dilatation. The full element's figures above nu = 0.45 are what the solver
refuses to give.

| nu | full | reduced | mean_dilatation |
|---|---|---|---|
"""


def write(folder: Path, cells: Sequence[Cell], locking: Sequence[tuple[float, ...]]) -> None:
    """stability.md and stability.png in `folder`; locking: rows (nu, three relative errors), may be
    empty."""
    draw(cells, folder / "stability.png")
    number = ", ".join(f"{n} {status}" for status, n in counts(cells).items())
    text = INTRODUCTION.format(counts=f"{len(cells)} cells, {number}")
    if locking:
        text += LOCKING + "".join(
            f"| {nu:g} | " + " | ".join(f"{100 * error:+.1f} %" for error in errors) + " |\n"
            for nu, *errors in locking
        )
    text += HEADER + "".join(f"| {' | '.join(_row(cell))} |\n" for cell in cells)
    write_text(folder / "stability.md", text)


def _row(cell):
    outcome = f"{cell.status}: {cell.reason}" if cell.reason else cell.status
    error = "" if cell.status == "stopped" else f"{cell.error:.1e}"
    sweep = cell.sweep
    return sweep.name, cell.value, outcome, error, f"{sweep.tolerance:g}", sweep.reference


def draw(cells: Sequence[Cell], path: Path) -> None:
    """One row of coloured cells a sweep, as an image at `path`."""
    names = list(dict.fromkeys(cell.sweep.name for cell in cells))
    rows = [[cell for cell in cells if cell.sweep.name == name] for name in names]
    widest = max(len(row) for row in rows)
    size = 4.2 + 1.1 * widest, 1.2 + 0.56 * len(rows)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    for y, row in enumerate(rows):
        for x, cell in enumerate(row):
            _draw_cell(axes, x, y, cell)
    axes.set(
        xlim=(0, widest), ylim=(len(rows), 0), xticks=[], yticks=[y + 0.5 for y in range(len(rows))]
    )
    axes.set_yticklabels(f"{row[0].sweep.name}\nagainst {row[0].sweep.reference}" for row in rows)
    axes.tick_params(length=0, labelsize=8)
    axes.spines[:].set_visible(False)
    axes.set_xlabel(
        "from one end of the setting to the other; upper line: its value,"
        " lower line: the error, or why the run was stopped (grey) or is rejected (yellow)"
    )
    colourbar = figure.colorbar(ScalarMappable(SCALE, COLOURS), ax=axes, aspect=50, pad=0.01)
    colourbar.set_label("relative error of the accurate cells")
    with replacing(path) as partial:
        figure.savefig(partial, dpi=110)


def _draw_cell(axes, x, y, cell):
    if cell.status == "accurate":
        colour = COLOURS(SCALE(max(cell.error, SCALE.vmin)))
        style, below = (
            {"facecolor": colour},
            f"{100 * cell.error:.1f} %" if cell.error > 5e-4 else f"{cell.error:.0e}",
        )
        ink = "white" if sum(colour[:3]) < 1.5 else "black"
    else:
        face = {"stopped": "0.92", "rejected": "moccasin"}.get(cell.status, "red")
        style, ink = {"facecolor": face, "hatch": "////", "edgecolor": "0.8"}, "black"
        below = cell.reason or "WRONG"
        if cell.status == "rejected":
            below += f"\n{100 * cell.error:.1f} %"
    axes.add_patch(Rectangle((x + 0.02, y + 0.04), 0.96, 0.92, linewidth=0, **style))
    axes.text(
        x + 0.5,
        y + 0.31,
        cell.value,
        ha="center",
        va="center",
        fontsize=8,
        color=ink,
        weight="bold",
    )
    axes.text(x + 0.5, y + 0.7, below, ha="center", va="center", fontsize=7.5, color=ink)
