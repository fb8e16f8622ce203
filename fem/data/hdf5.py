"""HDF5 files that are written whole or not at all, also where the disk is full.

HDF5 cannot close a file that it cannot write, and ends the process later. So its writes go through
a file that keeps the first error, lets what follows go nowhere, and raises when HDF5 is done.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from fem.files import replacing


@contextmanager
def new_hdf5(path: str | Path) -> Iterator[h5py.File]:
    """An HDF5 file to fill, which takes the place of `path` at the end. Raises InputError where it
    cannot be written."""
    with replacing(path) as partial, open(partial, "w+b", buffering=0) as raw:
        held = _Held(raw)
        try:
            with h5py.File(held, "w") as file:
                yield file
        finally:
            if held.error:
                raise held.error


class _Held:
    """A raw file that remembers the first error of a write in place of raising it."""

    def __init__(self, raw):
        self.raw, self.error = raw, None

    def write(self, data):
        view = memoryview(data).cast("B")
        done = 0
        while not self.error and done < len(view):
            try:
                done += self.raw.write(view[done:])
            except OSError as error:
                self.error = error
        return len(view)

    def readinto(self, buffer):
        view = memoryview(buffer).cast("B")
        count = self.raw.readinto(view)
        view[count:] = bytes(len(view) - count)  # of what was not written
        return len(view)

    def read(self, size=-1):  # by which h5py knows a file
        return self.raw.read(size)

    def truncate(self, size=None):
        try:
            return self.raw.truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size

    def seek(self, *where):
        return self.raw.seek(*where)

    def tell(self):
        return self.raw.tell()

    def flush(self):
        pass
