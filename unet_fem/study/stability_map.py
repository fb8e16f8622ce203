"""Stability beside accuracy: under which multiple of the usual forces, and until when, does each competitor stay close to the FEM?

The contacts of test interactions push with their forces times each factor. The dataset's own solver gives the truth, as far as it
goes; a competitor holds where its relative L2 error is within TOLERANCE and its volume within the paper's band.
"""

import hashlib
from dataclasses import replace

import numpy as np

from fem.contact import Load, Surface
from fem.energy import EnergyLedger
from fem.errors import SolverStopped
from fem.generate import save_arrays
from fem.interaction import contacts_of
from unet_fem.study.fixed_latency import frame_forces, frames_between, tuned
from unet_fem.study.frame_loop import FrameLoop
from unet_fem.study.parallel import on_all_cores
from unet_fem.study.reference import study_dataset

TOLERANCE = 0.10  # relative L2


def run(study):
    """How far every competitor is from the truth, over force factor and time.

    Returns {"factors", "time": s, "interactions": numbers, "tolerance", "band", "alive": interactions that the truth reaches this
    frame in, "flag": share of all interactions whose force leaves the training range, "stops": [{"what", "number", "factor",
    "after": s, "reason"}], "competitors": {name: {"relative_l2", "volume", "stopped"}}}. Tables are lists [factors][frames] over
    the interactions that are alive: relative_l2, None where none moves or where a run of the competitor has stopped; volume, the
    largest |V / V_rest - 1| (also of "truth"), None where none is alive; stopped, runs of the competitor that have.
    """
    from unet_fem.losses import deformed_volume
    from unet_fem.runtime import VOLUME_BAND, force_size

    dataset = study_dataset(study)
    parts, networks = simulated(study, dataset, real_time(study, dataset)), network_functions(study, dataset)
    largest, rest = force_size(dataset.read("train")["force"]), dataset.mesh.volume()
    factors = list(study.stability.factors)
    shape = len(factors), len(dataset.time)
    alive, flag, size = np.zeros(shape, int), np.zeros(shape), np.zeros(shape)
    squared, volume, stopped, stops = {}, {}, {}, []
    for (number, factor), (force, answers, reasons) in parts:
        print(f"judging interaction {number}, forces x {factor:g}", flush=True)
        row = factors.index(factor)
        truth = answers["truth"][:, dataset.free].astype(float)
        here = len(truth)  # frames that the truth reaches
        alive[row, :here] += 1
        size[row, :here] += np.square(truth).sum(axis=(1, 2))
        flag[row] += [np.any(np.array(force_size(field)) > 1.00001 * np.array(largest)) for field in force]
        stops += [
            {"what": name, "number": number, "factor": factor, "after": float(dataset.time[len(answers[name]) - 1]), "reason": reason}
            for name, reason in reasons.items() if reason
        ]  # fmt: skip
        for name, answer in (answers | {name: network(force) for name, network in networks.items()}).items():
            answer = answer[:here]  # what comes after the truth has stopped cannot be judged
            tables = [store.setdefault(name, np.zeros(shape)) for store in (squared, volume, stopped)]
            reached = len(answer)
            tables[0][row, :reached] += np.square(answer[:, dataset.free] - truth[:reached]).sum(axis=(1, 2))
            change = np.abs(np.asarray(deformed_volume(answer, *dataset.surface), float) / rest - 1)
            tables[1][row, :reached] = np.maximum(tables[1][row, :reached], change)
            tables[2][row, reached:here] += 1
    competitors = {
        name: {
            "relative_l2": table(np.sqrt(squared[name] / np.where(size > 0, size, 1)), (size > 0) & (stopped[name] == 0)),
            "volume": table(volume[name], (alive > 0) & (stopped[name] == 0)),
            "stopped": stopped[name].astype(int).tolist(),
        }
        for name in squared
    }
    return {
        "factors": factors, "time": dataset.time.tolist(), "interactions": list(study.stability.interactions), "tolerance": TOLERANCE,
        "band": VOLUME_BAND, "alive": alive.tolist(), "flag": (flag / len(study.stability.interactions)).tolist(), "stops": stops,
        "competitors": competitors,
    }  # fmt: skip


def real_time(study, dataset):
    """The Competitor that stands for the FEM in real time: of the tuned loops of full elements at the shortest frame, that of fewest steps."""
    found = [c for c in tuned(study, dataset)[0] if c.element == "full" and not c.coarse and c.frame == min(study.fem.frames)]
    return min(found, key=lambda c: c.steps)


def table(values, known):
    return np.where(known, values, None).tolist()


