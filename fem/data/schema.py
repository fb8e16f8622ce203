"""What the HDF5 file of a dataset holds, in names, units, types and shapes; docs/data.md says it in
words."""

import math
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from fem.contact.table import TABLE
from fem.data.scene import Scene
from fem.errors import InputError

FORMAT = "unet-fem dataset 2"
FIRST_FORMAT = "unet-fem dataset 1"  # no contacts, and the mesh in mm or only on the grid
UNITS = {
    "force": "mN",
    "displacement": "mm",
    "volume": "mm3",
    "points": "mm",
    "time": "s",
    "energy": "J",
    "mesh/force": "mN",
    "mesh/displacement": "mm",
    "mesh/points": "m",
}
# a row for each interaction that was simulated again at the true mass; error: relative L2
CONFIRMATION = np.dtype([("split", "S10"), ("number", "i8"), ("error", "f8")])
TABLES = {"contacts": TABLE, "confirmation": CONFIRMATION}
FIELDS = ("force", "displacement")
# kinds of type and shape of what every file holds: I interactions, F frames, a grid of x, y, z
# nodes and E cells
SCHEMA = {
    "time": ("f", "F"),
    "split": ("S", "I"),
    "number": ("iu", "I"),
    "hard": ("b", "I"),
    "mask": ("b", "xyz"),
    "fixed": ("b", "xyz"),
    "points": ("f", "xyz3"),
    "cells": ("iu", "E8"),
    "force": ("f", "IFxyz3"),
    "displacement": ("f", "IFxyz3"),
    "volume": ("f", "IF"),
}
# of newer files and of embedded meshes: N nodes, C cells, K contacts, R interactions that were
# simulated again, and one size of its own each
OPTIONAL = {
    "energy": ("f", "IFe"),
    "contacts": ("V", "IK"),
    "confirmation": ("V", "R"),
    "mesh/points": ("f", "N3"),
    "mesh/cells": ("iu", "C8"),
    "mesh/fixed": ("b", "N"),
    "mesh/loaded": ("b", "N"),
    "mesh/grid_index": ("iu", "N"),
    "mesh/node_sets": ("b", "nN"),
    "mesh/cell_sets": ("b", "cC"),
    "mesh/force": ("f", "IFN3"),
    "mesh/displacement": ("f", "IFN3"),
}


MESH = ("mesh/points", "mesh/cells", "mesh/fixed")  # every file but those of FIRST_FORMAT
# which of them are read when a file is opened, and how large they may be: what is larger is damaged
AT_ONCE = ("time", "split", "number", "hard", "mask", "fixed", "points", "cells", "volume")
LARGEST = 2**30  # bytes


def check_members(file: h5py.File, path: Path) -> None:
    """Raises InputError that names a member that is missing, of another type or shape than the
    others ask for, larger than any dataset's, or a link: a dataset lies in one file."""
    check_links(file, path)
    sizes: dict[str, int] = {digit: int(digit) for digit in "38"}
    for name, (kinds, axes) in (SCHEMA | OPTIONAL).items():
        if name not in file:
            if name in OPTIONAL:
                continue
            raise damaged(path, f"it has no '{name}'")
        member = file[name]
        if not isinstance(member, h5py.Dataset):
            raise damaged(path, f"'{name}' is a group, not an array")
        shape = member.shape or ()
        fits = len(shape) == len(axes) and member.dtype.kind in kinds
        if fits:
            wanted = tuple(sizes.setdefault(axis, n) for axis, n in zip(axes, shape, strict=True))
            fits = shape == wanted
        if not fits:
            sides = ", ".join(str(sizes.get(axis, "any")) for axis in axes)
            raise damaged(
                path, f"'{name}' is {member.dtype} of shape {shape}, not of shape ({sides})"
            )
        if name in AT_ONCE and member.nbytes > LARGEST:
            raise damaged(path, f"'{name}' would take {member.nbytes / 2**30:.0f} GiB")
    nodes = math.prod(sizes[axis] for axis in "xyz")
    for axis, most, name in (("E", nodes, "cells"), ("C", 8 * sizes.get("N", 0), "mesh/cells")):
        if sizes.get(axis, 0) > most:
            raise damaged(path, f"'{name}' has {sizes[axis]} rows, more than its nodes allow")
    if file.attrs.get("format") == FORMAT:
        for name in MESH:
            if name not in file:
                raise damaged(path, f"it has no '{name}'")
    for name, kind in TABLES.items():
        if name in file and file[name].dtype != kind:
            raise damaged(path, f"'{name}' has the columns {file[name].dtype.names}")


def check_links(group: h5py.Group, path: Path) -> None:
    """Raises InputError unless all that is in the file lies in it: no soft or external link, no
    array whose bytes are in another file."""
    for name in group:
        inside = f"{group.name}/{name}".lstrip("/")
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise damaged(path, f"'{inside}' is a link; all must lie in the file itself")
        member = group[name]
        if isinstance(member, h5py.Dataset) and (member.external or member.is_virtual):
            raise damaged(path, f"the bytes of '{inside}' are in another file")
        if isinstance(member, h5py.Group):
            if group.name != "/":
                raise damaged(path, f"it has a group '{inside}' that no dataset has")
            check_links(member, path)


def check_contents(path: Path, arrays: Mapping[str, np.ndarray], scene: Scene) -> None:
    """Raises InputError that names one of the arrays AT_ONCE whose values do not fit the others or
    the scene that the file is of."""
    order, times = scene.interactions.all(), scene.frames.times
    time, mask, cells = arrays["time"], arrays["mask"], arrays["cells"]
    if not np.isfinite(arrays["volume"]).all():
        raise damaged(path, "values are not finite in volume")
    hard = [scene.interactions.is_hard(*which) for which in order]
    for name, holds in (
        ("time", time.shape == times.shape and np.allclose(time, times, 1e-9, 0)),
        ("split", arrays["split"].tolist() == [split.encode() for split, _ in order]),
        ("number", arrays["number"].tolist() == [number for _, number in order]),
        ("hard", arrays["hard"].tolist() == hard),
        ("mask", mask.any()),
        ("fixed", not (arrays["fixed"] & ~mask).any() and (mask & ~arrays["fixed"]).any()),
        ("points", np.isfinite(arrays["points"][mask]).all()),
        ("cells", len(cells) and 0 <= cells.min() <= cells.max() < mask.size),
        ("cells", len(cells) and cells.max() < mask.size and mask.ravel()[cells].all()),
        ("volume", not (arrays["volume"] <= 0).any()),
    ):
        if not holds:
            raise damaged(path, f"the values of '{name}' are not those of its scene's interactions")


def damaged(path: Path, what: str) -> InputError:
    """The error of a file that is not as it was written."""
    return InputError(f"{path} is damaged: {what}; delete it and generate it again")
