"""The paper's statements beside what was measured here, each with a verdict by rule.

A statement is judged only where the study's settings quote it. "Not tested" is what no run here can
answer: a network that is not trained, one seed where seeds differ, a volume term whose gate never
opened.
"""

from collections.abc import Callable

import numpy as np

from unet_fem.study.measure.points import points
from unet_fem.study.measure.statistics import difference, sums
from unet_fem.study.report.numbers import difference as points_of
from unet_fem.study.report.numbers import options_tuple, percent
from unet_fem.study.runs import KERAS, smaller_runs
from unet_fem.study.settings import LINEAR, Order, Study

SEEDS = 3  # fewer say nothing about the order of networks
SHARE = 0.8  # of the paper's gain that counts as the same
EQUAL = 0.02  # of itself: an error that grows by no more counts as the same
FASTER = 1.3  # the paper's speed-up by pruning
GAIN = 0.08  # the least gain that the paper gives for the volume term
GOOD = 0.10  # relative L2 up to which a FEM loop counts as an answer
REPRODUCED, NOT, UNTESTED = "reproduced", "**not reproduced**", "not tested"
Claim = tuple[str, str, str]


def verdict(tested: bool, holds: bool) -> str:
    """The one rule."""
    return UNTESTED if not tested else REPRODUCED if holds else NOT


def claims(study: Study, results: dict, physics: list[dict]) -> list[Claim]:
    """[(the paper's statement, found, verdict)] from the stages' results and statistics.physics."""
    found = [_order(study, results["accuracy"], order) for order in study.order]
    rules: dict[str, Callable[[], list[tuple[str, str]]]] = {
        "volume": lambda: [_volume(physics)],
        "units": lambda: [_units(study, results)],
        "steps": lambda: [_steps(study, results)],
        "float16": lambda: [_form(study, results, "float16", harmless=True)],
        "int8": lambda: [_form(study, results, "int8", harmless=False)],
        "pruning": lambda: _pruning(study, results),
        "latency": lambda: _latencies(study, results),
        "fem": lambda: [_fem(study, results)],
    }
    for name, says in study.claims.items():
        found += [(says, *row) for row in rules[name]()]
    return found


def _order(study: Study, accuracy: dict, order: Order) -> Claim:
    """Which errs less than which, on the usual unseen interactions."""
    names = {label: _seeds(study, accuracy, label) for label in (order.better, order.worse)}
    tested = all(len(own) >= (1 if label == LINEAR else SEEDS) for label, own in names.items())
    if not all(names.values()):
        return order.says, "not trained yet", UNTESTED
    cases = accuracy["subsets"]["usual"]
    (better, truth), (worse, _) = (sums(accuracy, own, cases) for own in names.values())
    found = difference(better, worse, truth)
    gain, clear = -found["change"], found["high"] is not None and found["high"] < 0
    errors = [np.mean(np.sqrt(own.sum(axis=1) / truth.sum())) for own in (better, worse)]
    return (
        order.says,
        f"usual unseen interactions: {percent(errors[0])} against {percent(errors[1])} %,"
        f" difference {points_of(found)} points; seeds {_counts(names)}",
        verdict(tested, clear and gain >= SHARE * order.gain),
    )


def _seeds(study, accuracy, label):
    """Names in the accuracy stage of all seeds of a main network, or the linear regression."""
    models = accuracy["models"]
    if label == LINEAR:
        linear = {n: m for n, m in models.items() if m["family"] == "linear"}
        return sorted(linear, key=lambda name: linear[name]["frames"])[:1]
    run = next(main.run for main in study.main if main.label == label)
    names = [f"{own}: {KERAS}" for own in study.replicas(run)]
    return [name for name in names if name in models]


def _counts(names):
    return " and ".join(str(len(own)) for own in names.values())


def _volume(physics):
    """The arm of the volume term whose gate opened in training and whose hard interactions gain
    most."""
    opened = [arm for arm in physics[1:] if arm["train_gate_open"]]
    if not opened:
        return f"no gate opened in training ({len(physics[1:])} arms)", UNTESTED
    plain = physics[0]
    best = min(opened, key=lambda arm: arm["hard"]["relative_l2"])
    gain = 1 - best["hard"]["relative_l2"] / plain["hard"]["relative_l2"]
    change = best["hard_difference"]
    clear = change["high"] is not None and change["high"] < 0
    enough = min(len(best["runs"]), len(plain["runs"])) >= SEEDS
    return (
        f"hard interactions: {percent(plain['hard']['relative_l2'])} % without,"
        f" {percent(best['hard']['relative_l2'])} % with ({best['label']}, open for"
        f" {percent(best['train_gate_open'], 2)} % of the training samples), difference"
        f" {points_of(change)} points; seeds {len(plain['runs'])} and {len(best['runs'])}",
        verdict(enough, clear and gain >= GAIN),
    )


