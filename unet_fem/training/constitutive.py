"""Training of the constitutive network: N by least squares on the network's own states, then N and
the gains of the start through windows of frames.

A step is trained on what it meets when it runs by itself, so that one evaluation a frame stays
stable; M stays the equation of the reduced model, so that further evaluations go on converging.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import keras
import numpy as np
from keras import ops

from fem.data.dataset import Dataset
from fem.online.creep import Creep
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from unet_fem.metrics import relative_l2_of_sums
from unet_fem.networks.constitutive import ConstitutiveCell, Memory, Rates
from unet_fem.runtime.rates import rates

Which = tuple[str, int]  # split and number of an interaction
RIDGE = 1e-3  # of N, of the mean square of its inputs
NOISE = 0.06  # on the correction that comes in, of itself


@dataclass(frozen=True, eq=False)
class Interactions:
    """Interactions in modal coordinates.

    g (I, F, R) mm: the elastic answers to the forces; a (I, F, R) mm: the displacement; square (I,)
    mm2: of all free nodes' displacement over all frames; hard (I,) bool; interval: s between
    frames; prony: the tissue's.
    """

    g: np.ndarray
    a: np.ndarray
    square: np.ndarray
    hard: np.ndarray
    interval: float
    prony: tuple[tuple[float, float], ...]

    def __len__(self) -> int:
        return len(self.g)

    def select(self, rows: np.ndarray | slice) -> "Interactions":
        """Some of them."""
        chosen = {name: getattr(self, name)[rows] for name in ("g", "a", "square", "hard")}
        return replace(self, **chosen)

    @property
    def terms(self) -> tuple[int, int]:
        """How many Prony terms and retardations there are."""
        return len(self.prony), len(Creep.of(self.prony).terms)

    def rates(self, batch: int) -> Rates:
        """Of `batch` interactions side by side."""
        return Rates(*(np.repeat(x, batch, 0) for x in rates(self.prony, self.interval)))

    def error(self, a: np.ndarray, rows: np.ndarray | slice = slice(None)) -> float:
        """Relative L2 error of the displacements of coordinates a (I, F, R), and of what the modes
        leave out."""
        left_out = self.square[rows].sum() - np.sum(self.a[rows] ** 2, dtype=float)
        wrong = np.sum((a[rows] - self.a[rows]) ** 2, dtype=float)
        return relative_l2_of_sums(wrong + left_out, self.square[rows].sum()) or 0.0


def read_interactions(
    dataset: Dataset, model: ReducedModel, which: Iterable[Which]
) -> Interactions:
    """The interactions `which` of a dataset in the modes of a model."""
    fields, g, a, square, hard = Fields(model), [], [], [], []
    for split, number in which:
        one = dataset.sequence(split, number)
        g.append([fields.encode(force)[1].copy() for force in one.force])
        found = [fields.coordinates(u) for u in one.displacement]
        a.append([coordinates for coordinates, _ in found])
        square.append(sum(total for _, total in found))
        hard.append(dataset.scene.interactions.is_hard(split, number))
    interval = float(dataset.time[1] - dataset.time[0])
    prony = tuple((float(share), float(tau)) for share, tau in model.prony)
    arrays = np.array(g, "float32"), np.array(a, "float32"), np.array(square), np.array(hard)
    return Interactions(*arrays, interval, prony)


def parity(cell: ConstitutiveCell) -> np.ndarray:
    """(R,) what a mirror image does to the coordinates."""
    return np.concatenate([np.full(R, s, "float32") for R, s in zip(cell.sizes, (1, -1))])  # noqa: B905


class Window(keras.Model):
    """The frames (B, T, ...) of a batch, one after the other: g and noise -> a (B, T, R).

    It goes on from where the window before left off; `reset` brings it back to rest.
    """

    def __init__(
        self, cell: ConstitutiveCell, batch: int, terms: tuple[int, int], evaluations: int = 1
    ) -> None:
        super().__init__()
        self.cell, self.evaluations = cell, evaluations
        self.memory = [
            self.add_weight(x.shape, "zeros", trainable=False, name=name)
            for name, x in zip(Memory._fields, cell.rest(batch, *terms), strict=True)
        ]

    def reset(self) -> None:
        """No force in the past."""
        for value in self.memory:
            value.assign(ops.zeros(value.shape))

    def call(self, inputs: tuple) -> Any:
        """inputs: g (B, T, R) mm, noise (B, T, R), and the Rates."""
        g, noise, *rest = inputs
        memory, answers = Memory(*map(ops.convert_to_tensor, self.memory)), []
        for t in range(g.shape[1]):
            memory = memory._replace(correction=memory.correction * (1 + noise[:, t]))
            a, memory, _ = self.cell(g[:, t], memory, Rates(*rest), evaluations=self.evaluations)
            answers.append(a)
        for value, new in zip(self.memory, memory, strict=True):
            value.assign(new)
        return ops.stack(answers, axis=1)


def run(cell: ConstitutiveCell, data: Interactions, evaluations: int = 1) -> np.ndarray:
    """a (I, F, R) mm of the network by itself, from rest."""
    memory, rate, answers = cell.rest(len(data), *data.terms), data.rates(len(data)), []
    for t in range(data.g.shape[1]):
        a, memory, _ = cell(data.g[:, t], memory, rate, evaluations=evaluations)
        answers.append(ops.convert_to_numpy(a))
    return np.stack(answers, axis=1)


def coarse_first(model: ReducedModel, data: Interactions) -> ReducedModel:
    """The model with its points in another order: those first that N should see, whose strains
    weigh most in the balance."""
    h, weight = len(model.blocks[0].A) // 9, 0.0
    start = 0
    for block in model.blocks:
        a = data.a[..., start : start + block.A.shape[1]].reshape(-1, block.A.shape[1])
        strain = np.square(a @ block.A.T).mean(axis=0).reshape(9, h).sum(axis=0)
        carried = np.square(block.M[:, : 9 * h]).reshape(-1, 9, h).sum(axis=(0, 1))
        weight, start = weight + strain * carried, start + len(block.M)
    order = np.argsort(-weight)
    blocks = []
    for block in model.blocks:
        A = block.A.reshape(9, h, -1)[:, order].reshape(block.A.shape)
        T = block.M[:, : 9 * h].reshape(-1, 9, h)[:, :, order].reshape(-1, 9 * h)
        blocks.append(replace(block, A=A, M=np.hstack([T, block.M[:, 9 * h :]])))
    points = np.concatenate([side * h + order for side in range(len(model.blocks))])
    law = {
        name: np.asarray(value)[points].tolist() if np.shape(value) == points.shape else value
        for name, value in model.meta["law"].items()
    }
    return replace(model, blocks=tuple(blocks), meta=model.meta | {"law": law})


def fit_coarse(cell: ConstitutiveCell, data: Interactions, seed: int = 0) -> None:
    """N by ridge regression: what the residual is after the step r, beside what it would be at
    rest, in the states that the network meets by itself, with NOISE."""
    rng = np.random.default_rng(seed)
    size = np.linalg.norm(data.a, axis=2)
    weight = 1 / (size + 0.3 * np.sqrt(np.mean(size**2)))
    sums: list[list] = [[0.0, 0.0] for _ in cell.N]
    memory, rate = cell.rest(len(data), *data.terms), data.rates(len(data))
    for t in range(data.g.shape[1]):
        g = data.g[:, t]
        noise = 1 + NOISE * rng.standard_normal(g.shape).astype("float32")
        memory = memory._replace(correction=memory.correction * noise)
        r, change, *inputs = map(ops.convert_to_numpy, cell.seen_by_N(g, memory, rate))
        share = weight[:, t, None] * (np.linalg.norm(r, axis=1) < size[:, t] + 1)[:, None]
        for sum_, X, part in zip(sums, inputs, cell.parts, strict=True):
            X = np.nan_to_num(share * X).astype(float)
            sum_[0] += X.T @ X
            sum_[1] += X.T @ np.nan_to_num(share * change[:, part])
        memory = cell(g, memory, rate)[1]
    for N, (gram, right) in zip(cell.N, sums, strict=True):
        ridge = RIDGE * np.trace(gram) / len(gram)
        N.assign(np.linalg.solve(gram + ridge * np.eye(len(gram)), right))


@dataclass(frozen=True)
class Recipe:
    """steps of Adam on `batch` interactions by `window` frames; learning_rate: its peak, after a
    tenth of the steps; every: steps from one judgement to the next."""

    steps: int = 300
    batch: int = 16
    window: int = 5
    learning_rate: float = 2e-5
    every: int = 50
    seed: int = 0


def train_through_windows(
    cell: ConstitutiveCell,
    data: Interactions,
    held_out: Interactions,
    recipe: Recipe,
    tell: Callable[[str], None] = print,
) -> None:
    """Train the cell's trainable weights on its own states; it ends with the weights that do best
    on the interactions held out."""
    rng, start = np.random.default_rng(recipe.seed), time.monotonic()
    model = Window(cell, recipe.batch, data.terms, 1)
    schedule = keras.optimizers.schedules.CosineDecay(
        0.0,
        recipe.steps,
        warmup_target=recipe.learning_rate,
        warmup_steps=max(recipe.steps // 10, 1),
    )
    adam = keras.optimizers.Adam(schedule, clipnorm=0.05)
    model.compile(optimizer=adam, loss="mse", jit_compile=True)
    rate, image = data.rates(recipe.batch), parity(cell)
    square = np.mean(data.a**2, axis=(1, 2))
    weight = np.where(data.hard, 2.0, 1.0) / (square + np.median(square))
    T, frames = recipe.window, data.g.shape[1] - 1  # the first is at rest
    best, kept, done = judged(cell, held_out, tell, "before"), cell.get_weights(), 0
    while done < recipe.steps:
        rows = rng.integers(len(data), size=recipe.batch)
        flip = np.where(rng.random((recipe.batch, 1, 1)) < 0.5, image, np.float32(1))
        model.reset()
        for first in range(1, frames - T + 2, T):
            g, a = (x[rows, first : first + T] * flip for x in (data.g, data.a))
            noise = NOISE * rng.standard_normal(g.shape).astype("float32")
            share = np.repeat(weight[rows, None], T, axis=1).astype("float32")
            model.train_on_batch((g, noise, *rate), a, sample_weight=share)
            done += 1
            if done % recipe.every == 0:
                found = judged(cell, held_out, tell, f"{done} {time.monotonic() - start:.0f} s")
                if found < best:
                    best, kept = found, cell.get_weights()
    cell.set_weights(kept)


def judged(
    cell: ConstitutiveCell, data: Interactions, tell: Callable[[str], None], when: str
) -> float:
    """The geometric mean of the errors on usual and on hard interactions, with one evaluation."""
    with np.errstate(all="ignore"):
        a = np.nan_to_num(run(cell, data), nan=1e6, posinf=1e6, neginf=-1e6)
    kinds = {"usual": ~data.hard, "hard": data.hard}
    errors = {name: data.error(a, rows) for name, rows in kinds.items() if rows.any()}
    tell(f"{when}: " + ", ".join(f"{name} {100 * e:.3f} %" for name, e in errors.items()))
    return float(np.prod(list(errors.values())) ** (1 / len(errors)))
