"""What the HDF5 file of a dataset holds, in names, units, types and shapes; docs/data.md says it in
words."""

from pathlib import Path

import h5py
import numpy as np

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


def check_members(file: h5py.File, path: Path) -> None:
    """Raises InputError that names a member that is missing, or of another type or shape than the
    others ask for."""
    sizes: dict[str, int] = {digit: int(digit) for digit in "38"}
    for name, (kinds, axes) in (SCHEMA | OPTIONAL).items():
        if name not in file:
            if name in OPTIONAL:
                continue
            raise InputError(
                f"{path} is damaged: it has no '{name}'; delete it and generate it again"
            )
        member = file[name]
        shape = getattr(member, "shape", ())
        fits = len(shape) == len(axes) and member.dtype.kind in kinds
        if fits:
            wanted = tuple(sizes.setdefault(axis, n) for axis, n in zip(axes, shape, strict=True))
            fits = shape == wanted
        if not fits:
            kind = getattr(member, "dtype", "a group")
            sides = ", ".join(str(sizes.get(axis, "any")) for axis in axes)
            raise InputError(
                f"{path} is damaged: '{name}' is {kind} of shape {shape}, not of shape ({sides});"
                " delete it and generate it again"
            )
