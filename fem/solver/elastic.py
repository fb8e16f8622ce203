"""The linear elastic answer to forces on the contact surface: no data, only a mesh and its law."""

import numpy as np

from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.online.creep import Creep
from fem.online.grid import MM, MN
from fem.online.regression import Regression, RegressionStepper
from fem.solver.body import check_parts
from fem.solver.compliance import compliance


def elastic_answer(
    mesh: HexMesh,
    material: Hyperelastic,
    element: str = "full",
    hourglass_stiffness: float = 0.2,
    interval: float | None = None,
) -> Regression:
    """u = K^-1 f with K the stiffness at rest, as a Regression whose weights are not fitted: forces
    on the contact surface to the displacement of the free nodes.

    interval: s between forces, None for any. Raises InputError for a mesh that does not lie on a
    grid, and for one whose compliance would not fit into memory.
    """
    check_parts(mesh, material)
    if mesh.grid is None:
        raise InputError(
            "the elastic answer is of a mesh whose nodes lie on a grid, and this one is embedded in"
            " it; take input.physics = 'force', or another mesh"
        )
    nodes = np.unique(mesh.contact_faces)
    nodes = nodes[~mesh.fixed[nodes]]
    by_force = compliance(mesh, material, nodes, element, hourglass_stiffness)
    places = mesh.grid.index
    order = np.argsort(places)  # of the nodes as they come on the grid
    free = order[~mesh.fixed[order]]
    active = 3 * places[nodes][:, None] + np.arange(3)
    kernel = by_force[:, :, free].reshape(active.size, -1) * (MM / MN)
    return Regression(
        mesh.grid.to_grid(~mesh.fixed[:, None])[..., 0],
        active.ravel(),
        kernel.astype("float32"),
        interval=interval,
        index=places,
        elastic=True,
    )


def elastic_stepper(
    mesh: HexMesh,
    material: Hyperelastic,
    *,
    memory: bool = True,
    element: str = "full",
    hourglass_stiffness: float = 0.2,
    interval: float | None = None,
) -> RegressionStepper:
    """The elastic answer to the force as creeping tissue remembers it, or to that of the moment
    without `memory`, as a Stepper of any interval, or of this one where none is given with a call.
    Raises InputError as `elastic_answer` does."""
    answer = elastic_answer(mesh, material, element, hourglass_stiffness, interval)
    return RegressionStepper(answer.remembering(Creep.of(material.prony if memory else ())))
