"""Settings of the FEM loops: damping, the rise of the load within a frame and the hourglass
stiffness are chosen on validation interactions alone, within the study's budget of tries."""

import itertools
import math
from dataclasses import replace

from fem.data.dataset import Dataset
from fem.errors import InputError
from fem.solver.frame_loop import LoopSettings, longest_step
from fem.workers import on_all_cores
from unet_fem.study.dataset import Case, name_of
from unet_fem.study.measure.loops import judge, loop_name
from unet_fem.study.measure.reference import references
from unet_fem.study.measure.sums import relative_l2
from unet_fem.study.settings import Study

DAMPINGS = (0.0125, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8)
RISES = (0.0, 0.25, 0.5, 1.0)
HOURGLASS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
TUNED_ON = 2  # validation interactions
HELPS = 0.98  # of an error: more steps must take it at least so far down


def tuned(study: Study, dataset: Dataset) -> tuple[list[LoopSettings], dict, dict[str, int]]:
    """([LoopSettings], {element: {hourglass stiffness: relative L2 on validation, None if one
    stopped}}, {loop: settings tried}): every element, frame and number of steps."""
    tuned_on(study, dataset)
    elements, errors = _elements(study, dataset)
    chains = on_all_cores(
        _chain,
        [(study, dataset, element, frame) for element in elements for frame in study.fem.frames],
        "FEM at fixed latency, tuning",
    )
    found = list(itertools.chain(*chains))
    loops = [settings for settings, _ in found]
    return loops, errors, {loop_name(settings): tries for settings, tries in found}


def tuned_on(study: Study, dataset: Dataset) -> list[Case]:
    """The first validation interactions that have a reference; it is made where it is missing."""
    first = dataset.number[dataset.split == "validation"][:TUNED_ON].tolist()
    cases = list(references(study, dataset, [("validation", number) for number in first]))
    if not cases:
        raise InputError(
            "the FEM stopped in the first validation interactions, on which its competitors are"
            " tuned; lower contact.force in the scene"
        )
    return cases


def score(study: Study, dataset: Dataset, settings: LoopSettings) -> float:
    """Relative L2 over the validation interactions, inf if one stops."""
    cases = tuned_on(study, dataset)
    verdicts = {name_of(case): judge(study, dataset, settings, case) for case in cases}
    if any("stopped" in verdict for verdict in verdicts.values()):
        return math.inf
    error = relative_l2({name: own["sums"] for name, own in verdicts.items()}, verdicts)
    return math.inf if error is None else error


def _elements(study, dataset):
    """([LoopSettings], errors): the full and reduced element, and the better of both on the coarse
    mesh, by their error where steps are plenty."""
    plenty = {
        "frame": max(study.fem.frames),
        "steps": max(study.fem.steps),
        "damping": 0.4,
        "rise": 0.5,
    }
    curved = dataset.scene.mesh.kind == "file"
    meshes = (False,) if curved else (False, True)  # a curved mesh has no coarse one here
    choices = [LoopSettings("full", coarse, **plenty) for coarse in meshes]
    choices += [
        LoopSettings("reduced", coarse, hourglass_stiffness=h, **plenty)
        for coarse in meshes
        for h in HOURGLASS
    ]
    tasks = [(study, dataset, choice) for choice in choices]
    scores = on_all_cores(score, tasks, "FEM at fixed latency, elements")
    errors = dict(zip(choices, scores, strict=True))
    groups = [
        [c for c in choices if not c.coarse and c.element == element]
        for element in ("full", "reduced")
    ]
    groups += [[c for c in choices if c.coarse]] * (len(meshes) - 1)
    table = {}
    for choice, error in errors.items():
        row = table.setdefault(f"{choice.element}{', coarse' if choice.coarse else ''}", {})
        stiffness = f"{choice.hourglass_stiffness:g}" if choice.element == "reduced" else "-"
        row[stiffness] = error if math.isfinite(error) else None
    return [min(group, key=errors.get) for group in groups], table


def _chain(study, dataset, element, frame):
    """[(loop, settings tried for it)] of one element and frame, from few steps to the first number
    that needs hardly any mass scaling or errs no less: more of them would only cost."""
    spent = len(HOURGLASS) if element.element == "reduced" else 1  # for the element, see _elements
    found, start = [], replace(element, frame=frame, damping=0.1, rise=0.5)
    least = math.inf
    longest = longest_step(dataset.fem_mesh, dataset.material, element)
    for steps in sorted(study.fem.steps):
        start = replace(start, steps=steps)
        if frame / steps <= 1.1 * longest:
            # what damps the steps before damps these: with the true mass the answer hardly depends
            # on it
            return [*found, (start, spent)]
        start, tried = _walk(study, dataset, start, study.tries - spent)
        found.append((start, spent + tried))
        error = score(study, dataset, start)
        if not error < HELPS * least:
            break
        least = error
    return found


def _walk(study, dataset, best, tries):
    """(`best` with the damping and the rise that err least, settings tried), by steps to the
    neighbouring value of either while that helps and no more than `tries` have been judged."""
    known = {best: score(study, dataset, best)}
    least, moved = known[best], True
    while moved:
        moved = False
        for (name, values), way in itertools.product(
            (("damping", DAMPINGS), ("rise", RISES)), (1, -1)
        ):
            while 0 <= (place := values.index(getattr(best, name)) + way) < len(values):
                other = replace(best, **{name: values[place]})
                if other not in known:
                    if len(known) >= tries:
                        return best, len(known)
                    known[other] = score(study, dataset, other)
                if not known[other] < 0.99 * least:
                    break
                best, least, moved = other, known[other], True
    return best, len(known)
