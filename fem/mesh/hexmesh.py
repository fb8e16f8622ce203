"""Hexahedral meshes: checked once, never changed, equal when their content is equal."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fem.errors import InputError
from fem.mesh import element
from fem.mesh.contact_faces import contact_surface
from fem.mesh.places import boundary_faces
from fem.mesh.select import select
from fem.online.grid import NodeGrid
from fem.ranges import shown


@dataclass(frozen=True, eq=False)
class HexMesh:
    """Eight-node hexahedra, their nodes in VTK order:

              7--------6
             /|       /|
            4--------5 |     z
            | |      | |     | y
            | 3------|-2     |/
            |/       |/      +--x
            0--------1

    points: (N, 3) reference node positions, m
    cells: (E, 8) node numbers
    fixed: (N,) bool, nodes held at zero displacement
    grid: the NodeGrid that the nodes lie on, or None
    loaded: (N,) bool, nodes of the surface that contact may push on; None for every free face
    node_sets, cell_sets: {name: (N,) bool} and {name: (E,) bool}; see `with_sets`
    congruent: every cell is the same parallelepiped, so one gradient matrix serves all

    The arrays are kept as read-only copies. Raises InputError that names an array of the wrong
    shape or type, a node at no place, and a cell that is inverted, degenerate, given twice, of
    nodes that are not there or third at a face.

    >>> from fem.mesh.shapes import box
    >>> mesh = box((4, 3, 2), edge=1e-3).with_sets(fixed="z min, x min", loaded="top", tip="x max")
    >>> int(mesh.node_sets["tip"].sum())
    12
    """

    points: np.ndarray
    cells: np.ndarray
    fixed: np.ndarray
    grid: NodeGrid | None = None
    loaded: np.ndarray | None = None
    node_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    cell_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    congruent: bool = field(init=False)

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "points", _kept("points", self.points, (None, 3), "fiu", float))
        set_(self, "cells", _kept("cells", self.cells, (None, 8), "iu", np.intp))
        n, e = len(self.points), len(self.cells)
        set_(self, "fixed", _kept("fixed", self.fixed, (n,), "b", bool))
        if self.loaded is not None:
            set_(self, "loaded", _kept("loaded", self.loaded, (n,), "b", bool))
        if self.grid is not None and not isinstance(self.grid, NodeGrid):
            raise InputError(f"the mesh's grid is {self.grid!r}; give a NodeGrid, or None")
        for kind, rows in (("node_sets", n), ("cell_sets", e)):
            if not isinstance(getattr(self, kind), Mapping) or not all(
                isinstance(name, str) for name in getattr(self, kind)
            ):
                raise InputError(f"the mesh's {kind} must be arrays by name")
            sets = {
                name: _kept(f"{kind}['{name}']", values, (rows,), "b", bool)
                for name, values in getattr(self, kind).items()
            }
            set_(self, kind, sets)
        if self.grid is not None and self.grid.n_nodes != n:
            raise InputError(
                f"the mesh's grid has places for {self.grid.n_nodes} nodes, and the mesh has {n}"
            )
        check_cells(self.points, self.cells)
        _ = self.boundary_faces  # refuses a face of three cells
        corners = self.points[self.cells]
        edges = corners - corners[:, :1]  # (E, 8, 3)
        same = np.abs(edges - edges[0]).max() < 1e-9 * np.abs(edges[0]).max()
        warp = np.abs(element.HOURGLASS @ edges[0]).max() < 1e-9 * np.abs(edges[0]).max()
        set_(self, "congruent", bool(same and warp))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the content: equal meshes have equal digests, in every process."""
        found = hashlib.sha256()
        parts = {"points": self.points, "cells": self.cells, "fixed": self.fixed}
        if self.loaded is not None:
            parts["loaded"] = self.loaded
        if self.grid is not None:
            parts[f"grid {self.grid.shape}"] = self.grid.index
        for kind in ("node_sets", "cell_sets"):
            parts |= {f"{kind} {name}": own for name, own in sorted(getattr(self, kind).items())}
        for name, values in parts.items():
            found.update(f"{name} {values.shape}\n".encode() + values.tobytes())
        return found.hexdigest()

    def __eq__(self, other: object) -> bool:
        return self is other or isinstance(other, HexMesh) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    @property
    def n_nodes(self) -> int:
        return len(self.points)

    @property
    def n_cells(self) -> int:
        return len(self.cells)

    @property
    def grid_shape(self) -> tuple[int, ...] | None:
        """(nx, ny, nz) of `grid`, or None."""
        return None if self.grid is None else self.grid.shape

    @property
    def grid_index(self) -> np.ndarray | None:
        """(N,) place of each node in `grid`, or None."""
        return None if self.grid is None else self.grid.index

    def with_sets(
        self,
        fixed: str | np.ndarray | None = None,
        loaded: str | np.ndarray | None = None,
        **named: str | np.ndarray,
    ) -> "HexMesh":
        """This mesh with other held and loaded nodes, and further sets under their names.

        Each is a selection of nodes (see fem.mesh.select), or an array, (N,) bool for nodes or (E,)
        bool for cells. A name given again replaces its set.
        """

        def nodes(name, given):
            return select(given, self, f"mesh.{name}") if isinstance(given, str) else given

        cells = {
            name: own
            for name, own in named.items()
            if not isinstance(own, str) and np.shape(own) == (self.n_cells,) != (self.n_nodes,)
        }
        of_nodes = {name: nodes(name, own) for name, own in named.items() if name not in cells}
        return replace(
            self,
            fixed=self.fixed if fixed is None else nodes("fixed", fixed),
            loaded=self.loaded if loaded is None else nodes("loaded", loaded),
            node_sets={**self.node_sets, **of_nodes},
            cell_sets={**self.cell_sets, **cells},
        )

    def volume(self, displacement: np.ndarray | None = None) -> float:
        """Volume in m3, of the mesh displaced by `displacement` (N, 3) m if given; exact for
        trilinear cells."""
        points = self.points
        if displacement is not None:
            if np.shape(displacement) != points.shape or not np.isfinite(displacement).all():
                raise InputError(
                    f"a displacement of shape {np.shape(displacement)} must be finite and"
                    f" {points.shape}"
                )
            points = points + displacement
        return float(element.gauss_volumes(points, self.cells).sum())

    @cached_property
    def boundary_faces(self) -> np.ndarray:
        """(M, 4) node numbers of the faces that belong to one cell only, counter-clockwise seen
        from outside."""
        return boundary_faces(self.cells)

    @cached_property
    def free_faces(self) -> np.ndarray:
        """(M, 4) the boundary faces of the loaded surface with a node that is not fixed."""
        faces = self.boundary_faces
        free = ~self.fixed[faces].all(axis=1)
        return faces[free if self.loaded is None else free & self.loaded[faces].all(axis=1)]

    @cached_property
    def contact_faces(self) -> np.ndarray:
        """(M, 4) the free faces that contacts push on: those that look up, see
        fem.mesh.contact_faces."""
        return self._contact_surface[0]

    @cached_property
    def contact_rim(self) -> np.ndarray:
        """(n,) the nodes around the surface that contacts push on, see fem.mesh.contact_faces."""
        return self._contact_surface[1]

    @cached_property
    def _contact_surface(self):
        return contact_surface(self)


