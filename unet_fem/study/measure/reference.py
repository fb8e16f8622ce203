"""The converged answer that every competitor is judged by, and how far that answer itself can be
trusted.

It is the FEM on the dataset's own mesh with all that a dataset saves on taken away: float64, the
true mass, a step below the critical one. The dataset's frames are the FEM's at mass scaling and in
float32; the distance between both is one of the results.
"""

from collections.abc import Iterable

import numpy as np

from fem.data.dataset import Dataset
from fem.data.scene import Scene, SolverChoice
from unet_fem.study.dataset import hard_numbers, judged_numbers, study_dataset
from unet_fem.study.measure.refinement import refinement
from unet_fem.study.measure.sums import distance, relative_l2, sums_of_squares
from unet_fem.study.measure.variants import variant
from unet_fem.study.settings import Study


def references(
    study: Study, dataset: Dataset, split: str = "test", numbers: Iterable[int] | None = None
) -> dict[int, np.ndarray]:
    """{number: displacement (frames, nx, ny, nz, 3) float32 mm} of interactions of `split`, on the
    grid at the dataset's frames.

    numbers: of the interactions; for None those of study.fem and the hard ones. Computed in
    parallel where they are missing. One in which the solver stops (a cell turned inside out under
    the hardest push, which lighter settings may not see) has no reference.
    """
    numbers = judged_numbers(study, dataset) if numbers is None else sorted(numbers)
    choice = converged(dataset.scene, study.fem.reference_safety)
    found = variant(study, dataset, "reference", choice, numbers, split)
    return {number: field for number, field in found.items() if field is not None}


def converged(scene: Scene, safety: float) -> SolverChoice:
    """The solver's settings for a converged answer on the scene's mesh: the scene's damping, full
    integration."""
    element = "full" if scene.solver.element == "reduced" else scene.solver.element
    return SolverChoice(
        element=element, precision="float64", damping=scene.solver.damping, safety=safety
    )


def run(study: Study) -> dict:
    """The dataset's distance to the reference, and the reference's own errors (relative L2 over
    free nodes and frames).

    stopped: interactions without a reference; half_step: with half the time step; refined: see
    unet_fem.study.measure.refinement, on interactions that did not stop there.
    """
    dataset = study_dataset(study)
    truth = references(study, dataset)
    fields = dataset.read("test", ("displacement",), list(truth))["displacement"]
    own = dict(zip(truth, fields, strict=True))
    sums = {number: sums_of_squares(own[number], truth[number], dataset) for number in truth}
    chosen = [*study.fem.interactions[:2], *hard_numbers(dataset)[:1]]
    few = [number for number in dict.fromkeys(chosen) if number in truth]
    few = few[-study.fem.checked :]  # the refined mesh costs sixteen-fold
    half = converged(dataset.scene, study.fem.reference_safety / 2)
    result = {
        "numbers": list(truth),
        "stopped": sorted(set(judged_numbers(study, dataset)) - set(truth)),
        "hard_numbers": hard_numbers(dataset),
        "safety": study.fem.reference_safety,
        "dataset": {
            "test": relative_l2(sums, study.fem.interactions),
            "hard": relative_l2(sums, hard_numbers(dataset)),
            "sums": {str(number): pair for number, pair in sums.items()},
        },
        "half_step": distance(truth, variant(study, dataset, "half_step", half, few), dataset),
    }
    if dataset.scene.mesh.kind != "file":
        result["refined"] = refinement(study, dataset, few, own)
    return result
