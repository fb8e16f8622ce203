"""Error against how many interactions an answer has learned from, and what they and the learning
cost."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fem.cache import cache_root, digest, once
from fem.data.dataset import Dataset, open_dataset
from fem.data.interaction import healthy_interaction
from fem.data.write import HEALTH, write_dataset
from fem.errors import InputError
from fem.files import make_folder
from fem.online.reduced_model import ReducedModel
from fem.online.regression import RegressionStepper
from fem.reduced.build import Choice, Which, held_out, reduce, tested
from fem.reduced.judge import judge
from unet_fem.deployment import modal
from unet_fem.deployment.answers import muted
from unet_fem.deployment.constitutive import make_network
from unet_fem.networks.registry import Elastic, Linear, Options, Pod
from unet_fem.steppers import open_stepper
from unet_fem.training import constitutive
from unet_fem.training.inputs import input_field
from unet_fem.training.regressions import fit_regression
from unet_fem.training.settings import InputChoice

VERSION = 1  # raise it when the same files give other results
REDUCED = Choice(modes=320, inputs=120, points=300)
MODAL = replace(modal.CHOICE, taught=3000)
SIMULATED = 4  # interactions of a kind that are simulated again, to tell what one costs
WINDOW, CREEP = InputChoice("window", "force"), InputChoice("creep", "force")
REGRESSIONS: dict[str, tuple[Options, InputChoice]] = {
    "linear regression on the force": (Linear(), WINDOW),
    "linear regression on the remembered force": (Linear(), CREEP),
    "POD + squares on the remembered force": (Pod(), CREEP),
    "linear elastic answer to the remembered force": (Elastic(), CREEP),
}
ON_MODES = ("reduced solver", "constitutive network", "modal network")
ANSWERS = (*REGRESSIONS, *ON_MODES)


def learning_curve(
    dataset: Dataset,
    judged_by: Dataset,
    sizes: list[int],
    hard: int = 0,
    answers: tuple[str, ...] = ANSWERS,
    kept: bool = False,
    tell: Callable[[str], None] = print,
) -> dict:
    """{"interactions": {"usual", "hard": how many judge}, "rows": [{"answer", "interactions",
    "usual", "hard": relative L2 errors, "simulation", "learning": CPU seconds}, ...]}.

    An answer learns from the first `size` of the dataset's interactions, of which each size has the
    same share from the split "hard": `hard` of all. The others of "hard" and the validation split
    are to choose by, for all sizes. `judged_by` has the interactions that judge. What is done is
    kept under the cache root; kept: only what is there. Raises InputError for a size that the
    dataset does not have.
    """
    groups, rows = tested(judged_by), []
    for size in sizes:
        path = cache_root() / "learning_curve" / f"{size}-{digest([size, hard], [dataset.path])}"
        part = part_of(dataset, size, hard, path / "data.h5")
        spent = cost(dataset, path) @ shares(dataset, size, hard)
        for answer in answers:
            key = digest([answer, REDUCED, MODAL], [part.path, judged_by.path], VERSION)
            found = path / f"{answer.replace(' ', '_')}.json"
            if kept and not found.is_file():
                continue

            def make(answer: str = answer, part: Dataset = part, path: Path = path) -> dict:
                stepper, seconds = make_answer(answer, part, path)
                with muted():
                    verdicts = {n: judge(stepper, judged_by, g) for n, g in groups.items()}
                return {n: one.error for n, one in verdicts.items()} | {"learning": seconds}

            result = once(found, key, make)
            free = answer.startswith("linear elastic")
            row = {"answer": answer, "interactions": 0 if free else size, **result}
            rows.append(row | {"simulation": 0.0 if free else spent})
            tell(f"{size:5} {answer}: " + told(row))
    return {"interactions": {name: len(some) for name, some in groups.items()}, "rows": rows}


def told(row: dict) -> str:
    """A row in words."""
    errors = " / ".join(f"{100 * row[name]:.2f}" for name in ("usual", "hard") if name in row)
    return f"{errors} %, {row['learning']:.0f} CPU s to learn"


def shares(dataset: Dataset, size: int, hard: int) -> np.ndarray:
    """(2,) how many of `size` interactions are of the split "train" and of "hard"."""
    have = int(np.sum(dataset.split == "train")), hard
    if not 1 <= size <= sum(have):
        raise InputError(
            f"size {size} is not among the {sum(have)} interactions to learn from in {dataset.path}"
        )
    some = round(size * hard / sum(have))
    return np.array([size - some, some])


def part_of(dataset: Dataset, size: int, hard: int, path: Path) -> Dataset:
    """A dataset at `path` with `size` interactions to learn from, all in its split "train", and all
    that `dataset` holds out in its split "validation"."""
    if path.is_file():
        return open_dataset(path)
    usual, few = shares(dataset, size, hard)
    train = [("train", n + 1) for n in range(usual)] + [("hard", n + 1) for n in range(few)]
    held = [one for some in held_out(dataset, hard).values() for one in some]
    kept: list[Which] = [*train, *held, held[0]]  # a dataset has a test, which nobody reads here
    some = replace(
        dataset.scene.interactions,
        train=len(train),
        validation=len(held),
        test=1,
        hard=None,
        hard_set=0,
        hard_force=None,
    )
    make_folder(path.parent)
    scene = replace(dataset.scene, interactions=some)
    write_dataset(path, scene, dataset.fem_mesh, (_result(dataset, *one) for one in kept))
    return open_dataset(path)


def _result(dataset, split, number):
    """An interaction as write_dataset takes it."""
    one = dataset.sequence(split, number)
    with h5py.File(dataset.path) as file:
        row = np.flatnonzero((dataset.split == split) & (dataset.number == number))[0]
        rest = {name: file[name][row] for name in ("volume", "energy", "contacts")}
        health = {name: file[f"health/{name}"][row] for name in HEALTH}
    fields = {"force": one.force, "displacement": one.displacement}
    return fields | rest | health | {"rejected": {}}


def cost(dataset: Dataset, path: Path) -> np.ndarray:
    """(2,) CPU seconds of a simulation of the splits "train" and "hard"."""

    def measure() -> list[float]:
        return [_seconds(dataset, split) for split in ("train", "hard")]

    where = path.parent / f"cost-{digest([SIMULATED], [dataset.path], VERSION)}.json"
    return np.array(once(where, "cost", measure))


def _seconds(dataset, split):
    if split not in dataset.split:
        return 0.0
    start = time.process_time()
    for number in range(1, SIMULATED + 1):
        healthy_interaction(dataset.scene, dataset.fem_mesh, split, number)
    return (time.process_time() - start) / SIMULATED


def make_answer(answer: str, part: Dataset, folder: Path) -> tuple[Any, float]:
    """(stepper, CPU seconds of the learning) of one of ANSWERS, learned from `part`; what stands on
    the reduced model counts its making, which is done once for all of them."""
    start = time.process_time()
    if answer in REGRESSIONS:
        options, choice = REGRESSIONS[answer]
        field = input_field(choice, part)
        fitted = fit_regression(part, options, field=field)
        return RegressionStepper(fitted), time.process_time() - start
    path = folder / "reduced.npz"

    def make() -> float:
        begun = time.process_time()
        reduce(part, REDUCED)[0].save(path)
        return time.process_time() - begun

    before = once(folder / "reduced.json", digest([REDUCED], [part.path], VERSION), make)
    if answer == "reduced solver":
        return open_stepper(path), before
    model, start = ReducedModel.load(path), time.process_time()
    if answer == "constitutive network":
        files = make_network(part, model, folder, recipe=constitutive.Recipe(), tell=_silent)
        stepper = open_stepper(files["float32"])
    else:
        stepper = modal.make_modal(part, model, folder / "modal.tflite", choice=MODAL, tell=_silent)
    return stepper, before + time.process_time() - start


def _silent(line: str) -> None:
    pass
