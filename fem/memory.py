"""How much memory or disk a step will need, said before it is taken."""

import shutil
from pathlib import Path

import psutil

from fem.errors import InputError

UNITS = (1e9, "GB"), (1e6, "MB"), (1e3, "kB")


def require_memory(size: float, what: str, remedy: str = "lower it") -> None:
    """Raises InputError where `what` needs more than the free memory, with both; size: bytes,
    an estimate from below."""
    free = psutil.virtual_memory().available
    if size > free:
        raise InputError(
            f"{what} needs about {_text(size)} of memory, and {_text(free)} are free; {remedy}"
        )


def require_disk(size: float, path: Path, what: str) -> None:
    """Raises InputError where `what` needs more bytes than are free where `path` lies; size: an
    estimate from below."""
    place = path.absolute()
    while not place.exists():
        place = place.parent
    free = shutil.disk_usage(place).free
    if size > free:
        raise InputError(
            f"{what} need about {_text(size)} in {path.parent}, and {_text(free)} are free; make"
            " room there or give another path"
        )


def _text(size):
    unit, name = next(((u, n) for u, n in UNITS if size >= u), UNITS[-1])
    return f"{size / unit:.3g} {name}"
