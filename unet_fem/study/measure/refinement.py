"""How far the dataset's mesh and element are from finer ones."""

from dataclasses import replace

import numpy as np

from fem.data.dataset import Dataset
from unet_fem.study.dataset import Case, name_of
from unet_fem.study.measure.sums import distance
from unet_fem.study.measure.variants import variant
from unet_fem.study.settings import Study

# which came closest to a refined mesh; that of the loops is tuned to the full element
HOURGLASS = 0.05


def refinement(
    study: Study, dataset: Dataset, few: list[Case], own: dict[Case, np.ndarray]
) -> dict:
    """Distances between meshes and elements; every run with the scene's own mass scaling, precision
    and damping.

    few: interactions; own: {case: the dataset's field}. "Refined" is every cube cut into eight,
    compared at the nodes that both meshes have.

    Two yardsticks. refined: the scene's own element there, to which relative_l2 is the dataset's
    distance: what a finer mesh would change. tissue: the mean-dilatation element there, which does
    not lock at this Poisson ratio and stands for the tissue wherever something is said to be
    closer to it; {element: distance to it} of the dataset's mesh in each element, the first being
    the dataset's own. refined_to_tissue: what divides both yardsticks.
    """
    plain = dataset.scene.solver
    dilatation = replace(plain, element="mean_dilatation", hourglass_stiffness=None)
    reduced = replace(plain, element="reduced", hourglass_stiffness=HOURGLASS)
    fine = variant(study, dataset, "refined", plain, few, fine=True)
    tissue = variant(study, dataset, "refined_dilatation", dilatation, few, fine=True)
    coarse_dilatation = variant(study, dataset, "dilatation", dilatation, few)
    coarse_reduced = variant(study, dataset, "reduced", reduced, few)
    return distance(own, fine, dataset) | {
        "element": plain.element,
        "stopped": [name_of(case) for case in few if fine[case] is None or tissue[case] is None],
        "tissue": {
            plain.element: distance(own, tissue, dataset),
            f"reduced, hourglass stiffness {HOURGLASS:g}": distance(
                coarse_reduced, tissue, dataset
            ),
            "mean_dilatation": distance(coarse_dilatation, tissue, dataset),
        },
        "refined_to_tissue": distance(fine, tissue, dataset),
    }
