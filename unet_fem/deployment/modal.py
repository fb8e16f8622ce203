"""From a dataset and its reduced model to a trained modal network in its file."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.online.reduced_model import ReducedModel
from fem.reduced.build import held_out, learned, tested
from fem.reduced.judge import Verdict, judge
from unet_fem.deployment.answers import muted
from unet_fem.deployment.conformal import guard_weights, watched
from unet_fem.runtime.modal import ModalStepper, save_modal
from unet_fem.training.constitutive import read_interactions
from unet_fem.training.modal import Lessons, Recipe, largest_modes, taught, train_modal

MISSING = 32  # rows of what the guard knows of forces that the modes cannot carry


@dataclass(frozen=True)
class Choice:
    """taught: how many interactions the reduced model answers, beside those of the dataset; modes:
    R; width, layers, remembered: see unet_fem.networks.modal.ModalNetwork."""

    taught: int = 6000
    modes: int = 120
    width: int = 256
    layers: int = 3
    remembered: int = 32


CHOICE, RECIPE = Choice(), Recipe()


def make_modal(
    dataset: Dataset,
    model: ReducedModel,
    path: Path | str,
    hard: int = 0,
    choice: Choice = CHOICE,
    recipe: Recipe = RECIPE,
    tell: Callable[[str], None] = print,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> ModalStepper:
    """The stepper of the network that is written to `path`, trained on what the model was made from
    and on what the model answers.

    hard: how many interactions of the split "hard" to learn from, as for fem.reduce. Raises
    InputError for a model of another mesh.
    """
    model.check(dataset.mesh_digest)
    own = read_interactions(dataset, model, learned(dataset, hard))
    lessons = Lessons(own.g, own.a, np.full(len(own), own.interval))
    if choice.taught:
        lessons = taught(dataset, model, choice.taught, progress).joined(lessons)
    tell(f"{len(lessons)} interactions to learn from, {len(own)} of them simulated")
    kept = largest_modes(lessons, choice.modes)
    model, parity = within(model, kept)
    network = train_modal(
        lessons.coordinates(kept),
        own.prony,
        parity,
        recipe,
        width=choice.width,
        layers=choice.layers,
        remembered=choice.remembered,
    )
    weights = network.weights_of_file() | {"guard": np.ones(4)}
    against = [one for some in held_out(dataset, hard).values() for one in some]
    sequences = (dataset.sequence(*one) for one in against)
    features, errors = watched(ModalStepper(model, weights), sequences)
    weights["guard"] = guard_weights(features, errors)
    save_modal(path, model, weights)
    return ModalStepper.open(path)


def judge_modal(
    stepper: ModalStepper,
    dataset: Dataset,
    groups: dict[str, list] | None = None,
    interval: float | None = None,
    first: int | None = None,
) -> dict[str, Verdict]:
    """{"usual", "hard": Verdict} on the `first` of the test and of the hard interactions of a
    dataset, or of other groups, at frames of `interval` s against the quasi-static solver."""
    groups = tested(dataset) if groups is None else groups
    with muted():
        return {
            name: judge(stepper, dataset, some[:first], interval) for name, some in groups.items()
        }


def within(model: ReducedModel, kept: np.ndarray) -> tuple[ReducedModel, np.ndarray]:
    """(the model without points and with the modes `kept` alone, what a mirror does to each)."""
    starts = np.cumsum([0] + [len(block.M) for block in model.blocks])
    blocks, parity = [], []
    for block, first, last in zip(model.blocks, starts[:-1], starts[1:], strict=True):
        own = kept[(kept >= first) & (kept < last)] - first
        blocks.append(
            replace(
                block,
                A=np.zeros((0, 0), "float32"),
                M=np.zeros((len(own), 0), "float32"),
                encoder=block.encoder[own],
                decoder=np.ascontiguousarray(block.decoder[:, own]),
                flexibility=block.flexibility[np.ix_(own, own)],
                missing=block.missing[:MISSING],
            )
        )
        parity.append(np.full(len(own), 1.0 if first == 0 else -1.0, "float32"))
    return replace(model, blocks=tuple(blocks)), np.concatenate(parity)
