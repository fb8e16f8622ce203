"""Error against run time: the points of every competitor, which of them no other beats, what they cost, and the figure."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FuncFormatter

from unet_fem import figures  # noqa: F401, its style

RATES = {"1 kHz": 1e-3, "100 Hz": 1e-2, "30 Hz": 1 / 30}  # s a frame
PAPER = {"U-Net": 22e-3, "CNN-LSTM": 32e-3, "FEM": 10e-3}  # s, the paper's latencies on its CPU
STYLES = {  # family: colour, marker
    "linear": ("black", "s"), "POD": ("dimgray", "P"), "POD + quadratic": ("tab:red", "p"), "U-Net": ("tab:blue", "o"), "CNN-LSTM": ("tab:orange", "^"),
    "FEM, full": ("tab:green", "D"), "FEM, reduced": ("tab:olive", "v"), "FEM, coarse": ("tab:cyan", "*"),
}  # fmt: skip
OTHER = ("tab:purple", "X")


def points(results, frame):
    """[{"name", "family", "seconds", "test", "hard"}] of every competitor that was timed and judged, for frames of `frame` s.

    Errors are relative L2 against the converged reference on the interactions of the headline. A network or a regression
    answers a frame of any length in the same time; the FEM's steps a frame make it a competitor of its own for each length.
    """
    seconds = results["run_time"]["seconds"]
    models = results["accuracy"]["models"]
    called = {name.replace(": tf.function", ": Keras call"): model for name, model in models.items() if name.endswith(": tf.function")}
    found = [
        {"name": name, "family": model["family"], "test": model["headline"]["test"], "hard": model["headline"]["hard"]}
        for name, model in (models | called).items()
        if name in seconds
    ]
    for point in results["fixed_latency"]["points"]:
        if np.isclose(point["frame"], frame) and not point["stopped"]:
            family = "FEM, coarse" if point["coarse"] else f"FEM, {point['element']}"
            found.append({"name": point["name"], "family": family, "test": point["test"], "hard": point["hard"]})
    return [point | {"seconds": seconds[point["name"]]["p50"]} for point in found]


def pareto(points, split):
    """The points that no other beats in both error and time, from the fastest to the most accurate."""
    front, best = [], np.inf
    for point in sorted(points, key=lambda p: (p["seconds"], p[split])):
        if point[split] < best:
            front.append(point)
            best = point[split]
    return front


def against_fem(study, results):
    """What the FEM does with the same error and in the same time as a learned competitor, and when that one's cost is earned back.

    Returns [{"frame": s, "own", "equal", "timely": see below, "training_s", "hours"}] for each length of frame. own is a point, see `points`:
    of each main run the form that is fastest, of the regressions the fastest and the most accurate. equal: the fastest FEM that errs no
    more than own on the test interactions; timely: the most accurate FEM that takes no longer; None where there is none. training_s: None
    for a regression and where it is not recorded. hours of simulated time after which own has saved, against equal, what data
    and training took; None where it saves nothing.
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
            chosen.append((min(forms, key=lambda p: p["seconds"]), results["accuracy"]["runs"][run]["seconds"]))
        for own, training in chosen:
            equal = min((p for p in fem if p["test"] <= own["test"]), key=lambda p: p["seconds"], default=None)
            timely = min((p for p in fem if p["seconds"] <= own["seconds"]), key=lambda p: p["test"], default=None)
            saved = equal["seconds"] - own["seconds"] if equal else 0.0
            hours = (data + (training or 0.0)) / saved * frame / 3600 if saved > 0 else None
            rows.append({"frame": frame, "own": own, "equal": equal, "timely": timely, "training_s": training, "hours": hours})
    return rows


def draw(study, results):
    """The headline figure: a column for each length of frame, a row for the test interactions and one for the hard ones."""
    figure, axes = plt.subplots(2, len(study.fem.frames), figsize=(6 * len(study.fem.frames), 9), sharex=True, sharey="row", squeeze=False, layout="constrained")
    own_error = results["reference"].get("refined", {}).get("relative_l2")
    for column, frame in enumerate(study.fem.frames):
        found = points(results, frame)
        for row, split in enumerate(("test", "hard")):
            _panel(axes[row, column], found, split, own_error)
        axes[0, column].set_title(f"a new force every {1e3 * frame:g} ms", pad=24)
        axes[1, column].set_xlabel("run time a frame (ms), one thread, p50")
    judged = set(results["reference"]["numbers"])
    for row, (name, numbers) in enumerate((("test", study.fem.interactions), ("hard", results["reference"]["hard_numbers"]))):
        axes[row, 0].set_ylabel(f"relative L2 error (%), {len(judged.intersection(numbers))} {name} interactions")
    shown = {label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels())}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=4)
    return figure


def _panel(axis, found, split, own_error):
    families = sorted({p["family"] for p in found}, key=lambda f: list(STYLES).index(f) if f in STYLES else len(STYLES))
    for family in families:
        colour, marker = STYLES.get(family, OTHER)
        mine = sorted((p for p in found if p["family"] == family), key=lambda p: p["seconds"])
        x, y = [1e3 * p["seconds"] for p in mine], [100 * p[split] for p in mine]
        axis.plot(x, y, marker, color=colour, label=family, markersize=5, alpha=0.8, linestyle="-" if "FEM" in family else "", linewidth=0.6)
    front = pareto(found, split)
    axis.step([1e3 * p["seconds"] for p in front], [100 * p[split] for p in front], where="post", color="crimson", linewidth=1.2, label="no other is better in both", zorder=0)
    axis.set(xscale="log", yscale="log", ylim=(None, 600 * max(p[split] for p in found)))  # room for the names above
    for name, seconds in RATES.items():
        axis.axvline(1e3 * seconds, color="gray", linestyle=":", linewidth=1)
        axis.annotate(name, (1e3 * seconds, 1), xycoords=("data", "axes fraction"), xytext=(0, 3), textcoords="offset points", ha="center", fontsize=7, color="gray")
    for name, seconds in PAPER.items():
        axis.plot(1e3 * seconds, 1, "v", color="crimson", transform=axis.get_xaxis_transform(), clip_on=False, markersize=5)
        axis.annotate(f"paper's {name}", (1e3 * seconds, 1), xycoords=("data", "axes fraction"), xytext=(2, -4), textcoords="offset points", fontsize=6, rotation=-90, va="top", color="crimson")
    if own_error:
        axis.axhspan(axis.get_ylim()[0], 100 * own_error, color="gray", alpha=0.12, label="below the reference's own distance to a refined mesh")
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
