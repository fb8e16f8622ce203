"""Results that took long, kept under a key of all that they depend on.

The key holds the settings that a stage reads, the content of the files that it reads, and the
version of the stage, an integer that its author raises when the stage gives other results. No clock
and no commit enters it: a docstring throws nothing away, and edited data are never taken for the
old.
"""

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from fem.errors import InputError
from fem.files import write_text

VARIABLE = "UNET_FEM_CACHE"  # environment variable that names the root


def cache_root(given: str | Path | None = None) -> Path:
    """The folder of all cached results: `given`, else the environment variable UNET_FEM_CACHE, else
    runs/cache."""
    return Path(given or os.environ.get(VARIABLE) or "runs/cache")


def digest(settings: object, files: Iterable[str | Path] = (), version: int = 1) -> str:
    """Sixteen hexadecimal digits of `settings`, the content of `files`, and `version`.

    settings: plain values, arrays, dataclasses, and lists, sets and dicts of them. Raises
    InputError for an object that would read otherwise in another process.
    """
    found = hashlib.sha256(f"{version}\n{_canonical(settings)}\n".encode())
    for path in files:
        with open(path, "rb") as file:
            found.update(hashlib.file_digest(file, "sha256").digest())
    return found.hexdigest()[:16]


def _canonical(value: object) -> str:
    """A text that is the same for equal values in every process, and another for others."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value) if field.compare]
        named = {name: getattr(value, name) for name in fields}
        return type(value).__qualname__ + _canonical(named)
    if isinstance(value, dict):
        items = sorted(f"{_canonical(key)}: {_canonical(item)}" for key, item in value.items())
        return "{" + ", ".join(items) + "}"
    if isinstance(value, (set, frozenset)):
        return "set(" + ", ".join(sorted(map(_canonical, value))) + ")"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_canonical, value)) + "]"
    if isinstance(value, np.generic):
        return _canonical(value.item())
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        content = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"array({value.dtype.str}, {value.shape}, {content})"
    if isinstance(value, os.PathLike):
        return repr(os.fspath(value))
    text = repr(value)
    if " at 0x" in text or isinstance(value, np.ndarray):
        raise InputError(f"{text} has no lasting name for a cache key; give its settings in place")
    return text


def once(path: str | Path, key: str, make: Callable[[], object]) -> Any:
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
    try:
        text = json.dumps({"key": key, "result": result}, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: the result cannot be kept ({error}); it is not made") from None
    write_text(path, text)
    return json.loads(path.read_text())["result"]
