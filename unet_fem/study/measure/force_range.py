"""Stability beside accuracy: under which multiple of the usual forces, and until when, does each
competitor stay close to the FEM?

The contacts of test interactions push with their forces times each factor. The dataset's own solver
gives the truth, as far as it goes; a competitor holds where its relative L2 error is within
TOLERANCE and its volume within the paper's band.
"""

import hashlib
from dataclasses import replace

import numpy as np

from fem.contact.push import Load
from fem.contact.surface import Surface
from fem.data.interaction import contacts_of, simulate_frames
from fem.errors import SolverStopped
from fem.files import save_arrays
from fem.solver.energy import EnergyLedger
from fem.workers import on_all_cores
from unet_fem.study.measure.fixed_latency import (
    frame_forces,
    frame_loop,
    frames_between,
    loop_name,
    tuned,
)
from unet_fem.study.measure.reference import study_dataset

TOLERANCE = 0.10  # relative L2


def run(study):
    """How far every competitor is from the truth, over force factor and time.

    Returns {"factors", "time": s, "interactions": numbers, "tolerance", "band", "alive":
    interactions that the truth reaches this frame in, "flag": share of all interactions whose force
    leaves the training range, "stops": [{"what", "number", "factor", "after": s, "reason"}],
    "competitors": {name: {"relative_l2", "volume", "stopped"}}}. Tables are lists [factors][frames]
    over
    the interactions that are alive: relative_l2, None where none moves or where a run of the
    competitor has stopped; volume, the largest |V / V_rest - 1| (also of "truth"), None where none
    is alive; stopped, runs of the competitor that have.
    """
    from unet_fem.runtime.surrogate import VOLUME_BAND, force_size
    from unet_fem.training.losses import deformed_volume

    dataset = study_dataset(study)
    parts, networks = (
        simulated(study, dataset, real_time(study, dataset)),
        network_functions(study, dataset),
    )
    largest, rest = force_size(dataset.read("train")["force"]), dataset.rest_volume
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
        flag[row] += [
            np.any(np.array(force_size(field)) > 1.00001 * np.array(largest)) for field in force
        ]
        stops += [
            {
                "what": name,
                "number": number,
                "factor": factor,
                "after": float(dataset.time[len(answers[name]) - 1]),
                "reason": reason,
            }
            for name, reason in reasons.items()
            if reason
        ]
        for name, answer in (
            answers | {name: network(force) for name, network in networks.items()}
        ).items():
            answer = answer[:here]  # what comes after the truth has stopped cannot be judged
            tables = [
                store.setdefault(name, np.zeros(shape)) for store in (squared, volume, stopped)
            ]
            reached = len(answer)
            tables[0][row, :reached] += np.square(answer[:, dataset.free] - truth[:reached]).sum(
                axis=(1, 2)
            )
            change = np.abs(np.asarray(deformed_volume(answer, *dataset.surface), float) / rest - 1)
            tables[1][row, :reached] = np.maximum(tables[1][row, :reached], change)
            tables[2][row, reached:here] += 1
    competitors = {
        name: {
            "relative_l2": table(
                np.sqrt(squared[name] / np.where(size > 0, size, 1)),
                (size > 0) & (stopped[name] == 0),
            ),
            "volume": table(volume[name], (alive > 0) & (stopped[name] == 0)),
            "stopped": stopped[name].astype(int).tolist(),
        }
        for name in squared
    }
    return {
        "factors": factors,
        "time": dataset.time.tolist(),
        "interactions": list(study.stability.interactions),
        "tolerance": TOLERANCE,
        "band": VOLUME_BAND,
        "alive": alive.tolist(),
        "flag": (flag / len(study.stability.interactions)).tolist(),
        "stops": stops,
        "competitors": competitors,
    }


def real_time(study, dataset):
    """The LoopSettings that stands for the FEM in real time: of the tuned loops of full elements at
    the shortest frame, that of fewest steps."""
    found = [
        c
        for c in tuned(study, dataset)[0]
        if c.element == "full" and not c.coarse and c.frame == min(study.fem.frames)
    ]
    return min(found, key=lambda c: c.steps)


def table(values, known):
    return np.where(known, values, None).tolist()


