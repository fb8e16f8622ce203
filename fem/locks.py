"""The lock of a file or folder that one process at a time may fill."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from fem.errors import InputError
from fem.files import make_folder


@contextmanager
def lock(path: str | Path) -> Iterator[None]:
    """Keep other processes from `path` while the block runs.

    The operating system holds the lock, on `.<name>.lock` beside `path`, so that it ends with its
    process, however that ends. Raises InputError at once where another process holds it, with the
    number and the start of that process.
    """
    path = Path(path)
    note = path.with_name(f".{path.name}.lock")
    make_folder(note.parent)
    held = FileLock(note)
    try:
        held.acquire(blocking=False)
    except Timeout:
        raise InputError(
            f"{path} is being written by {_holder(note)}; wait until it ends, or end it"
        ) from None
    except OSError as error:
        raise InputError(f"{note} cannot be locked: {error.strerror}; give another path") from None
    try:
        with suppress(OSError):  # the note is a kindness, the lock holds without it
            note.write_text(f"process {os.getpid()} since {datetime.now():%Y-%m-%d %H:%M:%S}")
        yield
    finally:
        # before the release, so that no other process's lock file goes; Windows lets an open file
        # stay and filelock removes it there
        with suppress(OSError):
            note.unlink()
        held.release()


def _holder(note: Path) -> str:
    try:
        return note.read_text() or "another process"
    except (OSError, UnicodeDecodeError):
        return "another process"
