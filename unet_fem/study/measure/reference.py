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
from unet_fem.study.dataset import (
    Case,
    everything,
    headline,
    in_order,
    name_of,
    named,
    study_dataset,
)
from unet_fem.study.measure.refinement import refinement
from unet_fem.study.measure.statistics import errors
from unet_fem.study.measure.sums import distance, sums_of_squares
from unet_fem.study.measure.variants import variant
from unet_fem.study.settings import Study


def references(
    study: Study, dataset: Dataset, cases: Iterable[Case] | None = None
) -> dict[Case, np.ndarray]:
    """{case: displacement (frames, nx, ny, nz, 3) float32 mm} of interactions, on the grid at the
    dataset's frames.

    cases: for None those of the headline. Computed in parallel where they are missing. One in
    which the solver stops (a cell turned inside out under the hardest push, which lighter settings
    may not see) has no reference.
    """
    cases = everything(headline(study, dataset)) if cases is None else cases
    choice = converged(dataset.scene, study.fem.reference_safety)
    found = variant(study, dataset, "reference", choice, cases)
    return {case: field for case, field in found.items() if field is not None}


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

    subsets: {"usual", "hard": names}, of which `stopped` have no reference; dataset: see
    statistics.errors; half_step: with half the time step; refined: see
    unet_fem.study.measure.refinement, on interactions that did not stop there.
    """
    dataset, subsets = study_dataset(study), headline(study, study_dataset(study))
    truth = references(study, dataset)
    own: dict[Case, np.ndarray] = {}
    for split in ("test", "hard"):
        numbers = in_order(dataset, split, truth)
        if numbers:
            fields = dataset.read(split, ("displacement",), numbers)["displacement"]
            own |= {(split, n): field for n, field in zip(numbers, fields, strict=True)}
    sums = {name_of(case): sums_of_squares(own[case], truth[case], dataset) for case in truth}
    chosen = [*subsets["hard"][:1], *subsets["usual"][:2]]
    few = [case for case in chosen if case in truth]
    few = few[-study.fem.checked :]  # the refined mesh costs sixteen-fold
    half = converged(dataset.scene, study.fem.reference_safety / 2)
    result = {
        "subsets": named(subsets),
        "stopped": [name_of(case) for case in everything(subsets) if case not in truth],
        "safety": study.fem.reference_safety,
        "dataset": errors(sums, named(subsets)) | {"sums": sums},
        "half_step": distance(truth, variant(study, dataset, "half_step", half, few), dataset),
    }
    if dataset.scene.mesh.kind != "file":
        result["refined"] = refinement(study, dataset, few, own)
    return result
