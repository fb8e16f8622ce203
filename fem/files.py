"""Files that are written whole or not at all, and the lock of a folder that one process at a time
may fill."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` at the end, or goes if the
    block fails."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(
        f".{os.getpid()}.partial-{path.name}"
    )  # keeps the suffix, which some writers go by
    try:
        yield partial
        with open(partial, "rb") as done:
            os.fsync(done.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path`."""
    with replacing(path) as partial:
        partial.write_text(text)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path`."""
    with replacing(path) as partial:
        partial.write_bytes(data)


def save_arrays(path: str | Path, **arrays: object) -> None:
    """np.savez to `path`."""
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez(file, **arrays)
