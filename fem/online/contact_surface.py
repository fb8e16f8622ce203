"""The surface that probes push on, and the nodal forces of a round footprint on it. NumPy alone."""

import math

import numpy as np

from fem.errors import InputError
from fem.mesh.element import quad_shape
from fem.ranges import checked, shown


class ContactSurface:
    """Quadrilaterals that probes push on, with quadrature points that turn a footprint into
    consistent nodal forces.

    points: (N, 3) of the mesh's nodes, in any one unit of length; faces: (M, 4) their numbers,
    counter-clockwise seen from outside; carries: (N,) bool, the nodes that take a force.
    """

    unit = "mm"  # of lengths, for messages

    def __init__(self, points: np.ndarray, faces: np.ndarray, carries: np.ndarray) -> None:
        places = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3)
        shape, gradient = quad_shape(places)  # (4, 4), (4, 2, 4)
        corners = np.asarray(points, float)[faces]  # (M, 4, 3)
        tangents = np.einsum("qra,mai->mqri", gradient, corners)
        normal = np.cross(tangents[..., 0, :], tangents[..., 1, :]).reshape(
            -1, 3
        )  # outward, of length dA
        self.area = np.linalg.norm(normal, axis=1)  # (P,)
        self.normal = normal / self.area[:, None]
        self.points = np.einsum("qa,mai->mqi", shape, corners).reshape(-1, 3)  # (P, 3)
        self.nodes = np.repeat(faces, 4, axis=0)  # (P, 4)
        self.shares = np.tile(shape, (len(faces), 1)) * carries[self.nodes]  # (P, 4)
        self.count = len(points)

    def footprint(self, centre: np.ndarray, radius: float) -> np.ndarray:
        """Share of a unit force that each node takes, (N,): see `patch`."""
        return self.patch(centre, radius)[0]

    def patch(self, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """(share of a unit force that each node takes (N,), mean outward normal (3,)) of a
        footprint: consistent with the pressure (1 - r^2/R^2)^2, sum exactly 1.

        r is measured along the surface's tangent plane under the centre, so that a straight path
        may cut through a curved surface, and never reaches the other side of a thin wall. Over a
        step it pushes on both levels; seen along the normal the resultant then stays within 0.3 %
        of the radius of the centre, and its height is that of the faces that carry it, so that the
        line of action of a force tilted by 30 degrees is off by up to 7 % of the radius (measured
        on the tumour). What would fall on held nodes, or beyond the rim, falls away, and the rest
        takes the whole force: so a centre nearer to the rim than the radius has its resultant moved
        inwards. Raises InputError if the circle holds no point of the surface.
        """
        centre = np.asarray(centre)
        if centre.shape != (3,) or not (
            np.isfinite(centre).all()
            and isinstance(radius, (int, float, np.number))
            and 0 < radius < 1e6
        ):
            raise InputError(
                f"a footprint of radius {radius!r} {self.unit} at {shown(centre)}; give"
                f" {self.unit} above 0 and a point (x, y, z)"
            )
        offset = self.points - centre
        squared = np.einsum("pi,pi->p", offset, offset)
        near = self.normal @ self.normal[squared.argmin()] > -0.5
        mean = self.normal.T @ (near * bump(squared / (2 * radius) ** 2) * self.area)
        normal = mean / max(math.sqrt(mean @ mean), 1e-300)
        height = offset @ normal
        # of r^2, by Pythagoras: there is no need for the offset along the plane itself
        along = (squared - np.square(height)) / radius**2
        at = np.flatnonzero(near & (np.abs(height) < radius) & (along < 1))
        pressure = np.square(1 - along[at]) * self.area[at]
        nodal = self.shares[at] * pressure[:, None]
        share = np.bincount(self.nodes[at].ravel(), nodal.ravel(), self.count)
        total = share.sum()
        if not total > 0:
            raise InputError(
                f"a footprint of radius {radius:g} {self.unit} at"
                f" {np.array2string(centre, precision=4)} {self.unit} misses the free surface;"
                " widen the radius"
            )
        return share / total, normal


class Probe:
    """A round probe of `radius` mm on a surface, which turns its force into forces at the nodes."""

    def __init__(self, surface: ContactSurface, radius: float) -> None:
        self.surface, self.radius = surface, checked("radius", radius, 1e-3, 1e6, "mm")

    def __call__(self, position: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(N, 3) mN at the nodes of a force (3,) mN at the point `position` (3,) mm of the surface
        at rest. Raises InputError where it misses the surface."""
        force = np.asarray(force, float)
        if force.shape != (3,) or not np.isfinite(force).all():
            raise InputError(f"a probe's force is {shown(force)}; give (x, y, z) in mN")
        return np.outer(self.surface.footprint(position, self.radius), force).astype(np.float32)


def bump(x: np.ndarray) -> np.ndarray:
    """(1 - x)^2 from x = 0 to 1, then 0."""
    return np.square(np.clip(1 - x, 0, None))
