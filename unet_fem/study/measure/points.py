"""Error against run time: the points of every competitor, which of them no other beats, and what
they cost."""

from collections.abc import Iterable
from dataclasses import fields

import numpy as np

from fem.solver.frame_loop import LoopSettings
from unet_fem.study.dataset import SUBSETS
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import Answer, Study
from unet_fem.study.steppers import built

SHORTEST, LONGEST = 2e-5, 0.1  # s a frame: what a best choice is asked for
BUDGETS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # s a frame
ABOUT = (
    *("kind", "family", "run", "parent", "form"),
    *("interactions", "hard_in_training", "made"),
)
LOOP = [own.name for own in fields(LoopSettings)]


def points(results: dict, frame: float) -> list[dict]:
    """[{"name", "kind", "family", "run", "parent", "form", "seconds", "p99",
    "interactions", "hard_in_training", "made", "errors", "usual", "hard"}] of every competitor that
    was timed and judged, for frames of `frame` s.

    seconds: p50; made: see Competitor; errors: {"usual", "hard"} against the converged reference on
    the interactions of the headline, see statistics.errors; usual and hard: their relative_l2.
    interactions: learned from, with hard forces among them or not. A network or a regression
    answers a frame of any length in the same time; what is solved for the length of the frame is a
    competitor of its own for each.
    """
    seconds = results["run_time"]["seconds"]
    found = []
    for name, model in results["accuracy"]["models"].items():
        if model["frame"] is not None and not np.isclose(model["frame"], frame):
            continue
        if model.get("stopped"):
            continue  # as the FEM's loops: what answers the easy ones alone is no competitor
        about = {key: model[key] for key in ABOUT}
        for timed in (name, name.replace(": tf.function", ": Keras call")):  # of equal answers
            found.append({"name": timed} | about | {"errors": model["headline"]})
    for point in results["fixed_latency"]["points"]:
        if np.isclose(point["frame"], frame) and not point["stopped"]:
            family = "FEM, coarse" if point["coarse"] else f"FEM, {point['element']}"
            about = dict.fromkeys(ABOUT) | {"kind": "FEM", "family": family}
            about |= {"interactions": 0, "hard_in_training": False}
            about["made"] = [built("fem", LoopSettings(**{key: point[key] for key in LOOP}))]
            errors = {key: point[key] for key in ("usual", "hard")}
            found.append({"name": point["name"]} | about | {"errors": errors})
    for point in found:
        point |= {key: own["relative_l2"] for key, own in point["errors"].items()}
    timed = {point["name"]: point for point in found if point["name"] in seconds}
    return [
        point | {"seconds": seconds[name]["p50"], "p99": seconds[name].get("p99")}
        for name, point in timed.items()
    ]


def pareto(points: Iterable[dict], split: str) -> list[dict]:
    """The points that no other beats in both error and time, from the fastest to the most
    accurate."""
    front, best = [], np.inf
    for point in sorted(points, key=lambda p: (p["seconds"], p[split] or np.inf)):
        if point[split] is not None and point[split] < best:
            front.append(point)
            best = point[split]
    return front


def least_errors(found: list[dict]) -> list[dict]:
    """[{"budget": s, "usual", "hard": the point that errs least there in at most so much time, or
    None}] of points, see `points`."""
    rows = []
    for budget in BUDGETS:
        row: dict = {"budget": budget}
        for subset in SUBSETS:
            timely = [p for p in found if p["seconds"] <= budget and p[subset] is not None]
            row[subset] = min(timely, key=lambda p: p[subset], default=None)
        rows.append(row)
    return rows


