"""Interactions of a dataset simulated in another way than the dataset's, each kept in a file of its
own."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.data.grid import grid_of
from fem.data.scene import SolverChoice
from fem.errors import SolverStopped
from fem.files import save_arrays
from fem.mesh.shapes import refined
from fem.workers import on_all_cores
from unet_fem.study.dataset import Case, simulated
from unet_fem.study.keys import key
from unet_fem.study.settings import Study

VERSION = 1


def variant(
    study: Study,
    dataset: Dataset,
    name: str,
    choice: SolverChoice,
    cases: Iterable[Case],
    fine: bool = False,
) -> dict[Case, np.ndarray | None]:
    """{case: displacement (frames, nx, ny, nz, 3) float32 mm, or None where the solver stopped},
    simulated where there is no file yet.

    choice: SolverChoice; fine: on the refined mesh.
    """
    paths = {case: variant_path(study, dataset, name, choice, case, fine) for case in cases}
    tasks = [
        (dataset, choice, fine, case, path) for case, path in paths.items() if not path.is_file()
    ]
    if tasks:
        on_all_cores(simulate_variant, tasks, f"FEM, {name}")
    result = {}
    for case, path in paths.items():
        with np.load(path) as file:
            result[case] = None if "stopped" in file else file["displacement"]
    return result


def variant_path(
    study: Study,
    dataset: Dataset,
    name: str,
    choice: SolverChoice,
    case: Case,
    fine: bool = False,
) -> Path:
    """The file of an interaction: what it is made from is in its name."""
    split, number = case
    made_from = key((choice, fine, split, number), [dataset.path], VERSION)
    return study.cache / "reference" / f"{name}-{split}-{number:04d}-{made_from}.npz"


def simulate_variant(
    dataset: Dataset, choice: SolverChoice, fine: bool, case: Case, path: Path
) -> None:
    """Write an interaction's displacement on the dataset's grid to `path`, or why it stopped."""
    mesh = refined(dataset.fem_mesh) if fine else dataset.fem_mesh
    try:
        scene = dataset.scene.with_solver(choice)
        found = simulated(dataset, *case, scene, mesh)
    except SolverStopped as stop:
        save_arrays(path, stopped=stop.reason)
    else:
        displacement = found["displacement"]
        on_grid = (
            grid_of(mesh).to_grid(displacement)[:, ::2, ::2, ::2]
            if fine
            else dataset.displacement_on_grid(displacement)
        )
        save_arrays(path, displacement=on_grid)