def simulated(study, dataset, loop):
    """The FEM's answers: an iterator of ((number, factor), (force, {name: field}, {name: why it
    stopped, or ""})).

    force and fields (frames, nx, ny, nz, 3) in mN and mm; a field ends before the frame that its
    run did not reach. loop: the LoopSettings that is the FEM in real time. Computed in parallel where
    they are missing, and kept in the study's folder.
    """
    which = [
        (number, factor)
        for number in study.stability.interactions
        for factor in study.stability.factors
    ]
    key = hashlib.sha256(repr(loop).encode()).hexdigest()[:8]
    places = {}
    for kind in ("offline", f"loop-{key}"):
        places[kind] = [
            study.folder / "stability" / f"{dataset.scene.digest()}-{kind}-{n:04d}-x{factor:g}.npz"
            for n, factor in which
        ]
    for (kind, paths), function, settings in zip(
        places.items(), (simulate_offline, simulate_loop), ((), (loop,))
    ):
        missing = [
            (dataset, *pair, *settings, path)
            for pair, path in zip(which, paths)
            if not path.is_file()
        ]
        if missing:
            on_all_cores(function, missing, f"multiplied forces, {kind}")
    for (number, factor), *paths in zip(which, *places.values()):
        answers, reasons = {}, {}
        for path in paths:
            with np.load(path) as file:
                for name in file.files:
                    kind, _, stopped = name.partition(":")
                    (reasons if stopped else answers)[kind] = (
                        str(file[name]) if stopped else file[name]
                    )
        yield (number, factor), (factor * force_of(dataset, number), answers, reasons)


def force_of(dataset, number):
    """(frames, nx, ny, nz, 3) mN: the forces of a test interaction on the grid."""
    own = dataset.sequence("test", number)
    return dataset.on_grid(own.force, own.displacement)[0]


def simulate_offline(dataset, number, factor, path):
    """Write test interaction `number` at `factor` times its forces to `path`, by the dataset's
    solver under its rules of health.

    The answers: "truth", and "elastic FEM", the same without Prony terms.
    """
    scene, mesh, times = dataset.scene, dataset.fem_mesh, dataset.time
    force = dataset.sequence("test", number).force
    load = Load(
        Surface(mesh),
        [
            replace(contact, peak=factor * contact.peak)
            for contact in contacts_of(dataset, "test", number)
        ],
    )

    def stepper(scene):
        ledger = EnergyLedger()
        answers = simulate_frames(scene.build_solver(mesh), load, times[1:], [ledger])

        def step(frame):
            answer = next(answers).displacement
            if ledger.smallest_J < scene.health.min_J:
                raise SolverStopped(
                    "crushed cell", f"a cell is crushed to J = {ledger.smallest_J:.3g}"
                )
            return dataset.on_grid(force[frame], answer)[1]

        return step

    elastic = replace(scene, material=replace(scene.material, prony=()))
    save_frames(path, {"truth": stepper(scene), "elastic FEM": stepper(elastic)}, dataset)


def simulate_loop(dataset, number, factor, competitor, path):
    """Write the same by the FEM in real time, which takes its few steps for the force that comes
    every frame of its own."""
    loop, forces = (
        frame_loop(dataset, competitor),
        factor * frame_forces(dataset, "test", number, competitor.frame),
    )
    calls = frames_between(dataset.scene, competitor.frame)

    def step(frame):
        for force in forces[(frame - 1) * calls : frame * calls]:
            answer = loop.step(force)
        return answer

    save_frames(path, {loop_name(competitor): step}, dataset)


def save_frames(path, steps, dataset):
    """Write what `frames` makes of {name: step} to `path`."""
    arrays = {}
    for name, step in steps.items():
        arrays[name], arrays[f"{name}:stopped"] = frames(
            step, (len(dataset.time), *dataset.grid, 3)
        )
    save_arrays(path, **arrays)


def frames(step, shape):
    """(fields (frames reached, nx, ny, nz, 3), reason or ""): step(frame) from rest, until it stops
    or gives no finite field.

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
    """{name: force (frames, nx, ny, nz, 3) mN -> displacement of the same shape, mm}: the deployed
    networks and linear regression."""
    from unet_fem.deployment.answers import answers as lite_answers
    from unet_fem.training.checkpoint import load_model
    from unet_fem.training.regressions import linear_regression
    from unet_fem.training.samples import windows

    def whole(model, steps):
        return lambda force: np.asarray(model(windows(force[None], steps)))

    functions = {}
    for name, run in (("CNN-LSTM", study.cnn_lstm), ("U-Net", study.unet)):
        settings = study.network(run)
        if not functions:
            functions["linear regression"] = whole(
                linear_regression(settings), settings.model.window
            )
        functions[name] = whole(
            load_model(settings.folder / "best.keras"), settings.model.window
        )
        if (lite := settings.folder / "lite/int8.tflite").is_file():
            functions[f"{name}, int8"] = lambda force, path=lite: lite_answers(path, force[None])
    return functions