def against_fem(study: Study, results: dict) -> list[dict]:
    """What the FEM does with the same error and in the same time as a learned competitor, and when
    that one's cost is earned back.

    Returns [{"frame": s, "own", "equal", "timely": see below, "data_s", "training_s", "hours"}] for
    each length of frame. own is a point, see `points`: of each main run the form that is fastest,
    of the regressions the fastest and the most accurate, and of study.answers those that learn and
    are shown or that no other beats. equal: the fastest FEM that errs no more than own on the usual
    interactions; timely: the most accurate FEM that takes no longer; None where there is none.
    data_s: of the simulations, training_s: None for a regression, whose fit takes seconds, and
    where it is not recorded. hours of simulated time after which own has saved, against equal, what
    both took; None where it saves nothing.
    """
    timed = results["run_time"]
    per, data = timed["interaction_s"], timed["simulated"] * timed["interaction_s"][""]
    rows = []
    for frame in study.fem.frames:
        every = points(results, frame)
        fem = [p for p in every if p["kind"] == "FEM"]
        best = {p["name"] for subset in SUBSETS for p in pareto(every, subset)}
        regressions = [p for p in every if p["kind"] == "regression"]
        chosen: list[tuple[dict, float, float | None]] = [
            (min(regressions, key=lambda p: p[key]), data, None) for key in ("seconds", "usual")
        ]
        for own, p in ((answer_of(study, p), p) for p in every if p["kind"] == "answer"):
            if own and own.interactions and (own.shown or p["name"] in best):
                simulations = (own.simulated or own.interactions) * per[own.scene]
                chosen.append((p, simulations, own.training))
        for run in (main.run for main in study.main):
            forms = sorted((p for p in every if p["run"] == run), key=lambda p: p["seconds"])
            training = results["accuracy"]["runs"][run]["seconds"] if forms else None
            chosen += [(own, data, training) for own in forms[:1]]
        rows += [_against(own, fem, seconds, spent, frame) for own, seconds, spent in chosen]
    return rows


def answer_of(study: Study, point: dict) -> Answer | None:
    """The one of study.answers that a point is of, None for others."""
    label = point["name"].split(" / ")[0]
    return next((own for own in study.answers if own.label == label), None)


def best_choices(study: Study, found: list[dict], subset: str) -> list[dict]:
    """[{"from", "to": s, "name", "family", "error", "made"}]: which point of `found` errs least in
    at most so much time, from SHORTEST to LONGEST; nothing before the first that is as fast. made:
    what a user gives to have it."""
    front = pareto(found, subset)
    ends = [p["seconds"] for p in front[1:]] + [LONGEST]
    return [
        {
            "from": max(p["seconds"], SHORTEST),
            "to": min(end, LONGEST),
            "name": p["name"],
            "family": p["family"],
            "error": p[subset],
            "made": list(p["made"]) or _trained(study, p),
        }
        for p, end in zip(front, ends, strict=True)
        if p["seconds"] <= LONGEST and end > SHORTEST
    ]


def _trained(study, point):
    """The commands that make a network, its exported form, or what pruning made of it."""
    folder = study.folder.parent
    own = next(n for n in study.networks if n.name == (point["parent"] or point["run"]))
    words = " ".join([own.config, *own.changes, f"name={own.name}"])
    commands = [f"python -m unet_fem.train {words}"]
    if point["parent"]:
        filters = " --filters" if "_thin" in point["run"] else ""
        return [*commands, f"python tools/prune.py {folder / point['parent']}{filters}"]
    exported = point["form"] != KERAS
    return commands + [f"python tools/quantize.py {folder / own.name}"] * exported


def _against(own, fem, data, training, frame):
    equal = min(
        (p for p in fem if p["usual"] <= own["usual"]), key=lambda p: p["seconds"], default=None
    )
    timely = min(
        (p for p in fem if p["seconds"] <= own["seconds"]), key=lambda p: p["usual"], default=None
    )
    saved = equal["seconds"] - own["seconds"] if equal else 0.0
    hours = (data + (training or 0.0)) / saved * frame / 3600 if saved > 0 else None
    return {
        "frame": frame,
        "own": own,
        "equal": equal,
        "timely": timely,
        "data_s": data,
        "training_s": training,
        "hours": hours,
    }
