"""The converged answer that every competitor is judged by, and how far that answer itself can be
trusted.

It is the FEM on the dataset's own mesh with all that a dataset saves on taken away: float64, the
true mass, a step below the critical one. The dataset's frames are the FEM's at mass scaling and in
float32; the distance between both is one of the results.
"""

from dataclasses import replace

import numpy as np

from fem.contact.surface import Surface
from fem.data.dataset import open_dataset
from fem.data.interaction import contacts_of, simulate
from fem.data.scene import SolverChoice
from fem.errors import SolverStopped
from fem.files import save_arrays
from fem.mesh.shapes import refined
from fem.workers import on_all_cores


def references(study, dataset, split="test", numbers=None):
    """{number: displacement (frames, nx, ny, nz, 3) float32 mm} of interactions of `split`, on the
    grid at the dataset's frames.

    numbers: of the interactions; for None those of study.fem and the hard ones. Computed in
    parallel where they are missing. One in which the solver stops (a cell turned inside out under
    the hardest push, which lighter settings may not see) has no reference.
    """
    numbers = judged(study, dataset) if numbers is None else sorted(numbers)
    found = _variant(
        study,
        dataset,
        "reference",
        converged(dataset.scene, study.fem.reference_safety),
        numbers,
        split,
    )
    return {
        number: displacement for number, displacement in found.items() if displacement is not None
    }


def judged(study, dataset):
    """Numbers of the test interactions that competitors are judged on: those of study.fem and the
    hard ones."""
    have = set(dataset.number[dataset.split == "test"].tolist())
    for number in study.fem.interactions:
        if number not in have:
            dataset.sequence("test", number)  # an InputError that says which there are
    return sorted({*study.fem.interactions, *hard_numbers(dataset)})


def hard_numbers(dataset):
    return dataset.number[dataset.hard].tolist()


def converged(scene, safety):
    """The solver's settings for a converged answer on the scene's mesh: the scene's damping, full
    integration."""
    element = "full" if scene.solver.element == "reduced" else scene.solver.element
    return SolverChoice(
        element=element, precision="float64", damping=scene.solver.damping, safety=safety
    )


def sums_of_squares(displacement, truth, dataset):
    """[error, truth]: sums over frames and free nodes of squared distances in mm2, fields (frames,
    nx, ny, nz, 3) mm."""
    truth = truth[:, dataset.free].astype(float)
    return [
        float(np.sum(np.square(displacement[:, dataset.free] - truth))),
        float(np.sum(np.square(truth))),
    ]


def relative_l2(sums, numbers):
    """sqrt(sum error / sum truth) over the interactions `numbers` that `sums` {number: [error,
    truth]} has; None if it has none."""
    pairs = np.array([sums[number] for number in numbers if number in sums])
    return float(np.sqrt(pairs[:, 0].sum() / pairs[:, 1].sum())) if len(pairs) else None


def run(study):
    """The dataset's distance to the reference, and the reference's own errors (relative L2 over
    free nodes and frames).

    stopped: interactions without a reference; half_step: with half the time step; refined: the
    dataset to the scene's own solver on every cube cut into eight, at the nodes that both meshes
    have, on interactions that did not stop there. Within it mean_dilatation is that element's
    distance to itself on the refined mesh, to_refined_mean_dilatation the dataset's distance to it,
    and refined_mean_dilatation_to_refined what divides both elements there.
    """
    dataset = study_dataset(study)
    truth, fem = references(study, dataset), dataset.read("test")
    sums = {
        number: sums_of_squares(
            fem["displacement"][fem["number"] == number][0], truth[number], dataset
        )
        for number in truth
    }
    result = {
        "numbers": list(truth),
        "stopped": sorted(set(judged(study, dataset)) - set(truth)),
        "hard_numbers": hard_numbers(dataset),
        "safety": study.fem.reference_safety,
        "dataset": {
            "test": relative_l2(sums, study.fem.interactions),
            "hard": relative_l2(sums, hard_numbers(dataset)),
            "sums": {str(number): pair for number, pair in sums.items()},
        },
    }
    chosen = [*study.fem.interactions[:2], *hard_numbers(dataset)[:1]]
    few = [number for number in dict.fromkeys(chosen) if number in truth][
        -study.fem.checked :
    ]  # the refined mesh costs sixteen-fold
    result["half_step"] = _distance(
        truth,
        _variant(
            study,
            dataset,
            "half_step",
            converged(dataset.scene, study.fem.reference_safety / 2),
            few,
        ),
        dataset,
    )
    if dataset.scene.mesh.kind != "file":
        result["refined"] = _refinement(
            study,
            dataset,
            few,
            {number: fem["displacement"][fem["number"] == number][0] for number in few},
        )
    return result


