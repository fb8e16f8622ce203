"""A reduced model from a dataset: basis, cubature, fit, and the judgement of it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fem import settings
from fem.cache import cache_root, digest
from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.reduced import ReducedStepper
from fem.online.reduced_model import ReducedModel
from fem.ranges import number
from fem.reduced.assemble import Assembly
from fem.reduced.cubature import cubature
from fem.reduced.judge import Verdict, judge
from fem.reduced.points import check_element
from fem.reduced.reduction import Body, Reduction
from fem.reduced.snapshots import Snapshots, Which, open_snapshots, read_snapshots

VERSION = 1  # of the cached snapshots; raise it when the same file gives others
RIDGES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)


@dataclass(frozen=True)
class Choice:
    """modes: R, or below 1 what they may leave out of the snapshots, relative L2; inputs: how many
    of them the points see; points: m; hard: how many interactions of the split "hard" to learn
    from, beside "train"; frames: to choose the points by; seed: of the draws."""

    modes: float = number(1e-9, 1_000_000, default=240)
    inputs: int = number(1, 1_000_000, default=120)
    points: int = number(1, 1_000_000, default=200)
    hard: int = number(0, 1_000_000, default=0)
    frames: int = number(1, 1_000_000, default=150)
    seed: int = number(0, 2**32 - 1, default=0)

    def __post_init__(self) -> None:
        settings.normalised(self)
        if self.inputs > self.modes >= 1:
            raise InputError(
                f"inputs = {self.inputs} must be at most modes = {self.modes:g}, of which they are"
            )


def learned(dataset: Dataset, hard: int) -> list[Which]:
    """The interactions to learn from: the split "train", and the first `hard` of "hard"."""
    have = int(np.sum(dataset.split == "hard"))
    if hard > have:
        raise InputError(f"hard = {hard}, and {dataset.path} has {have} hard interactions")
    return [
        (str(split), int(number))
        for split, number in zip(dataset.split, dataset.number, strict=True)
        if split == "train" or (split == "hard" and number <= hard)
    ]


def held_out(dataset: Dataset, hard: int) -> dict[str, list[Which]]:
    """{"usual", "hard"}: interactions to choose by; hard ones where some are learned from, those
    that are not."""
    which = [(str(s), int(n)) for s, n in zip(dataset.split, dataset.number, strict=True)]
    found = {"usual": [one for one in which if one[0] == "validation"]}
    if hard:
        found["hard"] = [one for one in which if one[0] == "hard" and one[1] > hard]
    return {name: some for name, some in found.items() if some}


def tested(dataset: Dataset) -> dict[str, list[Which]]:
    """{"usual", "hard"}: the test interactions, and the hard ones of the test and of the split
    "hard"."""
    rows = zip(dataset.split, dataset.number, dataset.hard, strict=True)
    which = [(str(split), int(number), bool(hard)) for split, number, hard in rows]
    found = {
        "usual": [one[:2] for one in which if one[0] == "test" and not one[2]],
        "hard": [one[:2] for one in which if one[0] in ("test", "hard") and one[2]],
    }
    return {name: some for name, some in found.items() if some}


def snapshots_of(
    dataset: Dataset,
    body: Body,
    which: list[Which],
    progress: Callable[[Iterable[Which]], Iterable[Which]] = iter,
) -> Snapshots:
    """The Snapshots of some interactions, kept under the cache root; read from there where the same
    file gave them."""
    key = digest([which], [dataset.path], VERSION)
    path = cache_root() / "reduced" / f"{key}.h5"
    if path.is_file():
        return open_snapshots(path)
    return read_snapshots(dataset, which, body.free, body.loadable, path, progress=progress)


def reduce(
    dataset: Dataset,
    choice: Choice,
    tell: Callable[[str], None] = lambda line: None,
    progress: Callable[[Iterable[Which]], Iterable[Which]] = iter,
) -> tuple[ReducedModel, dict[str, Verdict]]:
    """The ReducedModel of a dataset, and how it does on the interactions held out.

    Raises InputError for an element or a law that cannot be reduced.
    """
    check_element(dataset.scene.solver.element)
    body = Body(dataset.fem_mesh, dataset.material)
    plane = "no mirror plane" if body.axis is None else f"mirrored in {'xyz'[body.axis]}"
    which = learned(dataset, choice.hard)
    tell(f"{len(which)} interactions to learn from; the body is {plane}")
    snapshots = snapshots_of(dataset, body, which, progress)
    tell(f"modal coordinates of them are kept in {snapshots.path}")
    reduction = Reduction(body, snapshots, list(range(len(which))), choice.modes)
    modes = int(reduction.starts[-1])
    left_out = reduction.decomposition.left_out(modes)
    tell(f"{modes} modes leave out {100 * left_out:.3f} % of what they were made from")
    seen, rng = reduction.first(min(choice.inputs, modes)), np.random.default_rng(choice.seed)
    points, weights, residual = cubature(reduction, seen, choice.points, choice.frames, rng)
    tell(
        f"{points.rows.size} points; they alone miss {100 * residual:.1f} % of the nonlinear force"
    )
    assembly = Assembly(reduction, seen, points, weights)
    against = held_out(dataset, choice.hard)
    meta = {"data": dataset.path.name, "interactions": len(which)}
    best, verdicts, score = None, {}, np.inf
    for ridge in RIDGES:
        model = assembly.model(ridge, ridge=ridge, **meta)
        found = {n: judge(ReducedStepper(model), dataset, some) for n, some in against.items()}
        errors = [verdict.error for verdict in found.values()]
        tell(f"fit with ridge {ridge:g}: " + ", ".join(f"{100 * e:.2f} %" for e in errors))
        if np.prod(errors) < score:
            best, verdicts, score = model, found, float(np.prod(errors))
    assert best is not None, "validation has an interaction at least"
    return best, verdicts


def default_path(dataset: Dataset) -> Path:
    """Beside the dataset."""
    return dataset.path.with_name(f"{dataset.path.stem}_reduced.npz")
