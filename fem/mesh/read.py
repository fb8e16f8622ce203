"""Hexahedral meshes from files (VTK, Gmsh, Abaqus and whatever else meshio reads)."""

import base64
import contextlib
import io
import re
import struct
from pathlib import Path

import meshio
import numpy as np
import scipy.sparse

from fem.errors import InputError
from fem.mesh.hexmesh import HexMesh, check_cells
from fem.mesh.select import value_set

MOST_VALUES = 256  # of a field in the file that is turned into sets, "marker = 3" and so on


def read_mesh(
    path: str | Path,
    scale: float = 1.0,
    fixed: str | None = None,
    loaded: str | None = None,
) -> HexMesh:
    """The HexMesh in the file at `path`, without a node grid; see fem.mesh.node_grid for that.

    scale: metres per unit of length in the file. fixed, loaded: selections (see fem.mesh.select) of
    the nodes that are held and of the surface that is pushed on; without `loaded`, that is every
    boundary face that is not held. The names of the file become its node and cell sets.

    Cells keep the file's order, counted from 0 over its hexahedra. Points that no hexahedron uses
    are dropped; cells of lower dimension only serve to select. Nothing is repaired: raises
    InputError that names a cell which is not a linear hexahedron, inverted (its nodes not in VTK
    order) or degenerate, a part that is not held, and a wrong selection.
    """
    path = Path(path)
    file = _read(path)
    try:
        cells, points = _hexahedra(file), file.points * float(scale)
        used = np.unique(cells)
        check_cells(points, cells)  # with all points of the file: an error names its own numbers
        node_sets, cell_sets = _sets(file)
        mesh = HexMesh(
            points[used],
            np.searchsorted(used, cells),
            np.zeros(len(used), bool),
            node_sets={name: own[used] for name, own in node_sets.items()},
            cell_sets=cell_sets,
        ).with_sets(fixed, loaded)
        check_held(mesh)
        if not len(mesh.free_faces):
            raise InputError(
                f"mesh.loaded = '{loaded}' holds no free boundary face, with all its four nodes"
                " selected and one of them not fixed"
            )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return mesh


XML = (".vtu", ".vtp", ".xdmf", ".xmf", ".dae", ".svg")
BOMB = 2**28  # bytes that the blocks of a compressed file may unpack to


def _vet(path):
    """Raises InputError for a file whose entities or blocks would grow without end as it is read,
    and for one that names other files to read."""
    if path.suffix not in XML:
        return
    data = path.read_bytes()
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(f"{path} has a DOCTYPE, which no mesh needs; save it without")
    if path.suffix in (".xdmf", ".xmf") and re.search(rb'Format\s*=\s*"(?:HDF|Binary)"', data):
        raise InputError(f"{path} has its numbers in another file; save the mesh as one .vtu file")
    # a block's head says how large it is unpacked: meshio believes it and allocates
    found = (base64.b64decode(head) for head in re.findall(rb">\s*([A-Za-z0-9+/]{16})", data))
    for head in found if b"ompressor=" in data else ():
        blocks, size, _ = struct.unpack("<3I", head[:12])
        if blocks < 2**20 and blocks * size > max(BOMB, 100 * len(data)):
            raise InputError(
                f"{path} would unpack to {blocks * size / 2**20:.0f} MiB; do not trust it"
            )


def _read(path):
    """meshio's mesh. Raises InputError where meshio fails, and where it would leave out cells with
    a mere warning."""
    if not path.is_file():
        raise InputError(f"no mesh file {path}; mesh.file is relative to the scene file")
    _vet(path)
    if path.suffix == ".vtu" and path.read_bytes().count(b"<Piece") > 1:
        raise InputError(
            f"{path} has several pieces, of which meshio 5.3 reads one; merge them (ParaView:"
            " Merge Blocks) and save again"
        )
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            file = meshio.read(path)
    # each of its readers fails in its own way on a damaged file, and some leave by sys.exit
    except (Exception, SystemExit) as error:
        words = (
            said.getvalue() if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        )
        raise InputError(
            f"{path} cannot be read as a mesh ({' '.join(words.split())}); save it as .vtu, .msh"
            " or .inp"
        ) from None
    unknown = re.search(r"cannot handle \(type (\d+)\)", said.getvalue())
    if unknown:
        kind = {"11": "voxels"}.get(unknown[1], f"cells of VTK type {unknown[1]}")
        raise InputError(
            f"{path} holds {kind}, which are not read; save its cells as hexahedra (VTK type 12)"
        )
    return file


