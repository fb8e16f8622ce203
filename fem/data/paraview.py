"""A simulation as files for ParaView: one VTU a frame, a PVD with the time of each, and the
energies as a table."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import meshio
import numpy as np

from fem.errors import InputError
from fem.files import make_folder, plain_name, replacing, vet_output, write_text
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MM
from fem.ranges import shown


def write_sequence(
    folder: str | Path,
    name: str,
    mesh: HexMesh,
    time: np.ndarray,
    fields: Mapping[str, np.ndarray],
    energy: Mapping[str, np.ndarray] | None = None,
) -> Path:
    """Write a simulation as <folder>/<name>.pvd, the frames in <folder>/<name>/, and
    <name>-energy.csv.

    mesh: HexMesh (m); time: (frames,) s; fields: {name: (frames, N, 3)} at the nodes, such as
    `displacement` in mm and `force` in mN; energy: {column: (frames,)} in J.

    Every frame has the mesh at rest (mm; ParaView's filter Warp By Vector moves it), the fields and
    `fixed` at the nodes, and from `displacement` also `J`, the mean volume ratio, of the cells.
    Returns the path of the PVD, which is written last. Raises InputError if `folder` cannot be
    made, and for a field of another shape.
    """
    folder = vet_output(folder, folder=True)
    plain_name(name, "name")
    if not (np.isfinite(time).all() and (np.diff(time) > 0).all()):
        raise InputError(f"the times {shown(np.asarray(time))} s must be finite and ascend")
    for field, values in fields.items():
        if np.shape(values) != (len(time), mesh.n_nodes, 3):
            raise InputError(
                f"the field '{field}' has shape {np.shape(values)}; {len(time)} frames of"
                f" {mesh.n_nodes} nodes need {(len(time), mesh.n_nodes, 3)}"
            )
        if not np.isfinite(values).all():
            raise InputError(f"the field '{field}' has values that are not finite")
    for column, values in (energy or {}).items():
        if np.shape(values) != np.shape(time):
            raise InputError(f"the energy '{column}' has not one value for each of the times")
    make_folder(folder / name)
    entries = []
    for frame, moment in enumerate(time):
        file = f"{name}/frame_{frame:04d}.vtu"
        at = {field: np.asarray(values[frame], float) for field, values in fields.items()}
        with replacing(folder / file) as partial:
            _frame(mesh, at).write(partial)
        entries.append(f'    <DataSet timestep="{moment:.9g}" part="0" file="{file}"/>')
    if energy:
        write_text(folder / f"{name}-energy.csv", _table(time, energy))
    collection = folder / f"{name}.pvd"
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    write_text(collection, head + "\n".join(entries) + "\n  </Collection>\n</VTKFile>\n")
    return collection


def _frame(mesh, fields):
    """meshio's mesh of one frame."""
    points, cell_data = mesh.points * MM, {}
    if "displacement" in fields:
        moved = cell_volumes(points + fields["displacement"], mesh.cells)
        cell_data["J"] = [moved / cell_volumes(points, mesh.cells)]
    return meshio.Mesh(
        points,
        [("hexahedron", mesh.cells)],
        point_data={**fields, "fixed": mesh.fixed.astype(np.uint8)},
        cell_data=cell_data,
    )


def _table(time, energy):
    """The energies as CSV."""
    table = io.StringIO(newline="")
    rows = csv.writer(table, lineterminator="\n")
    units = [name if name == "imbalance" else f"{name} (J)" for name in energy]
    rows.writerow(["time (s)", *units])
    columns = [np.asarray(values).tolist() for values in (time, *energy.values())]
    rows.writerows(zip(*columns, strict=True))
    return table.getvalue()


def cell_volumes(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Volumes (E,) of hexahedra with corners at `points` (N, 3), in their unit cubed."""
    return element.gauss_volumes(points, cells).sum(axis=1)
