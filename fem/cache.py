"""Results that took long, kept under a key of all that they depend on.

The key holds the settings that a stage reads, the content of the files that it reads, and the
version of the stage, an integer that its author raises when the stage gives other results. No clock
and no
commit enters it: a docstring throws nothing away, and edited data are never taken for the old.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from fem.errors import InputError
from fem.files import write_text

VARIABLE = "UNET_FEM_CACHE"  # environment variable that names the root


def cache_root(given: str | Path | None = None) -> Path:
    """The folder of all cached results: `given`, else the environment variable UNET_FEM_CACHE, else
    runs/cache."""
    return Path(given or os.environ.get(VARIABLE) or "runs/cache")


def digest(settings: object, files: Iterable[str | Path] = (), version: int = 1) -> str:
    """Sixteen hexadecimal digits of `settings` (by their repr), the content of `files`, and
    `version`."""
    found = hashlib.sha256(f"{version}\n{settings!r}\n".encode())
    for path in files:
        with open(path, "rb") as file:
            found.update(hashlib.file_digest(file, "sha256").digest())
    return found.hexdigest()[:16]


def once(path: str | Path, key: str, make: Callable[[], object]) -> object:
    """What `make()` gives, plain values as JSON holds them; read from `path` where it was made
    under the same key."""
    path = Path(path)
    if path.is_file():
        try:
            kept = json.loads(path.read_text())
            if kept["key"] == key:
                return kept["result"]
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{path} is damaged; delete it, and it is made again") from None
    result = make()
    write_text(path, json.dumps({"key": key, "result": result}, indent=1, allow_nan=False))
    return json.loads(path.read_text())["result"]
