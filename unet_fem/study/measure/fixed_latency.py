"""The FEM at a fixed latency: so many time steps a frame, and the error that they leave, each
loop made as good as it can be (see unet_fem.study.measure.tuning)."""

from dataclasses import asdict

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.solver.frame_loop import LoopSettings
from fem.workers import on_all_cores
from unet_fem.study.dataset import hard_numbers, study_dataset
from unet_fem.study.measure.loops import judge, loop_name
from unet_fem.study.measure.reference import references
from unet_fem.study.measure.sums import relative_l2
from unet_fem.study.measure.tuning import tuned, tuned_on
from unet_fem.study.settings import Study


def run(study: Study) -> dict:
    """{"points": [...], "numbers", "tuned_on": validation numbers, "elements": see `tuned`}; a
    point is a loop and its errors.

    A point has its settings (see frame_loop.LoopSettings), cells, mass_scaling, damping_rate in
    1/s; test and hard: relative L2 over the interactions that it ended, against the reference;
    sums: {"number": [error, truth] mm2} of these; stopped: [{"number", "reason", "time" s}] of the
    others.
    """
    dataset = study_dataset(study)
    numbers = list(references(study, dataset))
    if not numbers:
        raise InputError(
            "no test interaction has a reference: the FEM stopped in all of fem.interactions and"
            " the hard ones; lower contact.force in the scene"
        )
    found, elements = tuned(study, dataset)
    verdicts = on_all_cores(
        judge,
        [(study, dataset, settings, "test", number) for settings in found for number in numbers],
        "FEM at fixed latency",
    )
    points = []
    for i, settings in enumerate(found):
        own = verdicts[i * len(numbers) : (i + 1) * len(numbers)]
        points.append(point(settings, dict(zip(numbers, own, strict=True)), study, dataset))
    return {
        "points": points,
        "numbers": numbers,
        "tuned_on": tuned_on(study, dataset),
        "elements": elements,
    }


def point(
    settings: LoopSettings, verdicts: dict[int, dict], study: Study, dataset: Dataset
) -> dict:
    """The point of a loop, from what `judge` says on each interaction."""
    sums = {number: verdict["sums"] for number, verdict in verdicts.items() if "sums" in verdict}
    stopped = [
        {"number": number, "reason": verdict["stopped"], "time": verdict["time"]}
        for number, verdict in verdicts.items()
        if "stopped" in verdict
    ]
    first = next(iter(verdicts.values()))
    return (
        {"name": loop_name(settings)}
        | asdict(settings)
        | {name: first[name] for name in ("cells", "mass_scaling", "damping_rate")}
        | {
            "test": relative_l2(sums, study.fem.interactions),
            "hard": relative_l2(sums, hard_numbers(dataset)),
            "stopped": stopped,
            "sums": {str(number): pair for number, pair in sums.items()},
        }
    )
