"""A simulated interaction as files for ParaView: one VTU a frame, a PVD with the time of each, and
the energies as a table."""

import csv
from pathlib import Path

import meshio
import numpy as np

from fem.errors import InputError
from fem.mesh import element


def write_sequence(folder, name, sequence):
    """Write the fem.data.dataset.Sequence `sequence` as <folder>/<name>.pvd, the frames in
    <folder>/<name>/, and <name>-energy.csv.

    Every frame has the mesh at rest (mm), `displacement` (mm; ParaView's filter Warp By Vector
    moves the mesh), `force` (mN) and `fixed` at the nodes, and `J`, the mean volume ratio, of the
    cells. Returns the path of the PVD, which is written last. Raises InputError if `folder` cannot
    be made.
    """
    folder = Path(folder)
    try:
        (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot make the folder {folder / name} ({error.strerror}); give another place to write to"
        ) from None
    mesh = sequence.mesh
    rest = cell_volumes(mesh.points, mesh.cells)
    entries = []
    for frame, time in enumerate(sequence.time):
        file = f"{name}/frame_{frame:04d}.vtu"
        u = sequence.displacement[frame].astype(float)
        meshio.Mesh(
            mesh.points,
            [("hexahedron", mesh.cells)],
            point_data={
                "displacement": u,
                "force": sequence.force[frame].astype(float),
                "fixed": mesh.fixed.astype(np.uint8),
            },
            cell_data={"J": [cell_volumes(mesh.points + u, mesh.cells) / rest]},
        ).write(folder / file)
        entries.append(f'    <DataSet timestep="{time:.9g}" part="0" file="{file}"/>')
    if sequence.energy:
        with open(folder / f"{name}-energy.csv", "w", newline="") as table:
            rows = csv.writer(table)
            rows.writerow(
                [
                    "time (s)",
                    *(
                        column if column == "imbalance" else f"{column} (J)"
                        for column in sequence.energy
                    ),
                ]
            )
            rows.writerows(
                zip(
                    sequence.time.tolist(),
                    *(values.tolist() for values in sequence.energy.values()),
                )
            )
    collection = folder / f"{name}.pvd"
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    collection.write_text(head + "\n".join(entries) + "\n  </Collection>\n</VTKFile>\n")
    return collection


def cell_volumes(points, cells):
    """Volumes (E,) of hexahedra with corners at `points` (N, 3), in their unit cubed."""
    return np.linalg.det(element.jacobians(points, cells, element.GAUSS)).sum(axis=1)
