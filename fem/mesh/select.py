"""Which nodes of a mesh a scene means by "base", "z min", "x > 0.01" or "all but top".

A selection is a list of terms, separated by commas; a node is selected if any term holds for it:

    z min, z max        the lowest or highest nodes along an axis
    z < 0.001, x > 2    a half-space, in m (after mesh.scale)
    base                a node set of the mesh: from its file a physical group, cell or point set,
                        or data that are not zero; "top" and "bottom" of a box
    marker = 3          data from the mesh file that have this value

With "all but " before the list it is turned round on the boundary: the nodes of every boundary face
that is not wholly selected. So "all but top" keeps the rim of the top.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from fem.errors import InputError

if TYPE_CHECKING:
    from fem.mesh.hexmesh import HexMesh

TOLERANCE = 1e-6  # of the mesh's extent, for min and max: files are often written with seven digits
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def value_set(name: str, value: float) -> str:
    """Name of the node or cell set of the data `name` that have `value`: "marker = 3"."""
    return f"{name} = {float(value):.12g}"


def select(text: str, mesh: HexMesh, what: str) -> np.ndarray:
    """(N,) bool: the nodes of `mesh` that `text` selects.

    what: key of the scene, for messages, as in "mesh.fixed". Raises InputError for a name that is
    no node set of the mesh and for a selection without nodes.
    """
    terms, opposite = text.strip(), text.strip().startswith("all but ")
    if opposite:
        terms = terms.removeprefix("all but ")
    found = np.zeros(mesh.n_nodes, bool)
    for term in terms.split(","):
        chosen = _term(term.strip(), mesh, what)
        if not chosen.any():
            low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
            ranges = ", ".join(
                f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True)
            )
            raise InputError(
                f"{what}: '{term.strip()}' selects no node; the mesh spans {ranges} m (mesh.scale"
                " turns its lengths into m)"
            )
        found |= chosen
    if opposite:
        faces = mesh.boundary_faces
        others = faces[~found[faces].all(axis=1)]
        found = np.zeros(mesh.n_nodes, bool)
        found[others] = True
    if not found.any():
        raise InputError(
            f"{what} = '{text}' selects no node; the terms after 'all but' already hold the whole"
            " boundary"
        )
    return found


def _term(term, mesh, what):
    points = mesh.points
    extreme = re.fullmatch(r"([xyz])\s*(min|max)", term)
    if extreme:
        x = points[:, "xyz".index(extreme[1])]
        edge = x.min() if extreme[2] == "min" else x.max()
        return np.abs(x - edge) <= TOLERANCE * np.ptp(points, axis=0).max()
    half_space = re.fullmatch(rf"([xyz])\s*([<>])\s*({NUMBER})", term)
    if half_space:
        x, limit = points[:, "xyz".index(half_space[1])], float(half_space[3])
        return x < limit if half_space[2] == "<" else x > limit
    return mesh.node_sets[_name(term, mesh.node_sets, what)]


def _name(term, sets, what):
    if term in sets:
        return term
    value = re.fullmatch(rf"(.+?)\s*=\s*({NUMBER})", term)
    if value and value_set(value[1], float(value[2])) in sets:
        return value_set(value[1], float(value[2]))
    if value and value[1] in sets:
        values = sorted(name for name in sets if name.startswith(f"{value[1]} = "))
        raise InputError(
            f"{what}: '{term}' selects no node; there is {', '.join(values) or f'only {value[1]}'}"
        )
    known = ", ".join(sorted(name for name in sets if " = " not in name)) or "none"
    raise InputError(
        f"{what}: '{term}' is neither a name in the mesh file (it has: {known}) nor a condition"
        " such as 'z min', 'z < 0.001' or 'all but z max'"
    )
