"""Files that are written whole or not at all, and files of others that are read with care.

A command vets where it will write before it does any work: `vet_output`. What is read may be
damaged or hostile: `read_json` and `load_arrays` take nothing on trust, and run nothing.
"""

import errno
import json
import os
import re
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from fem.errors import InputError

LONGEST_NAME = 200  # bytes of a file's name: systems take 255, and a partial file's is longer
LARGEST = 2**30  # bytes that the arrays of one file may take in memory
# letters and digits first: no hidden file, no option, no home folder
PLAIN = re.compile(r"\w(?:[\w .+=@-]*[\w+=@-])?")
RESERVED = {"cache", "con", "prn", "aux", "nul"}  # of the project, and of Windows


def plain_name(name: str, what: str) -> str:
    """`name`, if it can be the name of a file or folder and cannot leave the folder that it is made
    in. Raises InputError otherwise; what: its key, for the message."""
    if not PLAIN.fullmatch(name) or len(name.encode()) > 100 or name.lower() in RESERVED:
        raise InputError(
            f"{what} = {name[:60]!r} must be a plain name, such as 'paper_2': letters, digits and"
            " _ . + = @ - within, at most 100 bytes, and no name that is taken"
        )
    return name


def checked_path(path: str | Path) -> Path:
    """`path` as a Path. Raises InputError for what is none."""
    try:
        return Path(path)
    except TypeError:
        raise InputError(f"{str(path)[:60]} is no path; give one such as out/name") from None


def vet_output(path: str | Path, folder: bool = False) -> Path:
    """`path` as a Path, if a file, or a folder, can be written there; nothing is made.

    Raises InputError for no name, a name that no file has, a folder in the place of a file or a
    file in the place of a folder, and where nothing may be written.
    """
    path = checked_path(path)
    name = path.name
    if not name and not (folder and path.is_dir()) or "\0" in str(path):
        raise InputError(f"'{path}' is no path to write to; give one such as out/name")
    try:
        if len(name.encode()) > LONGEST_NAME:
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
        if not folder and path.is_dir():
            raise InputError(f"{path} is a folder; give the path of a file")
        # what is written takes its place, and no device or pipe survives that
        if not folder and path.exists() and not path.is_file():
            raise InputError(f"{path} is a device or a pipe; give the path of a file")
        place = path if folder else path.parent
        while not place.exists() and place != place.parent:
            place = place.parent
        if not place.is_dir():
            raise OSError(errno.ENOTDIR, f"{place} is no folder")
        if not os.access(place, os.W_OK | os.X_OK):
            raise OSError(errno.EACCES, f"nothing may be written to {place}")
    except (OSError, UnicodeError) as error:
        raise InputError(_unwritable(str(path)[:200], error)) from None
    return path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes the place of `path` at the end, or goes if the
    block fails.

    Raises InputError where the file cannot be written; other exceptions of the block pass through.
    """
    path = vet_output(path)
    make_folder(path.parent)
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


def read_json(path: str | Path, kind: type | tuple[type, ...] = dict) -> Any:
    """What the JSON file at `path` holds. Raises InputError for a file that is not there, is no
    JSON, or holds another type than `kind`."""
    try:
        found = json.loads(Path(path).read_bytes())
    except FileNotFoundError:
        raise InputError(f"there is no {path}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is damaged ({_line(error)}); delete it") from None
    if not isinstance(found, kind):
        raise InputError(f"{path} is damaged (it holds a {type(found).__name__}); delete it")
    return found


def load_arrays(path: str | Path, *names: str, most: int = LARGEST) -> dict[str, np.ndarray]:
    """The arrays of the .npz at `path`, or at the end of that file; of `names` alone if some are
    given. None where the file is missing, damaged or no .npz.

    Nothing in it is run: object arrays, which are pickles, count as damage. Raises InputError for
    arrays that would take more than `most` bytes, before they are unpacked.
    """
    try:
        with open(path, "rb") as file:
            with zipfile.ZipFile(file) as archive:
                size = sum(member.file_size for member in archive.infolist())
            if size <= most:
                file.seek(0)
                # not np.load, which looks for the archive at the start of the file
                with np.lib.npyio.NpzFile(file, allow_pickle=False) as arrays:
                    chosen = [name for name in names or arrays.files if name in arrays.files]
                    return {name: arrays[name] for name in chosen}
    except DAMAGES:
        return {}
    raise InputError(
        f"{path} holds {size / 2**20:.0f} MiB of arrays, more than the {most // 2**20} MiB that"
        " belong in it; do not trust it"
    )


# what zipfile and NumPy raise for a damaged archive
DAMAGES = (
    zipfile.BadZipFile, zlib.error, OSError, ValueError, EOFError, RuntimeError, MemoryError,
    KeyError, TypeError, SyntaxError, AttributeError, OverflowError,
)  # fmt: skip


def _line(error: BaseException) -> str:
    return (" ".join(str(error).split()) or type(error).__name__)[:120]


def vet_stem(path: str | Path, *suffixes: str) -> list[Path]:
    """The files `path` with each of the suffixes, if they can be written; see `vet_output`."""
    stem = Path(path)
    if not stem.name:
        vet_output(stem)
    return [vet_output(stem.with_suffix(suffix)) for suffix in suffixes]


def _unwritable(path: str | Path, error: OSError | UnicodeError) -> str:
    why = getattr(error, "strerror", None) or _line(error)
    return f"{path} cannot be written: {why}; make room there or give another path"
