"""The few answers to the test interactions that are kept for the figures of fields."""

from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.files import save_arrays
from unet_fem.study.settings import Study
from unet_fem.study.steppers import linear_name


def drawn_runs(study: Study) -> set[str]:
    """Runs whose answers are kept: the main ones, and the first of every arm."""
    return {*(main.run for main in study.main), *(arm.runs[0] for arm in study.physics)}


def drawn_regression(study: Study) -> str:
    """The linear regression in those figures: the one that sees what the first main network
    sees."""
    return linear_name(study.network(study.main[0].run).model.window)


def keep_field(path: Path, dataset: Dataset, answer: np.ndarray) -> None:
    """Write `answer` (S, nx, ny, nz, 3) mm to `path`, rounded by 0.05 % at most."""
    save_arrays(path, field=answer[:, dataset.free].astype("float16"))


def kept_field(path: Path, dataset: Dataset) -> np.ndarray:
    """(S, nx, ny, nz, 3) float32 mm: what `keep_field` wrote. Raises InputError if it is gone."""
    if not path.is_file():
        raise InputError(f"no {path}; give python tools/report.py --again accuracy")
    with np.load(path) as file:
        values = file["field"]
    field = np.zeros((len(values), *dataset.grid, 3), "float32")
    field[:, dataset.free] = values
    return field
