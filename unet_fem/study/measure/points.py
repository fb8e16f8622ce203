"""Error against run time: the points of every competitor, which of them no other beats, and what
they cost."""

from collections.abc import Iterable

import numpy as np

from unet_fem.study.dataset import SUBSETS
from unet_fem.study.settings import Study

BUDGETS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # s a frame
ABOUT = ("kind", "family", "run", "interactions", "hard_in_training")


def points(results: dict, frame: float) -> list[dict]:
    """[{"name", "kind", "family", "run", "seconds", "interactions", "hard_in_training", "errors",
    "usual", "hard"}] of every competitor that was timed and judged, for frames of `frame` s.

    errors: {"usual", "hard"} against the converged reference on the interactions of the headline,
    see statistics.errors; usual and hard: their relative_l2. interactions: learned from, with hard
    forces among them or not. A network or a regression answers a frame of any length in the same
    time; what is solved for the length of the frame is a competitor of its own for each.
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
            about = {"kind": "FEM", "family": family, "run": None}
            about |= {"interactions": 0, "hard_in_training": False}
            errors = {key: point[key] for key in ("usual", "hard")}
            found.append({"name": point["name"]} | about | {"errors": errors})
    for point in found:
        point |= {key: own["relative_l2"] for key, own in point["errors"].items()}
    timed = {point["name"]: point for point in found if point["name"] in seconds}
    return [point | {"seconds": seconds[name]["p50"]} for name, point in timed.items()]


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

    Returns [{"frame": s, "own", "equal", "timely": see below, "training_s", "hours"}] for each
    length of frame. own is a point, see `points`: of each main run the form that is fastest, of the
    regressions the fastest and the most accurate, and every one of study.answers. equal: the
    fastest FEM that errs no more than own on the usual interactions; timely: the most accurate FEM
    that takes no longer; None where there is none. training_s: None for a regression and where it
    is not recorded. hours of simulated time after which own has saved, against equal, what data and
    training took; None where it saves nothing. What study.answers have cost is not known: no hours.
    """
    timed = results["run_time"]
    data = timed["data_frames"] * timed["data_frame_s"]
    rows = []
    for frame in study.fem.frames:
        every = points(results, frame)
        fem = [p for p in every if p["kind"] == "FEM"]
        regressions = [p for p in every if p["kind"] == "regression"]
        chosen = [(min(regressions, key=lambda p: p[key]), None) for key in ("seconds", "usual")]
        chosen += [(own, None) for own in every if own["kind"] == "answer"]
        for run in (main.run for main in study.main):
            forms = sorted((p for p in every if p["run"] == run), key=lambda p: p["seconds"])
            chosen += [(own, results["accuracy"]["runs"][run]["seconds"]) for own in forms[:1]]
        rows += [_against(own, fem, training, data, frame) for own, training in chosen]
    return rows


def _against(own, fem, training, data, frame):
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
        "training_s": training,
        "hours": hours,
    }
