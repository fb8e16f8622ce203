"""Files that are written whole or not at all."""

import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from fem.errors import InputError


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` at the end, or goes if the
    block fails.

    Raises InputError where the file cannot be written; other exceptions of the block pass through.
    """
    path = Path(path)
    make_folder(path.parent)
    if os.path.isdir(path):
        raise InputError(f"{path} is a folder; give the path of a file")
    # the suffix stays last, some writers go by it
    partial = path.with_name(f".{os.getpid()}.partial-{path.name}")
    try:
        yield partial
        with open(partial, "r+b") as done:
            os.fsync(done.fileno())
        os.replace(partial, path)
    except OSError as error:
        # a write to an open file fails without a name; an error about another file, or without a
        # number, is the caller's own
        if error.errno is None or error.filename not in (None, str(partial), partial):
            raise
        raise InputError(_unwritable(path, error)) from error
    finally:
        with suppress(OSError):  # mostly it is not there any more
            partial.unlink()


def make_folder(path: str | Path) -> None:
    """Make the folder `path` where there is none. Raises InputError where that cannot be."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(_unwritable(path, error)) from None


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path`."""
    with replacing(path) as partial:
        partial.write_text(text)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path`."""
    with replacing(path) as partial:
        partial.write_bytes(data)


def save_arrays(path: str | Path, **arrays: Any) -> None:
    """np.savez to `path`."""
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez(file, **arrays)


def load_arrays(path: str | Path, *names: str) -> dict[str, np.ndarray]:
    """The arrays of an .npz, of `names` alone if some are given; without pickles. None where the
    file is missing, damaged or no .npz."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names or file.files if name in file.files}
    except (zipfile.BadZipFile, ValueError, EOFError, OSError, TypeError, AttributeError):
        return {}


def _unwritable(path: str | Path, error: OSError) -> str:
    return f"{path} cannot be written: {error.strerror}; make room there or give another path"
