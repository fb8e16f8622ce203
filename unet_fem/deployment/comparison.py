"""A run and those beside it on the same unseen interactions: error, run time and size, as one
table, one figure and comparison.json."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.files import make_folder, write_text
from fem.online.stepper import Stepper
from fem.reduced.build import tested
from unet_fem.deployment.answers import muted
from unet_fem.deployment.comparison_figure import Shown, comparison_figure
from unet_fem.deployment.exported import lite_file
from unet_fem.deployment.tflite import export, surrogate_facts
from unet_fem.metrics import relative_l2_of_sums
from unet_fem.networks.files import load_model
from unet_fem.networks.registry import network
from unet_fem.runtime.surrogate_file import write_surrogate
from unet_fem.steppers import open_stepper
from unet_fem.training.inputs import run_input
from unet_fem.training.run import COMPARISON, model_file
from unet_fem.training.settings import Settings
from unet_fem.training.style import save


@dataclass(frozen=True)
class Row:
    """error: {"usual", "hard": relative L2}; p50, p99: CPU milliseconds a frame, one thread, from
    force array to displacement array; megabytes: of the file."""

    file: str
    error: dict[str, float | None]
    p50: float
    p99: float
    megabytes: float


def compare(runs: Sequence[Settings], dataset: Dataset) -> dict[str, Row]:
    """{label: Row} of some runs on the test interactions of their dataset; printed, drawn and
    written into the folder of the first."""
    files = {network(run.model.kind).label: stepper_file(run, dataset) for run in runs}
    steppers = {label: open_stepper(path) for label, path in files.items()}
    rows = judge(steppers, files, dataset)
    print("\n" + table(rows, dataset), flush=True)
    folder = runs[0].folder
    make_folder(folder / "figures")
    points = {label: (row.p50, row.error) for label, row in rows.items()}
    figure = comparison_figure(points, shown(steppers, dataset), dataset)
    save(figure, folder / "figures" / "comparison.png")
    written = {label: asdict(row) for label, row in rows.items()}
    write_text(folder / COMPARISON, json.dumps(written, indent=1))
    return rows


def stepper_file(settings: Settings, dataset: Dataset) -> Path:
    """What the run is deployed as: its own file, or of a Keras model the float32 .tflite, made
    here."""
    made = model_file(settings)
    if made.suffix != ".keras":
        return made
    path = lite_file(settings, "float32")
    facts = surrogate_facts(dataset, run_input(settings, dataset))
    graph = export(load_model(made), "float32")
    write_surrogate(path, graph, **facts, label=f"{settings.name}: float32")
    return path


def judge(
    steppers: Mapping[str, Stepper], files: Mapping[str, Path], dataset: Dataset
) -> dict[str, Row]:
    """{label: Row}; the steppers take turns, an interaction each."""
    dt = dataset.scene.frames.interval
    which = unseen(dataset)
    squares = {label: {kind: np.zeros(2) for kind in which} for label in steppers}
    spent: dict[str, list[float]] = {label: [] for label in steppers}
    for kind, some in which.items():
        for split, number in some:
            force, truth = fields(dataset, split, number)
            for label, stepper in steppers.items():
                answer, seconds = followed(stepper, force, dt)
                spent[label] += seconds
                pair = answer - truth, truth
                squares[label][kind] += [
                    np.sum(np.square(x[:, dataset.free], dtype=float)) for x in pair
                ]
    rows = {}
    for label, path in files.items():
        error = {kind: relative_l2_of_sums(*sums) for kind, sums in squares[label].items()}
        p50, p99 = (float(value) for value in 1e3 * np.quantile(spent[label], [0.5, 0.99]))
        rows[label] = Row(str(path), error, p50, p99, path.stat().st_size / 1e6)
    return rows


def unseen(dataset: Dataset) -> dict[str, list[tuple[str, int]]]:
    """{"usual", "hard"}: the test interactions; those of the split "hard" may have been learned
    from."""
    found = {
        kind: [one for one in some if one[0] == "test"] for kind, some in tested(dataset).items()
    }
    return {kind: some for kind, some in found.items() if some}


def fields(dataset: Dataset, split: str, number: int) -> tuple[np.ndarray, np.ndarray]:
    """(force mN, displacement mm) of an interaction on the grid, (F, nx, ny, nz, 3)."""
    found = dataset.read(split, ("force", "displacement"), [number])
    return found["force"][0], found["displacement"][0]


def shown(steppers: Mapping[str, Stepper], dataset: Dataset) -> Shown:
    """The test interaction of the largest displacement, as each stepper answers it."""
    numbers = dataset.number[dataset.split == "test"]
    number = max(map(int, numbers), key=lambda n: np.abs(fields(dataset, "test", n)[1]).max())
    force, truth = fields(dataset, "test", number)
    dt = dataset.scene.frames.interval
    answers = {label: followed(stepper, force, dt)[0] for label, stepper in steppers.items()}
    return Shown(f"Test interaction {number}", dataset.time, force, truth, answers)


def followed(
    stepper: Stepper, forces: np.ndarray, interval: float
) -> tuple[np.ndarray, list[float]]:
    """(displacement mm, CPU seconds of each frame) from rest under forces (F, ...) mN that come
    every `interval` s. Its warnings are held back."""
    dt, answers, spent = interval if stepper.interval is None else None, [], []
    stepper.reset()
    with muted():
        for force in forces:
            start = time.thread_time()
            answers.append(stepper.step(force, dt))
            spent.append(time.thread_time() - start)
    return np.stack(answers), spent


def table(rows: Mapping[str, Row], dataset: Dataset) -> str:
    """The rows as text."""
    kinds = {kind: len(some) for kind, some in unseen(dataset).items()}
    width = max(map(len, rows))
    heads = "".join(f"  {f'{kind} ({count}) %':>14}" for kind, count in kinds.items())
    lines = ["unseen interactions".ljust(width) + heads + "  CPU ms a frame   p99  file MB"]
    for label, row in rows.items():
        errors = "".join(f"  {_percent(row.error[kind]):>14}" for kind in kinds)
        lines.append(
            f"{label:<{max(width, 19)}}{errors}  {row.p50:14.2f} {row.p99:5.2f}"
            f"  {row.megabytes:7.2f}"
        )
    return "\n".join(lines)


def _percent(error):
    return "-" if error is None else f"{100 * error:.2f}"
