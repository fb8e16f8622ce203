"""The paper's claims beside what was measured here, each with a verdict by rule."""

from unet_fem.study.report.numbers import options_tuple, percent
from unet_fem.study.runs import KERAS, smaller_runs
from unet_fem.study.settings import LINEAR, Study

EQUAL = 0.02  # of itself: an error that grows by no more counts as the same
FASTER = 1.3  # the paper's speed-up by pruning
REPRODUCED, PARTLY, NOT = "reproduced", "partly", "**not reproduced**"
KINDS = {"pruned": "zeros", "thin": "whole filters or units"}  # of pruning
Claim = tuple[str, str, str, str]


def claims(study: Study, results: dict, physics: list[dict]) -> list[Claim]:
    """[(claim, the paper's figure, found, verdict)] from the stages' results and
    statistics.physics."""
    accuracy, seconds = results["accuracy"], results["run_time"]["seconds"]
    first = study.main[0]
    return [
        *_orders(study, accuracy),
        _gate(accuracy["models"][f"{first.run}: {KERAS}"], accuracy["runs"][first.run]),
        *([_physics(physics)] if len(physics) > 1 else []),
        _depth(accuracy["models"][f"{first.run}: {KERAS}"], first.label),
        _configuration(study, accuracy["runs"]),
        *_forms(study, accuracy["models"]),
        *_latencies(study, seconds),
        *_pruning(study, accuracy["models"], seconds),
    ]


def _orders(study, accuracy):
    """Which network errs less than which, on all test interactions."""
    models = accuracy["models"]
    linear = [m for m in models.values() if m["kind"] == "regression" and m["family"] == "linear"]
    errors = {main.label: models[f"{main.run}: {KERAS}"]["test"] for main in study.main}
    errors[LINEAR] = min(linear, key=lambda model: model["frames"])["test"]
    rows = []
    for order in study.order:
        better, worse = errors[order.better], errors[order.worse]
        gain = 1 - better / worse
        of = order.worse if order.worse == LINEAR else f"the {order.worse}"
        by = f"{percent(abs(gain), 0)} % {'less' if gain > 0 else 'more'}"
        verdict = REPRODUCED if gain >= 0.8 * order.gain else PARTLY if gain > 0 else NOT
        rows.append(
            (
                f"{order.better} errs less than {of}",
                f"by {percent(order.gain, 0)} %",
                f"{percent(better)} against {percent(worse)} %, {by}",
                verdict,
            )
        )
    return rows


def _gate(model, facts):
    """Whether the volume term, at the threshold that the first main network was trained with, had
    anything to do."""
    opened = facts["train_gate_open"], model["gate_open"]
    return (
        f"Answers leave the volume band of {percent(model['gate'], 0)} %, so that the term acts",
        "implied",
        f"beyond it: {percent(opened[0], 2)} % of the training samples, {percent(opened[1], 2)} %"
        f" of the test frames; largest change {percent(max(model['violation']))} %",
        REPRODUCED if all(opened) else PARTLY if any(opened) else NOT,
    )


def _physics(physics):
    """The arm of the volume term whose hard interactions gain most."""
    plain = physics[0]
    best = min(physics[1:], key=lambda arm: arm["hard"]["relative_l2"])
    gain = 1 - best["hard"]["relative_l2"] / plain["hard"]["relative_l2"]
    low, high = best["hard_difference"]["low"], best["hard_difference"]["high"]
    clear = high is not None and high < 0
    return (
        "The volume term errs less on unseen high forces",
        "by 8-30 %",
        f"{percent(plain['hard']['relative_l2'])} % without,"
        f" {percent(best['hard']['relative_l2'])} % with ({best['label']}): difference"
        f" {percent(low)} to {percent(high)} points",
        (REPRODUCED if gain >= 0.08 else PARTLY) if clear else NOT,
    )


def _depth(model, label):
    errors = model["depth"]["mean_mm"]
    top, bottom = errors[0], errors[-1]
    grows = all(a >= b for a, b in zip(errors[:-1], errors[1:], strict=True))
    return (
        "The error grows towards the loaded surface",
        "yes",
        f"mean error {top:.4f} mm there, {bottom:.4f} mm in the deepest free layer ({label})",
        REPRODUCED if grows else PARTLY if top > bottom else NOT,
    )


def _configuration(study, runs):
    own = study.main[0].run
    found = [run for run in study.configurations if run in runs]
    best = min(found or [own], key=lambda run: runs[run]["validation"])
    return (
        f"Of the configurations {options_tuple(study.network(own).model)} is the best",
        "yes",
        f"least on validation: {best}, {percent(runs[best]['validation'])} %;"
        f" this one: {percent(runs[own]['validation'])} %",
        REPRODUCED if best == own else NOT,
    )


def _forms(study, models):
    rows = []
    for form, says in (("float16", "harmless"), ("int8", "harmful")):
        changes = [
            models[f"{main.run}: {form}"]["test"] / models[f"{main.run}: {KERAS}"]["test"] - 1
            for main in study.main
            if f"{main.run}: {form}" in models
        ]
        if changes:
            found = f"error changes by at most {100 * max(changes):+.1f} % of itself"
            agrees = (max(changes) <= EQUAL) == (says == "harmless")
            rows.append((f"{form} is {says}", says, found, REPRODUCED if agrees else NOT))
    return rows


def _latencies(study, seconds):
    """Of the main networks, in the order in which the study gives the paper's latencies."""
    runs = {main.label: main.run for main in study.main}
    rows = []
    for label, paper in study.paper_latency.items():
        forms = [f for f in seconds if label in runs and f.startswith(f"{runs[label]}: ")]
        if not forms:
            continue
        fastest = min(forms, key=lambda form: seconds[form]["p50"])
        time, graph = seconds[fastest]["p50"], seconds[f"{runs[label]}: {KERAS}"]["p50"]
        rows.append(
            (
                f"Latency of the {label} on a CPU",
                f"{1e3 * paper:.0f} ms",
                f"{1e3 * graph:.1f} ms as {KERAS}, {1e3 * time:.2f} ms as {fastest.split(': ')[1]}",
                "faster here" if time < paper else "slower here",
            )
        )
    return rows


def _pruning(study, models, seconds):
    """Of the first share that was removed."""
    labels = {main.run: main.label for main in study.main}
    made = {(run.parent, run.how): run for run in smaller_runs(study)[::-1]}  # the first stays
    rows = []
    for parent, label in labels.items():
        for how, text in KINDS.items():
            run = made.get((parent, how))
            base = f"{parent}: float32"
            name = run and f"{run.name}: float32"
            if not all(key in models and key in seconds for key in (name, base)):
                continue
            faster = seconds[base]["p50"] / seconds[name]["p50"]
            worse = models[name]["test"] / models[base]["test"] - 1
            good = faster >= FASTER and worse <= EQUAL
            rows.append(
                (
                    f"{100 * run.share:.0f} % pruned by {text}: {label}",
                    f"{FASTER:g}x at equal error",
                    f"{faster:.2f}x faster, error {100 * worse:+.1f} % of itself",
                    REPRODUCED if good else PARTLY if faster >= FASTER else NOT,
                )
            )
    return rows
