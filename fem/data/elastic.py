"""The linear elastic answer to the forces of a dataset."""

from fem.data.dataset import Dataset
from fem.online.regression import Regression
from fem.solver import elastic


def elastic_answer(dataset: Dataset) -> Regression:
    """That of fem.solver.elastic for the mesh, the law, the element and the interval of a dataset.
    Raises InputError where its mesh is embedded in the grid."""
    scene = dataset.scene
    given = scene.solver.hourglass_stiffness
    hourglass = {} if given is None else {"hourglass_stiffness": given}
    return elastic.elastic_answer(
        dataset.fem_mesh,
        dataset.material,
        scene.solver.element,
        interval=scene.frames.interval,
        **hourglass,
    )
