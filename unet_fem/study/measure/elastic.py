"""The answers of an elastic tissue to a dataset's interactions: the same contacts, mesh and solver
without the Prony terms."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError, SolverStopped
from fem.files import save_arrays
from fem.workers import on_all_cores
from unet_fem.study.dataset import Case, name_of, simulated
from unet_fem.study.keys import key
from unet_fem.study.settings import Study

VERSION = 2


def elastic_answers(
    study: Study, dataset: Dataset, cases: Iterable[Case]
) -> tuple[dict[Case, np.ndarray], dict[str, str]]:
    """({case: displacement (frames, nx, ny, nz, 3) mm}, {name: why it stopped}) of interactions
    without the Prony terms.

    Computed in parallel where they are missing, and kept in the cache. Raises InputError if all of
    them stop.
    """
    folder = study.cache / "elastic"
    paths = {}
    for case in cases:
        made_from = key(case, [dataset.path], VERSION)
        paths[case] = folder / f"{case[0]}-{case[1]:04d}-{made_from}.npz"
    missing = [(dataset, case, path) for case, path in paths.items() if not path.is_file()]
    if missing:
        on_all_cores(elastic_answer, missing, f"elastic answers to {dataset.path.name}")
    answers, stopped = {}, {}
    for case, path in paths.items():
        with np.load(path) as file:
            if "stopped" in file:
                stopped[name_of(case)] = str(file["stopped"])
            else:
                answers[case] = file["displacement"]
    if not answers:
        raise InputError(
            f"the elastic tissue stops in every interaction asked of {dataset.path};"
            " lower contact.force in its scene"
        )
    return answers, stopped


def elastic_answer(dataset: Dataset, case: Case, path: Path) -> None:
    """Write the frames of an interaction to `path`, or why it stopped: the dataset's mesh,
    contacts and solver, an elastic tissue."""
    scene = dataset.scene
    elastic = replace(scene, material=scene.material.elastic())
    try:
        found = simulated(dataset, *case, elastic)
    except SolverStopped as stop:
        save_arrays(path, stopped=stop.reason)
    else:
        save_arrays(path, displacement=dataset.displacement_on_grid(found["displacement"]))
