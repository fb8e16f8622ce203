"""How all figures look. Drawn on figures of their own, without pyplot and its backend."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from cycler import cycler
from matplotlib.figure import Figure

# told apart with every kind of colour vision, after Okabe and Ito; no green beside the reds
COLOURS = ("#0072B2", "#D55E00", "#56B4E9", "#E69F00", "#CC79A7", "#000000", "#7F7F7F", "#8C6D1F")
ALERT = "#9E3D00"  # lines that mark a limit or a front

STYLE: dict[Any, Any] = {
    "axes.prop_cycle": cycler(color=COLOURS),
    "figure.dpi": 150,
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "savefig.bbox": "tight",
}


@contextmanager
def styled() -> Iterator[None]:
    """Decorator or context in which figures are drawn."""
    with matplotlib.rc_context(STYLE):
        yield


def subplots(
    rows: int, columns: int, size: tuple[float, float], **options: Any
) -> tuple[Figure, Any]:
    """(figure, axes) of `size` in inches; options: of Figure.subplots."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def save(figure: Figure, path: Path | str) -> None:
    """Write `figure` to `path`."""
    with styled():
        figure.savefig(path)