def simulated(study, dataset, loop):
    """The FEM's answers: an iterator of ((number, factor), (force, {name: field}, {name: why it stopped, or ""})).

    force and fields (frames, nx, ny, nz, 3) in mN and mm; a field ends before the frame that its run did not reach. loop: the
    Competitor that is the FEM in real time. Computed in parallel where they are missing, and kept in the study's folder.
    """
    which = [(number, factor) for number in study.stability.interactions for factor in study.stability.factors]
    key = hashlib.sha256(repr(loop).encode()).hexdigest()[:8]
    places = {}
    for kind in ("offline", f"loop-{key}"):
        places[kind] = [study.folder / "stability" / f"{dataset.scene.digest()}-{kind}-{n:04d}-x{factor:g}.npz" for n, factor in which]
    for (kind, paths), function, settings in zip(places.items(), (simulate_offline, simulate_loop), ((), (loop,))):
        missing = [(dataset, *pair, *settings, path) for pair, path in zip(which, paths) if not path.is_file()]
        if missing:
            on_all_cores(function, missing, f"multiplied forces, {kind}")
    for (number, factor), *paths in zip(which, *places.values()):
        answers, reasons = {}, {}
        for path in paths:
            with np.load(path) as file:
                for name in file.files:
                    kind, _, stopped = name.partition(":")
                    (reasons if stopped else answers)[kind] = str(file[name]) if stopped else file[name]
        yield (number, factor), (factor * force_of(dataset, number), answers, reasons)


def force_of(dataset, number):
    """(frames, nx, ny, nz, 3) mN: the forces of a test interaction on the grid."""
    own = dataset.sequence("test", number)
    return dataset.on_grid(own.force, own.displacement)[0]


def simulate_offline(dataset, number, factor, path):
    """Write test interaction `number` at `factor` times its forces to `path`, by the dataset's solver under its rules of health.

    The answers: "truth", and "elastic FEM", the same without Prony terms.
    """
    scene, mesh, times = dataset.scene, dataset.fem_mesh, dataset.time
    force = dataset.sequence("test", number).force
    load = Load(Surface(mesh), [replace(contact, peak=factor * contact.peak) for contact in contacts_of(dataset, "test", number)])

    def stepper(scene):
        solver, ledger = scene.build_solver(mesh), EnergyLedger()

        def step(frame):
            solver.advance(times[frame] - solver.time, load, [ledger])
            if ledger.smallest_J < scene.health.min_J:
                raise SolverStopped("crushed cell", f"a cell is crushed to J = {ledger.smallest_J:.3g}")
            return dataset.on_grid(force[frame], (solver.u.T * 1e3).astype(np.float32))[1]

        return step

    elastic = replace(scene, material=replace(scene.material, prony=()))
    save_frames(path, {"truth": stepper(scene), "elastic FEM": stepper(elastic)}, dataset)


def simulate_loop(dataset, number, factor, competitor, path):
    """Write the same by the FEM in real time, which takes its few steps for the force that comes every frame of its own."""
    loop, forces = FrameLoop(dataset, competitor), factor * frame_forces(dataset, "test", number, competitor.frame)
    calls = frames_between(dataset.scene, competitor.frame)

    def step(frame):
        for force in forces[(frame - 1) * calls : frame * calls]:
            answer = loop(force)
        return answer

    save_frames(path, {competitor.name: step}, dataset)


def save_frames(path, steps, dataset):
    """Write what `frames` makes of {name: step} to `path`."""
    arrays = {}
    for name, step in steps.items():
        arrays[name], arrays[f"{name}:stopped"] = frames(step, (len(dataset.time), *dataset.grid, 3))
    save_arrays(path, **arrays)


def frames(step, shape):
    """(fields (frames reached, nx, ny, nz, 3), reason or ""): step(frame) from rest, until it stops or gives no finite field.

    shape: of all frames.
    """
    fields = [np.zeros(shape[1:], np.float32)]
    for frame in range(1, shape[0]):
        try:
            field = step(frame)
        except SolverStopped as stop:
            return np.array(fields), stop.reason
        if not np.isfinite(field).all():
            return np.array(fields), "not finite"
        fields.append(field)
    return np.array(fields), ""


def network_functions(study, dataset):
    """{name: force (frames, nx, ny, nz, 3) mN -> displacement of the same shape, mm}: the deployed networks and linear regression."""
    from unet_fem.checkpoint import load_model
    from unet_fem.data import windows
    from unet_fem.stream import answers as lite_answers

    def whole(path, steps):
        model = load_model(path)
        return lambda force: np.asarray(model(windows(force[None], steps)))

    functions = {}
    for name, run in (("CNN-LSTM", study.cnn_lstm), ("U-Net", study.unet)):
        settings = study.network(run)
        if not functions:
            functions["linear regression"] = whole(settings.folder / "linear.keras", settings.model.window)
        functions[name] = whole(settings.folder / "best.keras", settings.model.window)
        if (lite := settings.folder / "lite/int8.tflite").is_file():
            functions[f"{name}, int8"] = lambda force, path=lite: lite_answers(path, force[None])
    return functions