def study_dataset(study):
    """The dataset of the study: that of its CNN-LSTM."""
    return open_dataset(study.network(study.cnn_lstm).data).for_learning()


def _refinement(study, dataset, few, own):
    """Distances between meshes and elements; every run with the scene's own mass scaling, precision
    and damping. own: the dataset's fields."""
    plain, dilatation = (
        dataset.scene.solver,
        replace(dataset.scene.solver, element="mean_dilatation", hourglass_stiffness=None),
    )
    fine = _variant(study, dataset, "refined", plain, few, fine=True)
    fine_dilatation = _variant(study, dataset, "refined_dilatation", dilatation, few, fine=True)
    return _distance(own, fine, dataset) | {
        "element": plain.element,
        "stopped": [number for number in few if fine[number] is None],
        "mean_dilatation": _distance(
            _variant(study, dataset, "dilatation", dilatation, few), fine_dilatation, dataset
        ),
        "to_refined_mean_dilatation": _distance(own, fine_dilatation, dataset),
        "refined_mean_dilatation_to_refined": _distance(fine_dilatation, fine, dataset),
    }


def _distance(fields, truth, dataset):
    """{"numbers", "relative_l2"}: of the {number: field} to the truth, over the interactions that
    did not stop in either."""
    sums = {
        n: sums_of_squares(fields[n], u, dataset)
        for n, u in truth.items()
        if u is not None and fields[n] is not None
    }
    return {"numbers": list(sums), "relative_l2": relative_l2(sums, list(sums))}


def _path(study, dataset, name, split, number):
    # what it was made from is in the name, so that a changed scene or step makes new files
    return (
        study.folder
        / "reference"
        / f"{name}-{dataset.scene.digest()}-{study.fem.reference_safety:g}-{split}-{number:04d}.npz"
    )


def _variant(study, dataset, name, choice, numbers, split="test", fine=False):
    """{number: displacement (frames, nx, ny, nz, 3) float32 mm, or None where the solver stopped},
    simulated where there is no file yet.

    choice: SolverChoice; fine: on the refined mesh.
    """
    paths = {number: _path(study, dataset, name, split, number) for number in numbers}
    tasks = [
        (dataset, choice, fine, split, number, path)
        for number, path in paths.items()
        if not path.is_file()
    ]
    if tasks:
        on_all_cores(_simulate, tasks, f"FEM, {name}")
    result = {}
    for number, path in paths.items():
        with np.load(path) as file:
            result[number] = None if "stopped" in file else file["displacement"]
    return result


def _simulate(dataset, choice, fine, split, number, path):
    mesh = refined(dataset.fem_mesh) if fine else dataset.fem_mesh
    try:
        found = simulate(
            replace(dataset.scene, solver=choice),
            mesh,
            contacts_of(dataset, split, number),
            Surface(mesh),
        )
    except SolverStopped as stop:
        save_arrays(path, stopped=stop.reason)
    else:
        displacement = found["displacement"]
        on_grid = (
            mesh.grid.to_grid(displacement)[:, ::2, ::2, ::2]
            if fine
            else dataset.on_grid(found["force"], displacement)[1]
        )
        save_arrays(path, displacement=on_grid)
