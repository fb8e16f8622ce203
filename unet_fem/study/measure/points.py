"""Error against run time: the points of every competitor, which of them no other beats, and what
they cost."""

from collections.abc import Iterable

import numpy as np

from unet_fem.study.settings import Study


def points(results: dict, frame: float) -> list[dict]:
    """[{"name", "kind", "family", "run", "seconds", "test", "hard"}] of every competitor that was
    timed and judged, for frames of `frame` s.

    Errors are relative L2 against the converged reference on the interactions of the headline. A
    network or a regression answers a frame of any length in the same time; the FEM's steps a frame
    make it a competitor of its own for each length.
    """
    seconds = results["run_time"]["seconds"]
    found = []
    for name, model in results["accuracy"]["models"].items():
        about = {key: model[key] for key in ("kind", "family", "run")}
        for timed in (name, name.replace(": tf.function", ": Keras call")):  # of equal answers
            found.append({"name": timed} | about | model["headline"])
    for point in results["fixed_latency"]["points"]:
        if np.isclose(point["frame"], frame) and not point["stopped"]:
            family = "FEM, coarse" if point["coarse"] else f"FEM, {point['element']}"
            about = {"kind": "FEM", "family": family, "run": None}
            errors = {key: point[key] for key in ("test", "hard")}
            found.append({"name": point["name"]} | about | errors)
    timed = {point["name"]: point for point in found if point["name"] in seconds}
    return [point | {"seconds": seconds[name]["p50"]} for name, point in timed.items()]


def pareto(points: Iterable[dict], split: str) -> list[dict]:
    """The points that no other beats in both error and time, from the fastest to the most
    accurate."""
    front, best = [], np.inf
    for point in sorted(points, key=lambda p: (p["seconds"], p[split])):
        if point[split] < best:
            front.append(point)
            best = point[split]
    return front


def against_fem(study: Study, results: dict) -> list[dict]:
    """What the FEM does with the same error and in the same time as a learned competitor, and when
    that one's cost is earned back.

    Returns [{"frame": s, "own", "equal", "timely": see below, "training_s", "hours"}] for each
    length of frame. own is a point, see `points`: of each main run the form that is fastest, of the
    regressions the fastest and the most accurate. equal: the fastest FEM that errs no more than own
    on the test interactions; timely: the most accurate FEM that takes no longer; None where there
    is none. training_s: None for a regression and where it is not recorded. hours of simulated time
    after which own has saved, against equal, what data and training took; None where it saves
    nothing.
    """
    timed = results["run_time"]
    data = timed["data_frames"] * timed["data_frame_s"]
    rows = []
    for frame in study.fem.frames:
        every = points(results, frame)
        fem = [p for p in every if p["kind"] == "FEM"]
        regressions = [p for p in every if p["kind"] == "regression"]
        chosen = [(min(regressions, key=lambda p: p[key]), None) for key in ("seconds", "test")]
        for run in (main.run for main in study.main):
            forms = sorted((p for p in every if p["run"] == run), key=lambda p: p["seconds"])
            chosen += [(own, results["accuracy"]["runs"][run]["seconds"]) for own in forms[:1]]
        rows += [_against(own, fem, training, data, frame) for own, training in chosen]
    return rows


def _against(own, fem, training, data, frame):
    equal = min(
        (p for p in fem if p["test"] <= own["test"]), key=lambda p: p["seconds"], default=None
    )
    timely = min(
        (p for p in fem if p["seconds"] <= own["seconds"]), key=lambda p: p["test"], default=None
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
