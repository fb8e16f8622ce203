"""From a dataset and its reduced model to a trained modal network in its file."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tensorflow as tf

from fem.data.dataset import Dataset
from fem.online.reduced_model import ReducedModel
from fem.reduced.build import held_out, learned, tested
from fem.reduced.judge import Verdict, judge
from unet_fem.deployment.answers import muted
from unet_fem.deployment.conformal import fitted_guard, watched
from unet_fem.deployment.constitutive import NOBODY
from unet_fem.deployment.tflite import lite_converter, quiet
from unet_fem.deployment.tflite_graph import audit, named_outputs
from unet_fem.networks.modal import ModalNetwork
from unet_fem.runtime.modal import ModalSurrogate, write_modal
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
) -> ModalSurrogate:
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
    graph = export_modal(network, model)
    write_modal(path, graph, model, np.array(NOBODY))
    against = [one for some in held_out(dataset, hard).values() for one in some]
    sequences = (dataset.sequence(*one) for one in against)
    guard = fitted_guard(*watched(ModalSurrogate(path), sequences))
    write_modal(path, graph, model, guard)
    return ModalSurrogate(path)


def export_modal(network: ModalNetwork, model: ReducedModel) -> bytes:
    """The bytes of a .tflite file of one frame, of builtin operators alone.

    In: inputs (1, 2 R) mm, [l; g]; kept (K + 1, p), the p_k and p of the last frame; weights
    (K + 1, K + 2), fem.online.creep.filter_weights of the Prony series. Out: a (1, R) mm;
    displacement (1, sides 3 h) mm of the left and then the right free nodes, and its largest
    component; new_kept.
    """
    decoders = [tf.constant(block.decoder.T) for block in model.blocks]
    ends = np.cumsum([0] + [len(block.M) for block in model.blocks])
    sign = np.ones((3, model.free.shape[1]), "float32")
    if model.axis is not None:
        sign[model.axis] = -1
    terms, modes = len(model.prony), model.modes
    rest: list[Any] = []

    def nothing(p: Any) -> Any:
        rest.append(p)
        return 0 * p

    a0 = network.frames(tf.zeros((1, 2 * modes)), nothing).numpy()
    p0 = rest[0].numpy()

    def frame(inputs: Any, kept: Any, weights: Any) -> dict:
        memory = []

        def remember(p: Any) -> Any:
            found = tf.concat([kept, p - p0], 0)
            new = weights @ found
            memory.append(tf.concat([new[:-1], found[-1:]], 0))
            return new[-1:]

        a = inputs[:, :modes] + network.frames(inputs, remember) - a0
        parts = zip(ends[:-1], ends[1:], decoders, strict=True)
        u = [a[:, i:j] @ decoder for i, j, decoder in parts]
        if len(u) == 2:
            u = [u[0] + u[1], (u[0] - u[1]) * sign.reshape(1, -1)]
        displacement = tf.concat(u, 1)
        found = {"largest": tf.reduce_max(tf.abs(displacement)), "new_kept": memory[0]}
        return found | {"a": a, "displacement": displacement}

    shapes = {"inputs": (1, 2 * modes), "kept": (terms + 1, network.remembered)}
    shapes["weights"] = (terms + 1, terms + 2)
    specs = [tf.TensorSpec(shape, "float32", name=name) for name, shape in shapes.items()]
    with quiet():
        traced = tf.function(frame, input_signature=specs).get_concrete_function()
        data = lite_converter(traced, "float32").convert()
        audit(data, "float32")
    return named_outputs(data, sorted(traced.structured_outputs))


def judge_modal(
    stepper: ModalSurrogate,
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
