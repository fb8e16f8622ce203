"""Error against run time: the points of every competitor, which of them no other beats, and what
they cost."""

import numpy as np

from unet_fem.training import figures  # noqa: F401, its style


def points(results, frame):
    """[{"name", "family", "seconds", "test", "hard"}] of every competitor that was timed and
    judged, for frames of `frame` s.

    Errors are relative L2 against the converged reference on the interactions of the headline. A
    network or a regression answers a frame of any length in the same time; the FEM's steps a frame
    make it a competitor of its own for each length.
    """
    seconds = results["run_time"]["seconds"]
    models = results["accuracy"]["models"]
    called = {
        name.replace(": tf.function", ": Keras call"): model
        for name, model in models.items()
        if name.endswith(": tf.function")
    }
    found = [
        {
            "name": name,
            "family": model["family"],
            "test": model["headline"]["test"],
            "hard": model["headline"]["hard"],
        }
        for name, model in (models | called).items()
        if name in seconds
    ]
    for point in results["fixed_latency"]["points"]:
        if np.isclose(point["frame"], frame) and not point["stopped"]:
            family = "FEM, coarse" if point["coarse"] else f"FEM, {point['element']}"
            found.append(
                {
                    "name": point["name"],
                    "family": family,
                    "test": point["test"],
                    "hard": point["hard"],
                }
            )
    return [point | {"seconds": seconds[point["name"]]["p50"]} for point in found]


def pareto(points, split):
    """The points that no other beats in both error and time, from the fastest to the most
    accurate."""
    front, best = [], np.inf
    for point in sorted(points, key=lambda p: (p["seconds"], p[split])):
        if point[split] < best:
            front.append(point)
            best = point[split]
    return front


def against_fem(study, results):
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
        fem = [p for p in every if p["family"].startswith("FEM")]
        regressions = [p for p in every if p["family"] in ("linear", "POD", "POD + quadratic")]
        chosen = [(min(regressions, key=lambda p: p[key]), None) for key in ("seconds", "test")]
        for run in (study.cnn_lstm, study.unet):
            forms = [p for p in every if p["name"].startswith(f"{run}: ")]
            chosen.append(
                (
                    min(forms, key=lambda p: p["seconds"]),
                    results["accuracy"]["runs"][run]["seconds"],
                )
            )
        for own, training in chosen:
            equal = min(
                (p for p in fem if p["test"] <= own["test"]),
                key=lambda p: p["seconds"],
                default=None,
            )
            timely = min(
                (p for p in fem if p["seconds"] <= own["seconds"]),
                key=lambda p: p["test"],
                default=None,
            )
            saved = equal["seconds"] - own["seconds"] if equal else 0.0
            hours = (data + (training or 0.0)) / saved * frame / 3600 if saved > 0 else None
            rows.append(
                {
                    "frame": frame,
                    "own": own,
                    "equal": equal,
                    "timely": timely,
                    "training_s": training,
                    "hours": hours,
                }
            )
    return rows
