"""How far the dataset's mesh and element are from finer ones."""

from dataclasses import replace

import numpy as np

from fem.data.dataset import Dataset
from unet_fem.study.measure.sums import distance
from unet_fem.study.measure.variants import variant
from unet_fem.study.settings import Study


def refinement(study: Study, dataset: Dataset, few: list[int], own: dict[int, np.ndarray]) -> dict:
    """Distances between meshes and elements; every run with the scene's own mass scaling, precision
    and damping.

    few: numbers of test interactions; own: {number: the dataset's field}. At the top level it is
    the dataset's distance to the scene's own solver on every cube cut into eight, at the nodes that
    both meshes have. mean_dilatation is that element's distance to itself on the refined mesh,
    to_refined_mean_dilatation the dataset's distance to it, and
    refined_mean_dilatation_to_refined what divides both elements there.
    """
    plain = dataset.scene.solver
    dilatation = replace(plain, element="mean_dilatation", hourglass_stiffness=None)
    fine = variant(study, dataset, "refined", plain, few, fine=True)
    fine_dilatation = variant(study, dataset, "refined_dilatation", dilatation, few, fine=True)
    coarse_dilatation = variant(study, dataset, "dilatation", dilatation, few)
    return distance(own, fine, dataset) | {
        "element": plain.element,
        "stopped": [number for number in few if fine[number] is None],
        "mean_dilatation": distance(coarse_dilatation, fine_dilatation, dataset),
        "to_refined_mean_dilatation": distance(own, fine_dilatation, dataset),
        "refined_mean_dilatation_to_refined": distance(fine_dilatation, fine, dataset),
    }
