"""The linear elastic answer to the forces of a dataset: no data, only its mesh and its law."""

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.creep import Creep
from fem.online.grid import MM, MN
from fem.online.regression import Regression, RegressionStepper
from fem.solver.compliance import compliance


def elastic_answer(dataset: Dataset) -> Regression:
    """u = K^-1 f with K the stiffness at rest, as a Regression whose weights are not fitted: forces
    on the contact surface to the displacement of the free nodes.

    Raises InputError for a mesh that is embedded in the grid, for there K is not of the grid's
    nodes, and for one whose compliance would not fit into memory.
    """
    mesh, solver = dataset.fem_mesh, dataset.scene.solver
    if mesh.grid_index is None:
        raise InputError(
            f"{dataset.path} holds a mesh that is embedded in the grid, and the elastic answer is"
            " known at the nodes of a mesh that lies on it; take input.physics = 'force', or"
            " another mesh"
        )
    nodes = np.unique(mesh.contact_faces)
    nodes = nodes[~mesh.fixed[nodes]]
    hourglass = {"hourglass_stiffness": solver.hourglass_stiffness}
    by_force = compliance(
        mesh,
        dataset.material,
        nodes,
        solver.element,
        **{name: value for name, value in hourglass.items() if value is not None},
    )
    place = np.full(dataset.mask.size, -1)
    place[mesh.grid_index] = np.arange(mesh.n_nodes)
    free = place[np.flatnonzero(dataset.free)]
    active = 3 * mesh.grid_index[nodes][:, None] + np.arange(3)
    kernel = by_force[:, :, free].reshape(active.size, -1) * (MM / MN)
    return Regression(
        dataset.free,
        active.ravel(),
        kernel.astype("float32"),
        interval=dataset.scene.frames.interval,
        index=mesh.grid_index,
        elastic=True,
    )


def elastic_stepper(dataset: Dataset, memory: bool = True) -> RegressionStepper:
    """The elastic answer to the force as creeping tissue remembers it, or to that of the moment
    without `memory`, as a Stepper. Raises InputError as `elastic_answer` does."""
    creep = Creep.of(dataset.scene.material.prony if memory else ())
    return RegressionStepper(elastic_answer(dataset).remembering(creep))
