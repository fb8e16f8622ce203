"""What the modes do at the integration points of the whole mesh: their gradients, and the stiffness
at rest in them."""

from collections.abc import Iterator

import numpy as np

from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MM
from fem.solver.elements import FullElement
from fem.solver.internal_force import InternalForce

SMALL = 1e-6  # of an edge: the largest displacement by which a stiffness is measured
CHUNK = 512  # cells whose points are held in memory at a time
PA = 1e-3  # mN/mm2


def positions(mesh: HexMesh) -> np.ndarray:
    """(8 E, 3) m of the integration points; point q of cell e is number 8 e + q."""
    shape = np.prod(1 + element.GAUSS[:, None, :] * element.CORNERS, axis=2) / 8  # (Q, 8)
    return np.einsum("qa,eaj->eqj", shape, mesh.points[mesh.cells]).reshape(-1, 3)


def gradients(mesh: HexMesh, fields: np.ndarray) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """For chunks of cells (their points as a slice, the gradients (k, 3, 3, P) float32 1/mm of
    fields (k, N, 3), volumes (P,) mm3)."""
    u = np.ascontiguousarray(np.moveaxis(fields, 1, 2), float)  # (k, 3, N)
    for first in range(0, mesh.n_cells, CHUNK):
        cells = slice(first, min(first + CHUNK, mesh.n_cells))
        arrays: dict = {}
        full = FullElement(
            mesh,
            cells,
            np.dtype(float),
            lambda name, shape, arrays=arrays: arrays.setdefault((name, shape), np.empty(shape)),
            1.0,
        )
        H = np.empty((3, 3, full.q, full.n))
        out = np.empty((len(fields), 3, 3, full.n, full.q), np.float32)
        for k, one in enumerate(u):
            full.displacement_gradient(one, H)
            out[k] = H.swapaxes(2, 3) / MM
        volume = (full.volume * np.ones((full.q, full.n))).T.ravel() * MM**3
        yield slice(8 * cells.start, 8 * cells.stop), out.reshape(len(fields), 3, 3, -1), volume


def stiffness(mesh: HexMesh, material: Hyperelastic, fields: np.ndarray) -> np.ndarray:
    """K Phi (k, N, 3) mN/mm of fields (k, N, 3), the elastic stiffness at rest, from small internal
    forces."""
    force = InternalForce(mesh, material.elastic())
    edge = np.ptp(mesh.points[mesh.cells[0]], axis=0).min()
    out = np.empty(fields.shape)
    for k, one in enumerate(fields):
        scale = SMALL * edge / np.abs(one).max()
        u = np.ascontiguousarray(scale * one.T, float)
        out[k] = ((force(u) - force(-u)) / (2 * scale)).T
    return out  # N/m is mN/mm


def volumes(mesh: HexMesh) -> np.ndarray:
    """(8 E,) mm3 of the integration points."""
    return element.gauss_volumes(mesh.points * MM, mesh.cells).ravel()


def gradients_at(mesh: HexMesh, fields: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(k, 9, h) 1/mm of fields (k, N, 3) at some points."""
    out = np.empty((len(fields), 9, len(points)))
    for where, H, _ in gradients(mesh, fields):
        here = (points >= where.start) & (points < where.stop)
        out[:, :, here] = H.reshape(len(fields), 9, -1)[:, :, points[here] - where.start]
    return out


def points_law(material: Hyperelastic, mesh: HexMesh, points: np.ndarray) -> Hyperelastic:
    """The law of some points, with one value a point of what differs from cell to cell."""
    return material.of_cells(np.asarray(points) // 8, mesh.n_cells)


def check_element(kind: str) -> None:
    """Raises InputError for an element whose stress is no function of one point's strain."""
    if kind != "full":
        raise InputError(
            f"solver.element = '{kind}' does not fall into independent points; reduce a dataset"
            " made with element = 'full'"
        )
