"""What is known of one answer to the test interactions, and of one trained run."""

import json

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.volume import VOLUME_BAND
from unet_fem.metrics import relative_l2
from unet_fem.networks.files import load_model
from unet_fem.study.measure.sums import sums_of_squares
from unet_fem.training.depth import by_depth
from unet_fem.training.inputs import run_input
from unet_fem.training.judge import predict, rest_volume
from unet_fem.training.losses import deformed_volume
from unet_fem.training.samples import Samples, load_samples
from unet_fem.training.settings import Settings


def judged(
    answer: np.ndarray,
    dataset: Dataset,
    samples: Samples,
    truth: dict[int, np.ndarray],
    gate: float = VOLUME_BAND,
) -> dict:
    """What is known of `answer` (S, nx, ny, nz, 3) mm on the Samples of the test split.

    test, hard: relative L2 against the dataset, from sums [[error, truth], ...] in mm2 over free
    nodes and frames of each interaction;
    reference: [[number, [error, truth]], ...] against `truth` {number: (frames, nx, ny, nz, 3) mm};
    depth: see `by_depth`; violation: largest relative change of volume of each interaction;
    violation_mean over all frames; gate (the paper's for models that were trained without), and
    gate_open: share of frames with more than that. Raises InputError where the answer is not
    finite.
    """
    if not np.isfinite(answer).all():
        raise InputError(
            "an answer to the test interactions is not finite; its training has diverged: delete"
            " the run and lower train.learning_rate"
        )
    frames = len(dataset.time)
    by_interaction = answer.reshape(-1, frames, *answer.shape[1:])
    own = samples.displacement.reshape(by_interaction.shape)
    sums = [sums_of_squares(*pair, dataset) for pair in zip(by_interaction, own, strict=True)]
    row = {number: n for n, number in enumerate(dataset.number[dataset.split == "test"].tolist())}
    violation = np.abs(volumes(dataset, answer) / rest_volume(dataset) - 1)
    return {
        "test": _root(np.array(sums)),
        "hard": _root(np.array(sums)[samples.hard[::frames]]),
        "sums": sums,
        "reference": [
            [number, sums_of_squares(by_interaction[row[number]], field, dataset)]
            for number, field in truth.items()
        ],
        "depth": by_depth(dataset, answer, samples.displacement),
        "violation": violation.reshape(-1, frames).max(axis=1).tolist(),
        "violation_mean": float(violation.mean()),
        "gate": gate,
        "gate_open": float(np.mean(violation > gate)),
    }


def volumes(dataset: Dataset, answer: np.ndarray) -> np.ndarray:
    """(S,) mm3 of the mesh displaced by each field of `answer`, in batches: the faces of a few
    hundred fields fill the memory."""
    parts = [answer[i : i + 64] for i in range(0, len(answer), 64)]
    return np.concatenate(
        [np.asarray(deformed_volume(part, *dataset.surface), float) for part in parts]
    )


def run_facts(settings: Settings, dataset: Dataset) -> dict:
    """parameters; train and validation: relative L2; epochs, best_epoch, seconds (None where the
    history does not tell), seed;
    threshold of the volume loss, and train_gate_open, validation_gate_open: mean over the epochs of
    the share of samples beyond it."""
    model = load_model(settings.folder / "best.keras")
    facts = {
        "parameters": model.count_params(),
        "seed": settings.train.seed,
        "threshold": settings.loss.volume_threshold,
    }
    seen = run_input(settings, dataset)
    for split in ("train", "validation"):
        samples = load_samples(dataset, split, settings.model.window, seen)
        facts[split] = relative_l2(predict(model, samples, dataset)[0], samples.displacement)
    written = settings.folder / "history.json"
    # magnitude pruning leaves none
    history = json.loads(written.read_text()) if written.is_file() else {}
    epochs, seconds = history.get("val_relative_error", []), history.get("seconds", [])
    return facts | {
        "epochs": len(epochs) or None,
        "best_epoch": int(np.argmin(epochs)) + 1 if epochs else None,
        "seconds": float(sum(seconds)) if seconds and len(seconds) == len(epochs) else None,
        "train_gate_open": float(np.mean(history["gate_open"])) if epochs else None,
        "validation_gate_open": float(np.mean(history["val_gate_open"])) if epochs else None,
    }


def _root(sums):
    return float(np.sqrt(sums[:, 0].sum() / sums[:, 1].sum()))
