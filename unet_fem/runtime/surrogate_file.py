"""The file of a surrogate: a .tflite with normalisation and mask in its graph, and behind it, as a
zip archive of NumPy arrays, what the graph does not say.

Format 3 holds all that `write_surrogate` takes. Format 2 lacks what the network sees in place of
the forces, and is written where it sees the forces. Format 1 lacks also the nodes' places in the
grid, the mesh's digest and the label; it opens, but its surrogate takes forces on the grid alone.
"""

import hashlib
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from fem.errors import InputError
from fem.files import load_arrays, write_bytes
from fem.online.input_field import InputField

FORMAT, FORMAT_2, FORMAT_1 = (f"unet-fem surrogate {number}" for number in (3, 2, 1))
LARGEST = 2**28  # bytes that the arrays of one file may take in memory


def write_surrogate(
    path: str | Path,
    model: bytes,
    *,
    mask: np.ndarray,
    index: np.ndarray,
    points: np.ndarray,
    faces: np.ndarray,
    mesh: str,
    interval: float,
    largest_force: tuple[float, float],
    label: str = "",
    field: InputField | None = None,
) -> None:
    """Write a surrogate to `path`, at once or not at all.

    model: bytes of a .tflite file. mask: (nx, ny, nz) bool, the free material nodes. index: (N,)
    places of the mesh's nodes in the grid, see fem.online.grid.NodeGrid; none of a mesh that is
    embedded in the grid, whose nodes lie elsewhere. points: (nx*ny*nz, 3) mm.
    faces: (M, 4) grid nodes of the boundary quads, counter-clockwise seen from outside. mesh: a
    digest that tells this mesh from others. interval: s between the frames of a force window.
    largest_force: (total, nodal) mN seen in training, see unet_fem.runtime.surrogate.force_size.
    label: for people, such as "paper: int8". field: what the network sees in place of the forces;
    to an elastic answer in it what the graph gives is added.
    """
    seen: dict[str, Any] = {}
    if field:
        seen = {f"input_{name}": array for name, array in field.arrays().items()}
    archive = io.BytesIO()
    np.savez_compressed(
        archive,
        format=FORMAT if seen else FORMAT_2,
        mask=mask,
        index=index,
        points=points,
        faces=faces,
        mesh=mesh,
        interval=float(interval),
        largest_force=np.asarray(largest_force, float),
        label=label,
        sha256=graph_digest(model),
        **seen,
    )
    write_bytes(path, model + archive.getvalue())


def read_surrogate(path: str | Path) -> dict[str, np.ndarray]:
    """{name: array} of what `write_surrogate` put behind the graph; without index, mesh and label
    for a file of format 1.

    Raises InputError for a file that is missing, damaged, or of another format.
    """
    if not Path(path).is_file():
        raise InputError(f"no surrogate {path}; make it with python tools/quantize.py runs/<name>")
    arrays = load_arrays(path, most=LARGEST)
    found = str(arrays.get("format", "unknown"))
    if found not in (FORMAT, FORMAT_2, FORMAT_1):
        raise InputError(
            f"{path} is not a '{FORMAT}' file (format: {found}), and this version opens no others"
            f" but '{FORMAT_2}' and '{FORMAT_1}';"
            " make one with python tools/quantize.py runs/<name>"
        )
    check_graph(path, arrays, "make it again with python tools/quantize.py runs/<name>")
    if not _whole(arrays, found != FORMAT_1) or not _input_whole(arrays, found == FORMAT):
        raise InputError(
            f"{path} is damaged: its arrays are incomplete or do not fit each other;"
            " make it again with python tools/quantize.py runs/<name>"
        )
    return arrays


def graph_digest(graph: bytes) -> str:
    """What tells a graph from a damaged one."""
    return hashlib.sha256(graph).hexdigest()


def check_graph(path: str | Path, arrays: dict[str, np.ndarray], remedy: str) -> None:
    """Raises InputError unless what lies before the archive in the file at `path` is what it was
    when its `graph_digest` was written as `sha256` of the arrays; files of before have none.

    LiteRT takes most damage for weights, and some of it ends the process.
    """
    with open(path, "rb") as file:
        with zipfile.ZipFile(file) as archive:
            size = min(member.header_offset for member in archive.infolist())
        file.seek(0)
        graph = file.read(size)
    if "sha256" in arrays and str(arrays["sha256"]) != graph_digest(graph):
        raise InputError(f"{path} is damaged: its graph is not the one that was written; {remedy}")


def _whole(arrays: dict[str, np.ndarray], with_nodes: bool) -> bool:
    """Whether all that belongs to a surrogate is there, in shapes that fit."""
    names = {"mask", "points", "faces", "interval", "largest_force"}
    if not names | ({"index", "mesh", "label"} if with_nodes else set()) <= arrays.keys():
        return False
    mask, points, faces = (arrays[name] for name in ("mask", "points", "faces"))
    interval, largest = arrays["interval"], arrays["largest_force"]
    return bool(
        (mask.dtype, mask.ndim) == (bool, 3)
        and points.dtype.kind == "f"
        and points.shape == (mask.size, 3)
        and np.isfinite(points).all()
        and _places(faces, mask.size)
        and faces.shape[1:] == (4,)
        and (interval.dtype.kind, interval.shape) == ("f", ())
        and 0 < interval < np.inf
        and (largest.dtype.kind, largest.shape) == ("f", (2,))
        and (not with_nodes or _nodes(arrays["index"], mask.size))
    )


def _input_whole(arrays: dict[str, np.ndarray], with_input: bool) -> bool:
    """Whether what is seen in place of the forces is there, in shapes that fit; the weights
    themselves are judged by InputField.of."""
    if not with_input:
        return True
    creep, kernel = arrays.get("input_creep"), arrays.get("input_kernel")
    if creep is None or creep.dtype.kind != "f" or creep.shape[1:] != (2,):
        return False
    if not (creep > 0).all() or kernel is None and not len(creep):
        return False
    if kernel is None:
        return True
    active = arrays.get("input_active", np.empty(0))
    return bool(
        _places(active, 3 * arrays["mask"].size)
        and (kernel.dtype.kind, kernel.shape) == ("f", (len(active), 3 * int(arrays["mask"].sum())))
        and np.isfinite(kernel).all()
    )


def _nodes(index: np.ndarray, size: int) -> bool:
    """Whether `index` has a place for each node, or for none."""
    return index.ndim == 1 and (
        not index.size or _places(index, size) and len(np.unique(index)) == len(index)
    )


def _places(numbers: np.ndarray, size: int) -> bool:
    """Whether `numbers` are numbers of grid nodes."""
    return bool(
        numbers.dtype.kind in "iu" and numbers.size and 0 <= numbers.min() <= numbers.max() < size
    )
