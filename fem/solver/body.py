"""A deformable body: its internal force, and what is asked of it while a solver moves it."""

import numpy as np

from fem.errors import InputError
from fem.material.base import Hyperelastic, poisson_ratio, shear_modulus
from fem.mesh import element as hexahedron
from fem.mesh.hexmesh import HexMesh, checked_mesh
from fem.ranges import checked, shown
from fem.solver.internal_force import InternalForce
from fem.solver.record import Hourglass

# above it the full element is more than 8 % too stiff under a footprint of 4 cells' radius, see
# docs/stability.md
LOCKING_NU = 0.45
SMALLEST_J = 0.05  # below it a cell has lost its meaning, and p = K (J - 1) - mu / J runs away
PASS = 512  # cells whose corners are looked at together


def check_parts(mesh: HexMesh, material: Hyperelastic) -> None:
    """Raises InputError for what is no mesh or no material."""
    checked_mesh(mesh)
    if not isinstance(material, Hyperelastic):
        raise InputError(
            f"the material is {shown(material)}; give a Hyperelastic, such as NeoHooke"
        )


class DeformableBody:
    """A mesh of one material; see fem.solver.internal_force.InternalForce for the options.

    force: the InternalForce; elastic_force: the same in float64 without relaxation, for energies
    and stiffness
    held: (N,) bool; negligible_energy: J, of a strain of about 0.1 %

    allow_locking: take the full element for nearly incompressible tissue too, to see it lock
    """

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        element: str = "full",
        precision: str = "float64",
        hourglass_stiffness: float = 0.2,
        allow_locking: bool = False,
    ) -> None:
        check_parts(mesh, material)
        checked("solver.hourglass_stiffness", hourglass_stiffness, 0, 1e15)
        orphans = np.setdiff1d(np.arange(mesh.n_nodes), mesh.cells)
        if orphans.size:
            raise InputError(
                f"node {orphans[0]} belongs to no cell ({orphans.size} such nodes) and has no mass;"
                " leave it out of the mesh"
            )
        nu = np.max(poisson_ratio(material))
        if element == "full" and nu > LOCKING_NU and not allow_locking:
            raise InputError(
                f"solver.element = 'full' locks at material.nu = {nu}"
                f" (above {LOCKING_NU}); use element = 'mean_dilatation' or 'reduced'"
            )
        self.mesh, self.material, self.held = mesh, material, mesh.fixed
        self.force = InternalForce(mesh, material, element, precision, hourglass_stiffness)
        self.elastic_force = self.force
        if precision != "float64" or material.prony:
            self.elastic_force = InternalForce(
                mesh, material.elastic(), element, "float64", hourglass_stiffness
            )
        self.negligible_energy = 1e-6 * np.mean(shear_modulus(material)) * mesh.volume()
        # corners are looked at often: contiguous, and in passes that need no fresh memory
        self._points = np.ascontiguousarray(mesh.points.T)
        self._corners = [
            (index, hexahedron.corner_jacobians(self._points[:, index]))
            for index in np.split(mesh.cells.T, range(PASS, mesh.n_cells, PASS), axis=1)
        ]

    def hourglass(self, u: np.ndarray) -> Hourglass:
        """The Hourglass of displacement u (3, N) m."""
        return Hourglass(*self.force.hourglass(u))

    def corner_J(self, u: np.ndarray) -> np.ndarray:
        """(E,) smallest volume ratio at a corner of each cell, of displacement u (3, N) m."""
        points = self._points + u
        return np.concatenate(
            [
                (hexahedron.corner_jacobians(points.take(index, axis=1, mode="clip")) / rest).min(
                    axis=0
                )
                for index, rest in self._corners
            ]
        )
