"""The keys under which a study keeps what it has measured, see fem.cache."""

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from fem.cache import digest


def key(settings: object, files: Iterable[Path | str] = (), version: object = 1) -> str:
    """fem.cache.digest of `settings` (plain values and dataclasses), the content of `files` and
    `version`; a file that is missing counts as such."""
    return digest((settings, [content(path) for path in files], version))


def content(path: Path | str) -> str | None:
    """Digest of the content of the file at `path`, None where there is none."""
    path = Path(path).resolve()
    if not path.is_file():
        return None
    state = path.stat()
    return _content(path, state.st_size, state.st_mtime_ns)


@cache  # within this process alone: a dataset of 300 MB is asked for at every simulation
def _content(path: Path, size: int, modified: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
