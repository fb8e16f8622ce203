"""The FEM at a fixed latency: so many time steps a frame, and the error that they leave, each
loop made as good as it can be (see unet_fem.study.measure.tuning)."""

from dataclasses import asdict

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.solver.frame_loop import LoopSettings
from fem.workers import on_all_cores
from unet_fem.study.dataset import Case, headline, name_of, named, study_dataset
from unet_fem.study.measure.loops import judge, loop_name
from unet_fem.study.measure.reference import references
from unet_fem.study.measure.statistics import errors
from unet_fem.study.measure.tuning import tuned, tuned_on
from unet_fem.study.settings import Study


def run(study: Study) -> dict:
    """{"points": [...], "tuned_on": validation numbers, "elements", "tries": see `tuned`}; a
    point is a loop and its errors.

    A point has its settings (see frame_loop.LoopSettings), cells, mass_scaling, damping_rate in
    1/s; usual and hard: see statistics.errors, over the interactions that it ended, against the
    reference; sums: {name: [error, truth] mm2} of these; stopped: [{"case", "reason", "time" s}]
    of the others.
    """
    dataset = study_dataset(study)
    cases = list(references(study, dataset))
    if not cases:
        raise InputError(
            "no test interaction has a reference: the FEM stopped in all of fem.interactions and"
            " the hard ones; lower contact.force in the scene"
        )
    found, elements, tries = tuned(study, dataset)
    verdicts = on_all_cores(
        judge,
        [(study, dataset, settings, case) for settings in found for case in cases],
        "FEM at fixed latency",
    )
    points = []
    for i, settings in enumerate(found):
        own = verdicts[i * len(cases) : (i + 1) * len(cases)]
        points.append(point(settings, dict(zip(cases, own, strict=True)), study, dataset))
    return {
        "points": points,
        "tuned_on": [number for _, number in tuned_on(study, dataset)],
        "elements": elements,
        "tries": tries,
    }


def point(
    settings: LoopSettings, verdicts: dict[Case, dict], study: Study, dataset: Dataset
) -> dict:
    """The point of a loop, from what `judge` says on each interaction."""
    sums = {name_of(case): found["sums"] for case, found in verdicts.items() if "sums" in found}
    stopped = [
        {"case": name_of(case), "reason": verdict["stopped"], "time": verdict["time"]}
        for case, verdict in verdicts.items()
        if "stopped" in verdict
    ]
    first = next(iter(verdicts.values()))
    return (
        {"name": loop_name(settings)}
        | asdict(settings)
        | {name: first[name] for name in ("cells", "mass_scaling", "damping_rate")}
        | errors(sums, named(headline(study, dataset)))
        | {"stopped": stopped, "sums": sums}
    )
