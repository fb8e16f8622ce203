"""The mesh of a scene: one of the shapes, a file, or a HexMesh that is at hand."""

import functools
import hashlib
from dataclasses import InitVar, dataclass, fields, replace
from pathlib import Path
from typing import Literal

from fem import settings as config
from fem.errors import InputError
from fem.mesh.embedding import Embedding
from fem.mesh.hexmesh import HexMesh
from fem.mesh.node_grid import node_grid
from fem.mesh.read import check_held, read_mesh
from fem.mesh.shapes import TUMOUR_EDGE, box, tumour
from fem.ranges import number

# which settings of MeshChoice mean something for which kind of mesh, and what they are if left out
MESH_KINDS: dict[str, dict[str, object]] = {
    "tumour": {"edge": TUMOUR_EDGE},
    "box": {"edge": TUMOUR_EDGE, "cells": (16, 16, 7), "fixed": "all but top", "loaded": None},
    "file": {
        "file": None,
        "scale": 1.0,
        "fixed": None,
        "loaded": None,
        "grid": None,
        "sha256": None,
    },
    "given": {"grid": None, "sha256": None},
}


@dataclass(frozen=True)
class MeshChoice:
    """kind: "tumour", "box", "file" or "given" ("file" if a file is given, else "tumour").

    edge: of a cube of the tumour or box, m; cells: of the box along x, y, z
    file: mesh to read, relative to the scene file; scale: m per unit of length in it, 1 if left out
    fixed, loaded: selections of the held nodes and of the surface to push on, see fem.mesh.select
    and fem.mesh.read; a box is held "all but top" if left out
    grid: (nx, ny, nz) nodes of the grid to embed the mesh in, also if it lies on one of its own
    sha256: of the mesh file, which load_scene fills in, or of a given mesh (HexMesh.digest), so
    that another mesh makes another scene
    folder: of the scene file, where `file` is looked for; mesh: of kind "given", see
    Scene.with_mesh. Neither is part of the scene's text.
    """

    kind: Literal["tumour", "box", "file", "given"] | None = None
    edge: float | None = number(1e-6, 10, "m", default=None)
    cells: tuple[int, int, int] | None = number(1, 10_000, default=None)
    file: str | None = None
    scale: float | None = number(1e-9, 1e3, "m", default=None)
    fixed: str | None = None
    loaded: str | None = None
    grid: tuple[int, int, int] | None = number(2, 10_000, default=None)
    sha256: str | None = None
    folder: InitVar[str | Path] = ""
    mesh: InitVar[HexMesh | None] = None

    def __post_init__(self, folder: str | Path, mesh: HexMesh | None) -> None:
        config.normalised(self, "mesh")
        set_ = object.__setattr__
        set_(self, "folder", str(folder))
        set_(self, "mesh", mesh)
        set_(self, "kind", kind := self.kind or ("file" if self.file else "tumour"))
        unused = [own.name for own in fields(self)[1:] if own.name not in MESH_KINDS[kind]]
        config.refuse_unused(self, unused, "mesh", f"mesh.kind = '{kind}'")
        for name, usual in MESH_KINDS[kind].items():
            if getattr(self, name) is None:
                set_(self, name, usual)
        if kind == "file" and not self.file:
            raise InputError("mesh.kind = 'file' needs mesh.file, such as 'liver.vtu'")

    def located(self, folder: str | Path | None) -> "MeshChoice":
        """This choice with its file found in `folder` and its content known."""
        if self.kind != "file" or self.file is None:
            return self
        path = None if folder is None else Path(folder, self.file)
        if folder is None or path is None or not path.is_file():
            raise InputError(
                f"no mesh file {path or self.file}; mesh.file is relative to the scene file (the"
                " mesh of a dataset is in it: dataset.fem_mesh)"
            )
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        if self.sha256 not in (None, sha256):
            raise InputError(
                f"{path} is another mesh than mesh.sha256 = '{self.sha256}' says; restore the"
                " mesh or leave mesh.sha256 out"
            )
        return replace(self, sha256=sha256, folder=folder)

    def detached(self) -> "MeshChoice":
        """This choice without the right to read its file: that of a dataset's scene."""
        choice = replace(self, mesh=self.mesh)  # type: ignore[attr-defined]
        object.__setattr__(choice, "folder", None)
        return choice

    def build(self) -> HexMesh:
        """The HexMesh, with its node grid if it lies on one and none is asked for.

        Built once in a process, also for an equal choice; a mesh file is known by its content.
        """
        # InitVars with a default are attributes; mypy does not know
        mesh: HexMesh | None = self.mesh  # type: ignore[attr-defined]
        if self.kind == "given":
            if mesh is None:
                raise InputError(
                    "the mesh of this scene was given as an object and is not in its text; take"
                    " scene.with_mesh(dataset.fem_mesh)"
                )
            return mesh
        return _build(self.located(self.folder))  # type: ignore[attr-defined]

    @property
    def content(self) -> str | None:
        """What tells this mesh from any other: the digest of a tumour or box as it is built, else
        `sha256`."""
        return self.build().digest if self.kind in ("tumour", "box") else self.sha256

    def embed(self, hex_mesh: HexMesh) -> Embedding | None:
        """The Embedding of a mesh that `build` gave, or None if it lies on a node grid itself."""
        return Embedding(hex_mesh, self.grid) if hex_mesh.grid is None else None


@functools.lru_cache(maxsize=8)
def _build(choice):
    if choice.kind == "tumour":
        return tumour(choice.edge)
    if choice.kind == "box":
        mesh = box(choice.cells, choice.edge, choice.fixed).with_sets(loaded=choice.loaded)
        check_held(mesh)
        return mesh
    mesh = read_mesh(Path(choice.folder, choice.file), choice.scale, choice.fixed, choice.loaded)
    return mesh if choice.grid else on_own_grid(mesh)


def on_own_grid(mesh: HexMesh) -> HexMesh:
    """`mesh` on the node grid in its connectivity, if it has one."""
    return replace(mesh, grid=mesh.grid or node_grid(mesh))