def draw(result):
    """A panel for each competitor: colour is the error over time and force factor.

    A black line bounds what is within the tolerance, hatching marks volume out of its band, a dashed line forces beyond the
    training range. Grey: the truth has stopped in half of the interactions or more; black: the competitor has in one.
    """
    from matplotlib.colors import ListedColormap, LogNorm
    from matplotlib.patches import Patch, Rectangle

    from unet_fem.figures import plt

    factors, time = result["factors"], np.array(result["time"])[1:]  # nothing has moved in the first frame
    edges = np.append(time - np.diff(time, prepend=0.0) / 2, time[-1] + (time[-1] - time[-2]) / 2 if len(time) > 1 else 1.5 * time[-1])
    rows, flag, alive = np.arange(len(factors) + 1) - 0.5, np.array(result["flag"])[:, 1:], np.array(result["alive"])[:, 1:]
    known = alive > len(result["interactions"]) / 2
    names = [name for name in result["competitors"] if name != "truth"]
    columns = min(4, len(names))
    lines = -(-(len(names) + 1) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(3.2 * columns, 2.9 * lines), sharex=True, sharey=True, squeeze=False, layout="constrained")
    for axis, name in zip(axes.flat, names):
        found = result["competitors"][name]
        error, volume = (np.array(found[key], float)[:, 1:] for key in ("relative_l2", "volume"))
        axis.pcolormesh(edges, rows, np.ma.array(np.ones(known.shape), mask=known), cmap=ListedColormap(["lightgray"]))
        colours = axis.pcolormesh(edges, rows, np.ma.array(error, mask=~known | np.isnan(error)), norm=LogNorm(0.01, 1), cmap="RdYlBu_r")
        stopped = np.array(found["stopped"])[:, 1:] > 0
        axis.pcolormesh(edges, rows, np.ma.array(np.ones(known.shape), mask=~(known & stopped)), cmap=ListedColormap(["black"]))
        held = known & (error <= result["tolerance"])
        bounded(axis, edges, rows, held, colors="black", linewidths=1.8)
        bounded(axis, edges, rows, flag >= 0.5, colors="navy", linewidths=1.2, linestyles="dashed")
        for i, j in np.argwhere(known & (volume > result["band"])):
            axis.add_patch(Rectangle((edges[j], rows[i]), edges[j + 1] - edges[j], 1, fill=False, hatch="////", linewidth=0))
        axis.set(title=name, yticks=range(len(factors)), yticklabels=[f"× {factor:g}" for factor in factors])
        axis.title.set_size(9)
        axis.grid(False)
    for axis in axes.flat[len(names) :]:
        axis.axis("off")
    marks = [
        plt.Line2D([], [], color="black", linewidth=1.8, label=f"bounds error within {100 * result['tolerance']:g} %"),
        plt.Line2D([], [], color="navy", linestyle="--", label="forces beyond training above\n(half of the interactions)"),
        Patch(facecolor="white", edgecolor="black", hatch="////", label=f"volume off by more than {100 * result['band']:g} %"),
        Patch(facecolor="lightgray", label="FEM truth stopped (half or more)"),
        Patch(facecolor="black", label="competitor stopped (any)"),
    ]
    axes.flat[len(names)].legend(handles=marks, loc="center", fontsize=8, frameon=False)
    for axis in axes[:, 0]:
        axis.set_ylabel("contact force")
    for column in axes.T:
        lowest = [axis for axis in column if axis.axison][-1]
        lowest.set_xlabel("time (s)")
        lowest.tick_params(labelbottom=True)
    figure.colorbar(colours, ax=axes, label="relative L2 error", format=lambda x, _: f"{100 * x:g} %", shrink=0.7)
    return figure


def bounded(axis, x, y, mask, **style):
    """Draw the boundary of the cells (rows, columns) of a grid with edges x and y where `mask` holds."""
    from matplotlib.collections import LineCollection

    padded = np.pad(mask, 1)
    sides = [((x[j], y[i]), (x[j], y[i + 1])) for i, j in np.argwhere(padded[1:-1, 1:] != padded[1:-1, :-1])]
    sides += [((x[j], y[i]), (x[j + 1], y[i])) for i, j in np.argwhere(padded[1:, 1:-1] != padded[:-1, 1:-1])]
    axis.add_collection(LineCollection(sides, **style))
