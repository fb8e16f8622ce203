"""The mirror symmetry of a body, found from its nodes, cells, held nodes and law, and fields taken
apart by it."""

from dataclasses import dataclass

import numpy as np
import scipy.spatial

from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh

TOLERANCE = 1e-6  # of the shortest edge


@dataclass(frozen=True, eq=False)
class Sides:
    """Some nodes or points of a body in halves: `right` are the images of `left`, themselves on the
    plane of symmetry; without a mirror (axis None) all are left ones.

    A field is even where v(right) = R v(left), R flipping component `axis`, and odd where it is
    minus that. Each part is given by its left values alone.
    """

    left: np.ndarray
    right: np.ndarray
    axis: int | None

    @property
    def parities(self) -> int:
        """Blocks that fields fall into."""
        return 1 if self.axis is None else 2

    @property
    def rows(self) -> np.ndarray:
        """(sides, h) numbers of the left and, with a mirror, the right ones."""
        return np.array([self.left, self.right][: self.parities], np.int32)

    @property
    def share(self) -> np.ndarray:
        """(h,) what a pair's left value is of its orthonormal coordinate."""
        alone = self.left == self.right
        return np.ones(len(alone)) if self.axis is None else np.where(alone, 1.0, np.sqrt(0.5))

    def fold(self, field: np.ndarray) -> list[np.ndarray]:
        """Orthonormal coordinates (..., 3 h) of each parity, of a field (..., N, 3)."""
        left = np.moveaxis(field[..., self.left, :], -1, -2)  # (..., 3, h)
        if self.axis is None:
            return [left.reshape(*left.shape[:-2], -1)]
        right = np.moveaxis(field[..., self.right, :], -1, -2).copy()
        right[..., self.axis, :] *= -1
        weight = 0.5 / self.share
        parts = ((left + sign * right) * weight for sign in (1, -1))
        return [part.reshape(*part.shape[:-2], -1) for part in parts]

    def fold_force(self, force: np.ndarray) -> list[np.ndarray]:
        """(..., 3 h) f + R f' and f - R f' of forces (..., N, 3), as the online encoder takes them;
        their product with `test_values` of a mode is its work."""
        left = np.moveaxis(force[..., self.left, :], -1, -2)
        if self.axis is None:
            return [left.reshape(*left.shape[:-2], -1)]
        right = np.moveaxis(force[..., self.right, :], -1, -2).copy()
        right[..., self.axis, :] *= -1
        return [part.reshape(*part.shape[:-2], -1) for part in (left + right, left - right)]

    def test_values(self, field: np.ndarray) -> np.ndarray:
        """(..., 3 h) of a field (..., N, 3) of one parity, see `fold_force`."""
        left = np.moveaxis(field[..., self.left, :], -1, -2)
        if self.axis is not None:
            left = left * np.where(self.left == self.right, 0.5, 1.0)
        return left.reshape(*left.shape[:-2], -1)

    def left_values(self, coordinates: np.ndarray) -> np.ndarray:
        """(..., 3, h) left values of a field of one parity with these coordinates (..., 3 h)."""
        return coordinates.reshape(*coordinates.shape[:-1], 3, -1) * self.share

    def field(self, coordinates: np.ndarray, parity: int, n_nodes: int) -> np.ndarray:
        """The field (..., n_nodes, 3) of one parity, zero at other nodes."""
        left = np.moveaxis(self.left_values(coordinates), -2, -1)
        out = np.zeros((*left.shape[:-2], n_nodes, 3), left.dtype)
        if self.axis is not None:
            right = left * (-1 if parity else 1)
            right[..., self.axis] *= -1
            out[..., self.right, :] = right
        out[..., self.left, :] = left
        return out


def mirror_of(mesh: HexMesh, law: Hyperelastic) -> tuple[int, np.ndarray] | None:
    """(axis, image (N,) of each node) of the first mirror plane, at right angles to x, y or z, that
    maps nodes, cells, held and loaded nodes and the law onto themselves; None without one."""
    edge = np.ptp(mesh.points[mesh.cells[0]], axis=0).min()
    for axis in range(3):
        image = _image(mesh.points, axis, TOLERANCE * edge)
        if image is None or not (mesh.fixed == mesh.fixed[image]).all():
            continue
        if mesh.loaded is not None and not (mesh.loaded == mesh.loaded[image]).all():
            continue
        cells = _cell_images(mesh, image)
        if cells is not None and _law_agrees(law, cells, axis, mesh.n_cells):
            return axis, image
    return None


def sides(nodes: np.ndarray, mirror: tuple[int, np.ndarray] | None) -> Sides:
    """The Sides of the `nodes`, numbers that the mirror maps onto themselves."""
    if mirror is None:
        return Sides(nodes, nodes, None)
    axis, image = mirror
    left = nodes[nodes <= image[nodes]]
    return Sides(left, image[left], axis)


def point_pairs(points: np.ndarray, axis: int | None, size: float) -> Sides:
    """The Sides of the integration points at `points` (P, 3) m of a body that is symmetric."""
    all_points = np.arange(len(points))
    if axis is None:
        return Sides(all_points, all_points, None)
    image = _image(points, axis, TOLERANCE * size)
    assert image is not None, "the points of a symmetric mesh are symmetric"
    return sides(all_points, (axis, image))


def _image(points, axis, tolerance):
    """(n,) which point each one is mirrored onto, or None."""
    mirrored = points.copy()
    mirrored[:, axis] = points[:, axis].min() + points[:, axis].max() - points[:, axis]
    distance, image = scipy.spatial.cKDTree(points).query(mirrored)
    return image if distance.max() <= tolerance else None


def _cell_images(mesh, image):
    """(E,) which cell each one is mirrored onto, or None."""
    rows = np.sort(mesh.cells, axis=1)
    numbers = {tuple(row): e for e, row in enumerate(rows.tolist())}
    found = [numbers.get(tuple(row), -1) for row in np.sort(image[mesh.cells], axis=1).tolist()]
    return None if -1 in found else np.array(found)


def _law_agrees(law, cells, axis, n_cells):
    """Whether the stress of a mirrored strain in the image is the mirrored stress."""
    rng = np.random.default_rng(0)
    F = np.eye(3)[:, :, None, None] + 0.1 * rng.standard_normal((3, 3, 1, n_cells))
    flip = np.ones(3)
    flip[axis] = -1
    flips = (flip[:, None] * flip)[:, :, None, None]
    stress = np.array(law.stress(F))
    image = flips * np.array(law.of_cells(cells, n_cells).stress(flips * F))
    return bool(np.allclose(image, stress, rtol=1e-9, atol=1e-9 * np.abs(stress).max()))