def _hexahedra(file):
    """(E, 8) point numbers of every hexahedron. Raises InputError naming the first solid cell of
    another type."""
    if file.points.ndim != 2 or file.points.shape[1] != 3:
        raise InputError(
            f"the file's points have shape {file.points.shape}; a solid needs three coordinates"
            " each"
        )
    first = 0
    for block in file.cells:
        if block.type != "hexahedron" and block.dim > 2:
            nodes = np.asarray(block.data[0]).tolist()
            remedy = (
                "save it with linear cells"
                if block.type.startswith("hexahedron")
                else "mesh it with hexahedra"
            )
            raise InputError(
                f"cell {first} of the file (nodes {nodes}) is a {block.type}, one of"
                f" {len(block.data)}; the solver takes 8-node hexahedra only: {remedy}"
            )
        first += len(block.data)
    blocks = [np.asarray(block.data) for block in file.cells if block.type == "hexahedron"]
    if not sum(map(len, blocks)):
        kinds = (
            ", ".join(f"{len(block.data)} {block.type}" for block in file.cells)
            or "no cells at all"
        )
        raise InputError(f"the file has no hexahedron ({kinds}); save the solid cells too")
    cells = np.concatenate(blocks).astype(int)
    wrong = np.flatnonzero(((cells < 0) | (cells >= len(file.points))).any(axis=1))
    if wrong.size:
        raise InputError(
            f"cell {wrong[0]} uses nodes {cells[wrong[0]].tolist()}, but the file has"
            f" {len(file.points)} points; it is damaged"
        )
    return cells


def _sets(file):
    """({name: (P,) bool}, {name: (E,) bool}): the points and the hexahedra of the file under each
    of its names.

    A name is that of a point or cell set, a Gmsh 2 physical group, or data of points or cells (not
    zero); data of few values have sets for each value too. A cell of any kind has all its points.
    """
    node_sets, cell_sets = {}, {}

    def points(name, chosen):
        node_sets.setdefault(name, chosen)

    def cells(name, chosen):  # one array of bool a block of cells
        if name in node_sets:
            return
        rows = [
            np.asarray(block.data)[own].ravel()
            for block, own in zip(file.cells, chosen, strict=True)
        ]
        node_sets[name] = np.isin(np.arange(len(file.points)), np.concatenate(rows))
        solid = [
            own for block, own in zip(file.cells, chosen, strict=True) if block.type == "hexahedron"
        ]
        cell_sets[name] = np.concatenate(solid)

    for name, rows in file.point_sets.items():
        points(name, np.isin(np.arange(len(file.points)), rows))
    for name, rows in file.cell_sets.items():
        if name != "gmsh:bounding_entities":  # meshio's own bookkeeping
            cells(
                name,
                [
                    np.isin(np.arange(len(block.data)), own)
                    for block, own in zip(file.cells, rows, strict=True)
                ],
            )
    for name, chosen in _physical_groups(file):
        cells(name, chosen)
    for name, values in file.point_data.items():
        if np.ndim(values) == 1:
            points(name, np.asarray(values) != 0)
            for value in _few_values([values]):
                points(value_set(name, value), np.asarray(values) == value)
    for name, blocks in file.cell_data.items():
        if all(np.ndim(own) == 1 for own in blocks):
            cells(name, [np.asarray(own) != 0 for own in blocks])
            for value in _few_values(blocks):
                cells(value_set(name, value), [np.asarray(own) == value for own in blocks])
    return node_sets, cell_sets


def _physical_groups(file):
    """(name, [chosen cells of each block]) of the physical groups of Gmsh 2, which meshio has as
    (tag, dimension)."""
    for name, group in file.field_data.items():
        if "gmsh:physical" in file.cell_data and np.size(group) == 2:
            tag, dimension = np.ravel(group)
            tags = zip(file.cells, file.cell_data["gmsh:physical"], strict=True)
            yield name, [(np.asarray(own) == tag) & (block.dim == dimension) for block, own in tags]


def _few_values(arrays):
    """The values of some data, none of them if they are many: such a field marks no parts."""
    values = np.unique(np.concatenate([np.ravel(own) for own in arrays]))
    return values if len(values) <= MOST_VALUES else ()


def check_held(mesh: HexMesh) -> None:
    """Raises InputError if a connected part of the mesh has no fixed node: it would fly away."""
    corner = np.repeat(mesh.cells[:, :1], 8, axis=1).ravel()
    graph = scipy.sparse.coo_matrix(
        (np.ones(mesh.cells.size), (corner, mesh.cells.ravel())), (mesh.n_nodes, mesh.n_nodes)
    )
    parts, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    loose = np.setdiff1d(np.arange(parts), label[mesh.fixed])
    if loose.size:
        cells = np.flatnonzero(label[mesh.cells[:, 0]] == loose[0])
        where = (
            "the mesh"
            if parts == 1
            else f"a part of {len(cells)} cells (cell {cells[0]} is one; the mesh has {parts}"
            " parts)"
        )
        raise InputError(
            f"{where} has no fixed node and would fly away; give mesh.fixed, such as 'z min', or"
            " merge the file's duplicate nodes"
        )