def checked_mesh(mesh: HexMesh) -> HexMesh:
    """The mesh. Raises InputError for what is none."""
    if not isinstance(mesh, HexMesh):
        raise InputError(f"the mesh is {shown(mesh)}; give a HexMesh")
    return mesh


def check_cells(points: np.ndarray, cells: np.ndarray) -> None:
    """Raises InputError that names one of the cells (E, 8), whose nodes are not among the points
    (N, 3), or that is inverted, degenerate or given twice, and a point at no place."""
    if not np.isfinite(points).all():
        raise InputError(
            f"node {int(np.argmin(np.isfinite(points).all(1)))} has a position that is not finite"
        )
    if not len(cells):
        raise InputError("the mesh has no cells; give at least one hexahedron")
    wrong = np.flatnonzero(((cells < 0) | (cells >= len(points))).any(axis=1))
    if wrong.size:
        raise InputError(
            f"cell {wrong[0]} (nodes {cells[wrong[0]].tolist()}) uses a node that is not there; the"
            f" mesh has the nodes 0 to {len(points) - 1}"
        )
    corners = points[cells]
    size = np.abs(corners - corners[:, :1]).max()
    detJ = np.linalg.det(
        element.jacobians(points, cells, np.vstack([element.CORNERS, element.CENTRE]))
    )
    bad = np.flatnonzero(detJ.min(axis=1) <= 1e-9 * size**3)
    if bad.size:
        e, corner = bad[0], int(detJ[bad[0]].argmin())
        place = f"at its corner {corner}" if corner < 8 else "at its centre"
        raise InputError(
            f"cell {e} (nodes {cells[e].tolist()}) is inverted or degenerate: Jacobian"
            f" {detJ[e].min():.3g} {place}"
            f" ({bad.size} such cells); list its nodes in VTK order and repair its shape"
        )
    _, first, inverse = np.unique(
        np.sort(cells, axis=1), axis=0, return_index=True, return_inverse=True
    )
    if len(first) < len(cells):
        first = first[inverse.ravel()]
        e = np.flatnonzero(first != np.arange(len(cells)))[0]
        raise InputError(
            f"cell {e} (nodes {cells[e].tolist()}) is cell {first[e]} once more;"
            " give each cell once"
        )


def _kept(name, values, shape, kinds, dtype):
    """A read-only copy of an array. Raises InputError for another shape, None being any length, or
    type."""
    try:
        values = np.asarray(values)
    except ValueError:
        raise InputError(f"the mesh's {name} has rows of different lengths") from None
    fits = len(shape) == values.ndim and all(
        want in (None, have) for want, have in zip(shape, values.shape, strict=True)
    )
    if not fits or values.dtype.kind not in kinds:
        what = {"b": "bool", "iu": "whole numbers"}.get(kinds, "real numbers")
        sizes = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(
            f"the mesh's {name} is {values.dtype} of shape {values.shape}; give {what} of shape"
            f" ({sizes}{',' if len(shape) == 1 else ''})"
        )
    if values.dtype == dtype and values.flags.owndata and not values.flags.writeable:
        return values  # it is one of ours
    values = np.array(values, dtype, order="C")
    values.flags.writeable = False
    return values
