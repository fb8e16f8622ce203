"""From a dataset and its reduced model to a trained constitutive network in its files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.files import make_folder
from fem.online.constitutive import save_constitutive
from fem.online.reduced_model import ReducedModel
from fem.reduced.build import held_out, learned, tested
from fem.reduced.judge import Verdict, judge
from fem.reduced.volumetric import volumetric_share
from unet_fem.deployment.answers import muted
from unet_fem.deployment.conformal import Coverage, coverage, fitted_guard, watched
from unet_fem.deployment.constitutive_graph import export_constitutive
from unet_fem.networks.constitutive import ConstitutiveCell
from unet_fem.runtime.constitutive import ConstitutiveSurrogate, write_constitutive
from unet_fem.training.constitutive import (
    Recipe,
    coarse_first,
    fit_coarse,
    read_interactions,
    train_through_windows,
)

NOBODY = 0.0, 0.0, 0.0, 0.0, 1e9  # a guard that never doubts
EFFORT = 0.01, 12  # of a file: chosen on validation interactions, see docs/method.md


EFFORTS = (1.0, 1), (0.02, 12), EFFORT, (0.005, 12), (0.002, 12)


def judge_efforts(
    path: Path | str, dataset: Dataset, interval: float | None = None, first: int | None = None
) -> dict[tuple[float, int], dict[str, Verdict]]:
    """{effort: {"usual", "hard": Verdict}} of a .tflite file on the test and the hard interactions
    of a dataset, the `first` of each; at frames of `interval` s against the quasi-static solver."""
    result: dict[tuple[float, int], dict[str, Verdict]] = {}
    for effort in EFFORTS:
        stepper = ConstitutiveSurrogate(path, effort=effort)
        with muted():
            result[effort] = {
                name: judge(stepper, dataset, some[:first], interval)
                for name, some in tested(dataset).items()
            }
    return result


def judge_guard(path: Path | str, dataset: Dataset) -> dict[tuple[float, int], dict[str, Coverage]]:
    """{effort: {"usual", "hard": Coverage}} of the file's own effort and one evaluation always."""
    result: dict[tuple[float, int], dict[str, Coverage]] = {}
    for effort in EFFORTS[0], EFFORT:
        surrogate = ConstitutiveSurrogate(path, effort=effort)
        result[effort] = {
            name: coverage(surrogate, (dataset.sequence(*one) for one in some))
            for name, some in tested(dataset).items()
        }
    return result


def make_network(
    dataset: Dataset,
    model: ReducedModel,
    folder: Path | str,
    hard: int = 0,
    coarse: int = 40,
    recipe: Recipe | None = None,
    tell: Callable[[str], None] = print,
) -> dict[str, Path]:
    """Train on what the model was made from, write {"npz", "float32", "float16"} into `folder`, and
    tell how the network does on the interactions held out.

    hard: how many interactions of the split "hard" to learn from, as for fem.reduce; coarse: points
    a side that N sees; recipe: None leaves the training through windows out. Raises InputError for
    a model of another mesh, or another law than the neo-Hookean.
    """
    model.check(dataset.mesh_digest)
    against = [one for some in held_out(dataset, hard).values() for one in some]
    data = read_interactions(dataset, model, learned(dataset, hard))
    model = coarse_first(model, data)
    cell = ConstitutiveCell.of(model, min(coarse, model.points // len(model.blocks)))
    fit_coarse(cell, data)
    if recipe is not None:
        unseen = read_interactions(dataset, model, against)
        train_through_windows(cell, data, unseen, recipe, tell)
    arrays = cell.learned | volumetric_share(model, dataset.fem_mesh, dataset.material)
    arrays |= {"effort": np.array(EFFORT), "guard": np.array([NOBODY, NOBODY])}
    make_folder(folder)
    files = {"npz": Path(folder, "network.npz")}
    files |= {name: Path(folder, f"{name}.tflite") for name in ("float32", "float16")}
    graphs = {name: export_constitutive(cell, model, name) for name in ("float32", "float16")}
    for row, effort in (0, EFFORT), (0, EFFORT), (1, (1.0, 1)):  # the effort depends on the guard
        write_constitutive(files["float32"], graphs["float32"], model.arrays() | arrays)
        surrogate = ConstitutiveSurrogate(files["float32"], effort=effort)
        features, errors = watched(surrogate, (dataset.sequence(*one) for one in against))
        arrays["guard"][row] = fitted_guard(features, errors)
    save_constitutive(files["npz"], model, arrays)
    for name, graph in graphs.items():
        write_constitutive(files[name], graph, model.arrays() | arrays)
    tell(
        f"frames held out: error {100 * np.median(errors):.2f} % in the middle,"
        f" {100 * np.percentile(errors, 99):.2f} % at the 99th of a hundred"
    )
    return files