def _varied(study, accuracy, name):
    """({value of the option `name`: run}, {value: validation errors of its seeds}) of the
    configurations that differ from the first main run in this option alone."""
    own = study.network(study.main[0].run).model.own()
    options = {run: study.network(run).model.own() for run in study.configurations}
    runs = {other[name]: run for run, other in options.items() if {**other, name: own[name]} == own}
    errors = {}
    for value, run in sorted(runs.items()):
        seeds = [seed for seed in study.replicas(run) if seed in accuracy["runs"]]
        errors[value] = [accuracy["runs"][seed]["validation"] for seed in seeds]
    return runs, errors


def _units(study, results):
    """More units err less up to the paper's choice, and not beyond."""
    _, errors = _varied(study, results["accuracy"], "units")
    chosen = study.network(study.main[0].run).model.own()["units"]
    means = {units: float(np.mean(own)) for units, own in errors.items() if own}
    up, beyond = ([u for u in means if (u > chosen) == more] for more in (False, True))
    falls = all(means[a] > means[b] for a, b in zip(up[:-1], up[1:], strict=True))
    holds = falls and all(means[u] >= means[chosen] for u in beyond)
    tested = bool(up[:-1] and beyond) and all(len(own) >= SEEDS for own in errors.values())
    return _listed(means, errors, "units"), verdict(tested, holds)


def _steps(study, results):
    """A longer window errs less, and takes longer."""
    runs, errors = _varied(study, results["accuracy"], "steps")
    seconds = results["run_time"]["seconds"]
    names = {steps: f"{run}: {KERAS}" for steps, run in runs.items()}
    times = {steps: seconds[name]["p50"] for steps, name in names.items() if name in seconds}
    means = {steps: float(np.mean(own)) for steps, own in errors.items() if own}
    pairs = list(zip(list(means)[:-1], list(means)[1:], strict=True))
    holds = all(means[a] > means[b] for a, b in pairs)
    holds &= all(times[a] < times[b] for a, b in pairs if a in times and b in times)
    tested = len(means) > 1 and all(len(own) >= SEEDS for own in errors.values())
    return _listed(means, errors, "steps"), verdict(tested, holds)


def _listed(means, errors, name):
    if not means:
        return "not trained yet"
    parts = ", ".join(f"{percent(error)} % ({value})" for value, error in means.items())
    seeds = ", ".join(str(len(errors[value])) for value in means)
    return f"validation by {name}: {parts}; seeds {seeds}"


def _form(study, results, form, harmless):
    """Whether a form of the main networks errs no more than Keras, on the usual interactions."""
    models = results["accuracy"]["models"]
    pairs = [(f"{main.run}: {form}", f"{main.run}: {KERAS}") for main in study.main]
    changes = [
        models[own]["usual"]["relative_l2"] / models[keras]["usual"]["relative_l2"] - 1
        for own, keras in pairs
        if own in models and keras in models
    ]
    if not changes:
        return "not exported yet", UNTESTED
    found = f"the error changes by at most {100 * max(changes):+.1f} % of itself"
    return found, verdict(True, (max(changes) <= EQUAL) == harmless)


def _latencies(study, results):
    """Of the main networks, in the order in which the study gives the paper's latencies."""
    seconds, runs = results["run_time"]["seconds"], {main.label: main.run for main in study.main}
    rows = []
    for label, paper in study.paper_latency.items():
        graph = f"{runs.get(label)}: {KERAS}"
        if graph in seconds:
            own = seconds[graph]["p50"]
            found = f"{label}: {1e3 * own:.1f} ms as {KERAS}, one thread of another processor"
            rows.append((found, verdict(True, own <= paper)))
    return rows or [("not trained yet", UNTESTED)]


def _fem(study, results):
    """Whether no loop of the FEM answers within its frame with a usable error."""
    frame = min(study.fem.frames)
    loops = {point["name"] for point in results["fixed_latency"]["points"]}
    timely = [
        point
        for point in points(results, frame)
        if point["name"] in loops and point["seconds"] <= frame and point["usual"] <= GOOD
    ]
    if not timely:
        return f"none answers within {1e3 * frame:g} ms to {percent(GOOD, 0)} %", verdict(
            True, True
        )
    best = min(timely, key=lambda point: point["seconds"])
    return (
        f"{best['name']}: {1e3 * best['seconds']:.2f} ms, {percent(best['usual'])} % on the usual"
        " interactions",
        verdict(True, False),
    )


def _pruning(study, results):
    """By zeros, of the first share that was removed."""
    models, seconds = results["accuracy"]["models"], results["run_time"]["seconds"]
    rows = []
    for main in study.main:
        made = [r for r in smaller_runs(study) if (r.parent, r.how) == (main.run, "pruned")]
        base, name = f"{main.run}: float32", f"{made[0].name}: float32" if made else ""
        if not all(key in models and key in seconds for key in (name, base)):
            continue
        faster = seconds[base]["p50"] / seconds[name]["p50"]
        worse = models[name]["usual"]["relative_l2"] / models[base]["usual"]["relative_l2"] - 1
        found = (
            f"{main.label} {options_tuple(study.network(main.run).model)}, {made[0].label}:"
            f" {faster:.2f}x faster, error {100 * worse:+.1f} % of itself"
        )
        rows.append((found, verdict(True, faster >= FASTER and worse <= EQUAL)))
    return rows or [("not pruned yet", UNTESTED)]
