"""What is known of one answer to the unseen interactions, and of one trained run."""

import json
from dataclasses import fields

import numpy as np

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.online.input_field import InputField
from fem.online.volume import VOLUME_BAND
from unet_fem.metrics import relative_l2
from unet_fem.networks.files import load_model
from unet_fem.study.dataset import Case, name_of, named, unseen
from unet_fem.study.measure.statistics import errors
from unet_fem.study.measure.sums import sums_of_squares
from unet_fem.training.depth import by_depth
from unet_fem.training.inputs import run_input
from unet_fem.training.judge import predict
from unet_fem.training.losses import (
    deformed_volume,
    volume_at_rest,
    volume_scale,
)
from unet_fem.training.samples import Samples, load_samples
from unet_fem.training.settings import Settings
from unet_fem.training.surface import volume_surface


def unseen_cases(dataset: Dataset) -> list[Case]:
    """Every interaction that competitors are judged on, in the order of `unseen_samples`."""
    splits = [split for split in ("test", "hard") if split in dataset.split]
    return [(split, n) for split in splits for n in dataset.number[dataset.split == split].tolist()]


def unseen_samples(
    dataset: Dataset, steps: int | None = None, seen: InputField | None = None
) -> Samples:
    """The Samples of these interactions, the split "test" and then the split "hard"; `seen`: what
    the model sees of the forces."""
    splits = dict.fromkeys(split for split, _ in unseen_cases(dataset))
    parts = [load_samples(dataset, split, steps, seen) for split in splits]
    given = [own.name for own in fields(Samples) if getattr(parts[0], own.name) is not None]
    return Samples(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in given}
    )


def judged(
    answer: np.ndarray,
    dataset: Dataset,
    samples: Samples,
    truth: dict[Case, np.ndarray],
    gate: float = VOLUME_BAND,
    cases: list[Case] | None = None,
    volume_of: str = "all",
) -> dict:
    """What is known of `answer` (S, nx, ny, nz, 3) mm on Samples of the interactions `cases`, in
    this order; for None those of `unseen_samples`.

    usual, hard: errors against the dataset, see statistics.errors, from sums {name: [error, truth]}
    in mm2 over free nodes and frames of each interaction;
    reference: the same sums against `truth` {case: (frames, nx, ny, nz, 3) mm};
    depth: see `by_depth`, of the usual ones; violation: {name: largest relative change of volume};
    violation_mean over all frames; gate (the paper's for models that were trained without), and
    gate_open: share of frames with more than that, of the volume of `volume_of`, see
    losses.volume_surface, which the others are of too. Raises InputError where the answer is not
    finite.
    """
    if not np.isfinite(answer).all():
        raise InputError(
            "an answer to the unseen interactions is not finite; its training has diverged: delete"
            " the run and lower train.learning_rate"
        )
    cases = unseen_cases(dataset) if cases is None else cases
    subsets, frames = unseen(dataset), len(dataset.time)
    found = dict(zip(cases, answer.reshape(len(cases), frames, *answer.shape[1:]), strict=True))
    own = dict(zip(cases, samples.displacement.reshape(len(cases), frames, -1), strict=True))
    sums = {
        name_of(case): sums_of_squares(field, own[case].reshape(field.shape), dataset)
        for case, field in found.items()
    }
    surface = volume_surface(dataset, volume_of)
    violation = np.abs(volumes(surface, answer) / volume_at_rest(*surface) - 1)
    usual = np.repeat([case in subsets["usual"] for case in cases], frames)
    depth = by_depth(dataset, answer[usual], samples.displacement[usual]) if usual.any() else None
    return errors(sums, named(subsets)) | {
        "sums": sums,
        "reference": {
            name_of(case): sums_of_squares(found[case], field, dataset)
            for case, field in truth.items()
        },
        "depth": depth,
        "violation": by_case(cases, violation),
        "violation_mean": float(violation.mean()),
        "gate": gate,
        "gate_open": float(np.mean(violation > gate)),
    }


def by_case(cases: list[Case], values: np.ndarray) -> dict[str, float]:
    """{name: largest of its frames} of values (S,) of the interactions `cases`."""
    largest = values.reshape(len(cases), -1).max(axis=1).tolist()
    return dict(zip(map(name_of, cases), largest, strict=True))


def volumes(surface: tuple[np.ndarray, np.ndarray], answer: np.ndarray) -> np.ndarray:
    """(S,) mm3 within `surface`, see losses.deformed_volume, displaced by each field of `answer`,
    in batches: the faces of a few hundred fields fill the memory."""
    parts = [answer[i : i + 64] for i in range(0, len(answer), 64)]
    return np.concatenate([np.asarray(deformed_volume(part, *surface), float) for part in parts])


def run_facts(settings: Settings, dataset: Dataset) -> dict:
    """parameters; train and validation: relative L2; epochs, best_epoch, seconds (None where the
    history does not tell), seed;
    threshold of the volume loss, volume_scale: see losses.volume_scale, and train_gate_open,
    validation_gate_open: mean over the epochs of the share of samples beyond it."""
    model = load_model(settings.folder / "best.keras")
    facts = {
        "parameters": model.count_params(),
        "seed": settings.train.seed,
        "threshold": settings.loss.volume_threshold,
    }
    choice, seen = settings.loss, run_input(settings, dataset)
    for split in ("train", "validation"):
        samples = load_samples(dataset, split, settings.model.window, seen)
        if split == "train":
            facts["volume_scale"] = volume_scale(
                *volume_surface(dataset, choice.volume_of),
                choice.volume_weight,
                choice.volume_threshold,
                samples.displacement,
            )
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
