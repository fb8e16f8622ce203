"""The surface of a mesh that instruments touch, and the nodal forces of a footprint on it."""

import functools

import numpy as np
import scipy.sparse
import scipy.spatial

from fem.errors import InputError
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.ranges import shown


class Surface:
    """The surface of a mesh that contacts push on (HexMesh.contact_faces), with quadrature points
    that turn a footprint into consistent nodal forces.

    on_held: whether these fall on held nodes too, as they did before version 0.2.
    """

    def __init__(self, mesh: HexMesh, on_held: bool = False) -> None:
        faces = mesh.contact_faces
        if not len(faces):
            raise InputError(
                "the mesh has no free surface to push on: every boundary node is fixed"
            )
        points = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3)
        shape, gradient = element.quad_shape(points)  # (4, 4), (4, 2, 4)
        corners = mesh.points[faces]  # (M, 4, 3)
        tangents = np.einsum("qra,mai->mqri", gradient, corners)
        normal = np.cross(tangents[..., 0, :], tangents[..., 1, :]).reshape(
            -1, 3
        )  # outward, of length dA
        self.area = np.linalg.norm(normal, axis=1)  # (P,)
        self.normal = normal / self.area[:, None]
        self.points = np.einsum("qa,mai->mqi", shape, corners).reshape(-1, 3)  # (P, 3)
        column = np.arange(len(self.area)).reshape(-1, 4, 1)
        row = np.broadcast_to(faces[:, None], (len(faces), 4, 4))
        weight = np.broadcast_to(shape, row.shape)
        entries = (weight.ravel(), (row.ravel(), np.broadcast_to(column, row.shape).ravel()))
        free = scipy.sparse.diags((~mesh.fixed | on_held).astype(float))
        self.spread = free @ scipy.sparse.csr_matrix(entries, (mesh.n_nodes, len(self.area)))
        rim = scipy.spatial.cKDTree(mesh.points[mesh.contact_rim])
        self.clearance = rim.query(self.points)[0]  # (P,) m, inf without a rim

    def check_footprints(self, smallest: float, largest: float) -> None:
        """Raises InputError for footprints of these radii (m) that this surface cannot carry: lost
        between its points, or larger than all of it. Mostly the mesh is in another unit."""
        size, edge = float(np.ptp(self.points, axis=0).max()), float(np.sqrt(4 * self.area.mean()))
        if smallest < edge / 4:
            reason = f"a quarter of the mesh's {edge:.3g} m cells"
        elif smallest > 2 * size:
            reason = f"twice the whole surface of {size:.3g} m"
        else:
            return
        order = "below" if smallest < edge / 4 else "above"
        raise InputError(
            f"contact.radius = [{smallest:g}, {largest:g}] m is {order} {reason}; is the mesh in"
            " m? mesh.scale turns its unit into m"
        )

    def footprint(self, centre: np.ndarray, radius: float) -> np.ndarray:
        """Share of a unit force that each node takes, (N,): consistent with the pressure (1 -
        r^2/R^2)^2, sum exactly 1.

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
            isinstance(radius, (int, float, np.number)) and 0 < radius < 1e6
        ):
            raise InputError(
                f"a footprint of radius {radius!r} m at {shown(centre)}; give m above 0 and a point"
                " (x, y, z)"
            )
        offset = self.points - centre
        squared = np.einsum("pi,pi->p", offset, offset)
        near = self.normal @ self.normal[squared.argmin()] > -0.5
        mean = self.normal.T @ (near * bump(squared / (2 * radius) ** 2) * self.area)
        normal = mean / max(np.linalg.norm(mean), 1e-300)
        height = offset @ normal
        distance = np.linalg.norm(offset - height[:, None] * normal, axis=1)
        pressure = near * (np.abs(height) < radius) * bump(np.square(distance / radius)) * self.area
        share = self.spread @ pressure
        total = share.sum()
        if not total > 0:  # also at a centre that is not finite
            raise InputError(
                f"a footprint of radius {radius:g} m at {np.array2string(centre, precision=4)} m"
                " misses the free surface; widen contact.radius"
            )
        return share / total


@functools.lru_cache(maxsize=8)
def surface_of(mesh: HexMesh) -> Surface:
    """The Surface of `mesh`, made once in a process, also for an equal mesh."""
    return Surface(mesh)


def bump(x: np.ndarray) -> np.ndarray:
    """(1 - x)^2 from x = 0 to 1, then 0."""
    return np.square(np.clip(1 - x, 0, None))
