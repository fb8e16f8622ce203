"""The surface of a mesh that instruments touch."""

import functools

import numpy as np
import scipy.spatial

from fem.errors import InputError
from fem.mesh.hexmesh import HexMesh, checked_mesh
from fem.online.contact_surface import ContactSurface


class Surface(ContactSurface):
    """The surface of a mesh in m that contacts push on (HexMesh.contact_faces).

    on_held: whether its footprints fall on held nodes too, as they did before version 0.2.
    """

    unit = "m"

    def __init__(self, mesh: HexMesh, on_held: bool = False) -> None:
        faces = checked_mesh(mesh).contact_faces
        if not len(faces):
            raise InputError(
                "the mesh has no free surface to push on: every boundary node is fixed"
            )
        super().__init__(mesh.points, faces, ~mesh.fixed | on_held)
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


@functools.lru_cache(maxsize=8)
def surface_of(mesh: HexMesh) -> Surface:
    """The Surface of `mesh`, made once in a process, also for an equal mesh."""
    return Surface(mesh)
