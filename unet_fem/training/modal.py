"""Training of the modal network on interactions that a reduced model answers.

A reduced model answers a frame in a fraction of a millisecond, and to a fraction of a per cent:
what it answers to contacts that were never simulated is as good to learn from as a simulation, and
costs a twentieth. So the network learns from as many interactions as it needs, of pushes and pulls,
and over spans that the dataset does not reach.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import keras
import numpy as np

from fem.contact.draw import draw_contacts
from fem.contact.push import Load
from fem.contact.surface import surface_of
from fem.data.dataset import Dataset
from fem.online.creep import Creep, remembered_force
from fem.online.grid import MN
from fem.online.reduced import ReducedStepper
from fem.online.reduced_model import ReducedModel
from unet_fem.networks.modal import ModalNetwork

SEED = 77  # beside the scene's, of contacts that its own draws do not have
HARD, PULLS, SLOW = 1 / 3, 0.15, 0.2  # shares of the interactions
SLOWEST = 24.0  # how many times longer than the scene's a slow interaction is at most
UNREST = 1e-2  # |r| / |a| of a frame that the reduced model gave up
LEAST = 1e-2  # mm, |a| below which that says nothing


@dataclass(frozen=True, eq=False)
class Lessons:
    """Interactions in modal coordinates: g (I, F, R) mm the elastic answers to the forces, a
    (I, F, R) mm the displacements, interval (I,) s between the frames of each."""

    g: np.ndarray
    a: np.ndarray
    interval: np.ndarray

    def __len__(self) -> int:
        return len(self.g)

    def joined(self, more: "Lessons") -> "Lessons":
        """These and others."""
        both = zip(self._arrays(), more._arrays(), strict=True)
        return Lessons(*(np.concatenate(pair) for pair in both))

    def _arrays(self):
        return self.g, self.a, self.interval

    def coordinates(self, kept: np.ndarray) -> "Lessons":
        """Those of the modes `kept` alone."""
        return replace(self, g=self.g[..., kept], a=self.a[..., kept])

    def inputs(self, prony: tuple[tuple[float, float], ...]) -> tuple[np.ndarray, np.ndarray]:
        """([l; g] (I, F, 2 R), past (I, F, F)) of a ModalNetwork."""
        creep, remembers = Creep.of(prony), Creep(prony)
        unit = np.eye(self.g.shape[1])
        linear, past = np.empty_like(self.g), np.empty((len(self), len(unit), len(unit)), "float32")
        for dt in np.unique(self.interval):
            rows = self.interval == dt
            linear[rows] = remembered_force(creep, self.g[rows], dt)
            past[rows] = remembered_force(remembers, unit, dt)
        return np.concatenate([linear, self.g], axis=-1), past


def taught(
    dataset: Dataset,
    model: ReducedModel,
    count: int,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> Lessons:
    """Lessons of `count` interactions with contacts of the dataset's scene, which its seed and
    their number decide, less those that the model does not settle.

    HARD of them push as hard as the scene's hard ones, PULLS of them pull, and SLOW of them are up
    to SLOWEST times longer.
    """
    scene, surface = dataset.scene, surface_of(dataset.fem_mesh)
    stepper, times = ReducedStepper(model), scene.frames.times
    g, a = np.zeros((2, count, len(times), model.modes), "float32")
    interval, settled = np.full(count, scene.frames.interval), np.ones(count, bool)
    for i in progress(range(count)):
        rng = np.random.default_rng([scene.interactions.seed, SEED, i])
        hard, pulls, slow = rng.random(3) < (HARD, PULLS, SLOW)
        factor = scene.interactions.hard_force if hard else None
        contacts = draw_contacts(surface, scene.contact, scene.frames.duration, rng, factor)
        load, sign = Load(surface, contacts), -MN if pulls else MN
        if slow:
            interval[i] *= SLOWEST ** rng.random()
        stepper.reset()
        for n, t in enumerate(times):
            # the first frame is at rest, an interval after the reset
            force = sign * load(t).T
            g[i, n] = stepper.fields.encode(force)[1]
            stepper.step(force, interval[i])
            a[i, n] = stepper.a
            moved = float(np.linalg.norm(stepper.a)) > LEAST
            settled[i] &= not moved or stepper.unrest < UNREST
    return Lessons(g[settled], a[settled], interval[settled])


def largest_modes(lessons: Lessons, count: int) -> np.ndarray:
    """The numbers of the `count` coordinates with the most of the displacement."""
    energy = np.square(lessons.a, dtype=float).sum(axis=(0, 1))
    return np.sort(np.argsort(-energy)[:count])


@dataclass(frozen=True)
class Recipe:
    """epochs of Adam on `batch` interactions a step; learning_rate: its peak, after a twentieth."""

    epochs: int = 20
    batch: int = 16
    learning_rate: float = 3e-3
    weight_decay: float = 1e-4
    seed: int = 0


def train_modal(
    lessons: Lessons,
    prony: tuple[tuple[float, float], ...],
    parity: np.ndarray,
    recipe: Recipe,
    verbose: int = 2,
    **sizes: int,
) -> ModalNetwork:
    """A ModalNetwork of these `sizes` trained on lessons and their mirror images; parity (R,): what
    a mirror does to the coordinates, or ones where there is none.

    A frame counts by its error beside its displacement, and small ones less.
    """
    keras.utils.set_random_seed(recipe.seed)
    x, past = lessons.inputs(prony)
    R = lessons.a.shape[-1]
    target = lessons.a - x[..., :R]
    square = np.square(lessons.a).sum(axis=-1)
    weight = 1 / (square + 0.3 * np.median(square[square > 0]))
    weight = (weight / weight.mean()).astype("float32")
    if (parity < 0).any():
        x = np.concatenate([x, x * np.tile(parity, 2)])
        target = np.concatenate([target, target * parity])
        past, weight = (np.concatenate([values, values]) for values in (past, weight))
    network = ModalNetwork(R, scales=(x[..., :R].std(), target.std()), **sizes)
    weight /= np.float32(target.var())
    steps = recipe.epochs * -(-len(x) // recipe.batch)
    schedule = keras.optimizers.schedules.CosineDecay(
        0.0, steps, warmup_target=recipe.learning_rate, warmup_steps=max(steps // 20, 1)
    )
    adam = keras.optimizers.AdamW(schedule, weight_decay=recipe.weight_decay, clipnorm=1.0)
    network.compile(optimizer=adam, loss="mse", jit_compile=True)
    network.fit(
        (x, past),
        target,
        sample_weight=weight,
        batch_size=recipe.batch,
        epochs=recipe.epochs,
        verbose=verbose,
    )
    return network
