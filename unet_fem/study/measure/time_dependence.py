"""Time dependence: does a network know more than the elastic, memoryless answer to the same force?

The tissue creeps: under a held force it goes on giving way. An elastic tissue answers the force of
the moment alone. What lies between the two answers to the same contacts is the time dependence, and
a network may have learned all, some or none of it.
"""

from dataclasses import replace

import numpy as np
from scipy.stats import bootstrap

from fem.contact.surface import Surface
from fem.data.dataset import open_dataset
from fem.data.interaction import contacts_of, simulate
from fem.errors import InputError, SolverStopped
from fem.files import save_arrays
from fem.workers import on_all_cores
from unet_fem.networks.registry import network
from unet_fem.study.measure.reference import judged


def run(study):
    """{"trained_s": length of the networks' interactions, "factor": ..., "short": ..., "long":
    ...}.

    short: the judged test interactions of the networks' own dataset; long: those of
    study.long_data. Each as `judge` gives it, with "numbers" of the interactions, "left_out":
    {number: why the elastic tissue stopped in it} and "window": the difference that the longer
    window makes, see `difference`. factor: the one number times which the elastic answer
    comes closest to the short interactions: the best that can be known without memory, but for the
    answer's shape.
    """
    from unet_fem.training.run import ensure_dataset

    settings = study.network(study.cnn_lstm)
    short = open_dataset(settings.data).for_learning()
    long = ensure_dataset(replace(settings, scene=study.long_scene, data=study.long_data))
    if long.grid != short.grid or long.scene.frames.interval != short.scene.frames.interval:
        raise InputError(
            f"{study.long_scene} has a grid of {long.grid} nodes and frames {long.scene.frames.interval:g} s apart, the networks learned from"
            f" {short.grid} and {short.scene.frames.interval:g} s; give it the mesh and frames.interval of {settings.scene}"
        )
    result = {"trained_s": float(short.time[-1])}
    for name, dataset, numbers in (
        ("short", short, judged(study, short)),
        ("long", long, long.number[long.split == "test"].tolist()),
    ):
        simulated, stopped = elastic_answers(study, dataset, numbers)
        elastic = fields(dataset, np.stack(list(simulated.values())))
        networks, truth = network_answers(study, dataset, list(simulated))
        factor = result.setdefault(
            "factor", float(dot(truth, elastic).sum() / dot(elastic, elastic).sum())
        )  # of the short ones
        answers = {
            "elastic": ("elastic FEM", elastic),
            "scaled": (f"elastic FEM × {factor:.2f}", factor * elastic),
        }
        result[name] = judge(dataset.time, truth, elastic, answers | networks) | {
            "numbers": list(simulated),
            "left_out": stopped,
        }
        errors = [result[name]["answers"][run]["squared_error"] for run in study.window]
        result[name]["window"] = difference(*errors, result[name]["squared_truth"])
    return result


def elastic_answers(study, dataset, numbers):
    """({number: displacement (frames, nx, ny, nz, 3) mm}, {number: why it stopped}) of test
    interactions without the Prony terms.

    Computed in parallel where they are missing, and kept in the study's folder. Raises InputError
    if all of them stop.
    """
    paths = {
        number: study.folder / "elastic" / f"{dataset.scene.digest()}-test-{number:04d}.npz"
        for number in numbers
    }
    missing = [(dataset, number, path) for number, path in paths.items() if not path.is_file()]
    if missing:
        on_all_cores(elastic_answer, missing, f"elastic answers to {dataset.path.name}")
    answers, stopped = {}, {}
    for number, path in paths.items():
        with np.load(path) as file:
            if "stopped" in file:
                stopped[number] = str(file["stopped"])
            else:
                answers[number] = file["displacement"]
    if not answers:
        raise InputError(
            f"the elastic tissue stops in every test interaction of {dataset.path}; lower contact.force in its scene"
        )
    return answers, stopped


def elastic_answer(dataset, number, path):
    """Write the frames of a test interaction to `path`, or why it stopped: the dataset's mesh,
    contacts and solver, an elastic tissue."""
    scene, mesh = dataset.scene, dataset.fem_mesh
    elastic = replace(scene, material=replace(scene.material, prony=()))
    try:
        found = simulate(elastic, mesh, contacts_of(dataset, "test", number), Surface(mesh))
    except SolverStopped as stop:
        save_arrays(path, stopped=stop.reason)
    else:
        save_arrays(path, displacement=dataset.on_grid(found["force"], found["displacement"])[1])


def network_answers(study, dataset, numbers):
    """({name: (label, answer)}, truth) for the test interactions `numbers`, each field
    (interactions, frames, d) mm.

    The answers are those of the deployed networks and of both windows, named by their runs, and of
    one linear regression a window.
    """
    from unet_fem.training.checkpoint import load_model
    from unet_fem.training.judge import predict
    from unet_fem.training.regressions import linear_regression
    from unet_fem.training.samples import load_samples

    answers, windows = {}, set()
    for run in dict.fromkeys((study.cnn_lstm, *study.window, study.unet)):
        settings = study.network(run)
        samples = load_samples(dataset, "test", settings.model.window)
        samples = samples.select(np.isin(samples.interaction, numbers))
        frames = settings.model.window or 1
        models = {
            run: (
                load_model(settings.folder / "best.keras"),
                network(settings.model.kind).label + (f", {frames} forces" if frames > 1 else ""),
            )
        }
        if frames not in windows:
            models[f"linear {frames}"] = (
                linear_regression(settings),
                f"linear, {frames} force{'s' * (frames > 1)}",
            )
            windows.add(frames)
        for name, (model, label) in models.items():
            print(f"{label} on {dataset.path.name}", flush=True)
            answers[name] = label, fields(dataset, predict(model, samples, dataset)[0])
    return answers, fields(dataset, samples.displacement)


def fields(dataset, displacement):
    """(interactions, frames, d) of displacement (interactions and frames, nx, ny, nz, 3): the free
    nodes' components in a row."""
    return displacement.reshape(-1, len(dataset.time), *dataset.grid, 3)[
        :, :, dataset.free
    ].reshape(-1, len(dataset.time), 3 * dataset.free.sum())


def dot(a, b):
    """(interactions, frames): scalar products of fields (interactions, frames, d)."""
    return np.einsum("ifd,ifd->if", a, b, dtype=float)


def judge(time, truth, elastic, answers):
    """How far each answer is from the viscoelastic truth, and how much of that is time dependence.

    time (frames,) s; truth, elastic and the fields in answers {name: (label, field)}:
    (interactions, frames, d) mm. With the error e = u - u_ve of an answer and the time dependence d
    = u_ve - u_el, all of one interaction at one frame:

        relative_l2 = sqrt(sum |e|^2 / sum |u_ve|^2)
        along       = sum (<e, d>^2 / |d|^2) / sum |e|^2   share of the squared error in the
        direction of each d. An upper bound
                                                           of what is time dependence: any wrong
                                                           size of u lies along d too
        missed      = -sum <e, d> / sum |d|^2              share of the time dependence that the
        answer lacks: 1 for the elastic
                                                           answer, 0 for the truth, below 0 for more
                                                           creep than there is
        common      = missed^2 sum |d|^2 / sum |e|^2       share of the squared error that this lack
        makes up, the same for all
                                                           in the sum. A lower bound; the rest is at
                                                           right angles to it
        creep       = sum <u, u_el> / sum |u_el|^2         size of the answer, in elastic answers

    Sums run over the interactions at each frame, and in "overall" over the frames too. There is
    also

        followed    = slope of <u, u_el> / |u_el|^2 against <u_ve, u_el> / |u_el|^2 over the frames
        of each interaction, about its
                      mean, weighed by |u_el|^2: 1 for the truth, 0 for an answer of one size in
                      elastic answers, however long the force has been held. Answers to the last
                      force alone (the U-Net, one linear regression) know
                      nothing of that: what they reach by the answer's shape is no memory, and the
                      mark to beat

    Returns {"time": [s], "interactions": their number, "squared_truth": [of each interaction, mm2],
    "creep": of the FEM, "time_dependence": sqrt(sum |d|^2 / sum |u_ve|^2), "answers": {name:
    {"label", "squared_error": [of each interaction], "relative_l2", "along", "missed", "common",
    "creep": [frames], "overall": {the same as numbers, "followed"}}}}; None where nothing moves or
    nothing is wrong.
    """
    d = truth - elastic
    vv, dd, ll, vl = dot(truth, truth), dot(d, d), dot(elastic, elastic), dot(truth, elastic)
    judged = {}
    for name, (label, u) in answers.items():
        e = u - truth
        ee, ed, ul = dot(e, e), dot(e, d), dot(u, elastic)
        parts = ee, np.divide(ed**2, dd, out=np.zeros_like(dd), where=dd > 0), ed, ul, vv, dd, ll
        overall = {key: value[()] for key, value in shares(*(part.sum() for part in parts)).items()}
        overall["followed"] = slope(vl, ul, ll)
        by_frame = {
            key: value.tolist()
            for key, value in shares(*(part.sum(axis=0) for part in parts)).items()
        }
        judged[name] = (
            {"label": label, "squared_error": ee.sum(axis=1).tolist()}
            | by_frame
            | {"overall": overall}
        )
    return {
        "time": time.tolist(),
        "interactions": len(truth),
        "squared_truth": vv.sum(axis=1).tolist(),
        "creep": ratio(vl.sum(axis=0), ll.sum(axis=0)).tolist(),
        "time_dependence": ratio(dd.sum(), vv.sum(), root=True)[()],
        "answers": judged,
    }


def shares(ee, along, ed, ul, vv, dd, ll):
    """The shares that `judge` describes, from its sums."""
    lack = np.divide(ed**2, dd, out=np.zeros_like(dd), where=dd > 0)
    return {
        "relative_l2": ratio(ee, vv, root=True),
        "along": ratio(along, ee),
        "missed": ratio(-ed, dd),
        "common": ratio(lack, ee),
        "creep": ratio(ul, ll),
    }


def ratio(a, b, root=False):
    """a / b, or its square root, as an array of floats, with None where b is zero."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    found = np.divide(a, b, out=np.zeros_like(a), where=b > 0)
    return np.where(b > 0, np.sqrt(found) if root else found, None)


def slope(vl, ul, ll):
    """Slope of ul / ll against vl / ll with weights ll, all (interactions, frames), each
    interaction about its mean; None if no size changes."""
    ll = np.where(ll > 1e-6 * ll.max(), ll, 0)  # before the first touch there is no size
    x, y = (np.divide(part, ll, out=np.zeros_like(ll), where=ll > 0) for part in (vl, ul))
    x -= np.sum(ll * x, axis=1, keepdims=True) / np.maximum(ll.sum(axis=1, keepdims=True), 1e-300)
    spread = float(np.sum(ll * x * x))
    return float(np.sum(ll * x * y)) / spread if spread > 0 else None


def difference(shorter, longer, truth, seed=0):
    """Relative L2 error with the longer window minus that with the shorter: {"difference", "low",
    "high"}, a 95 % interval.

    shorter, longer: squared errors of each interaction; truth: its squared displacement. The
    interval is of a bootstrap over interactions, both windows with the same ones (percentiles);
    None for a single interaction.
    """

    def statistic(shorter, longer, truth, axis=-1):
        shorter, longer, truth = (np.sum(x, axis=axis) for x in (shorter, longer, truth))
        return np.sqrt(longer / truth) - np.sqrt(shorter / truth)

    data = tuple(np.asarray(x) for x in (shorter, longer, truth))
    low = high = None
    if len(truth) > 1:
        interval = bootstrap(
            data, statistic, paired=True, method="percentile", rng=np.random.default_rng(seed)
        ).confidence_interval
        low, high = float(interval.low), float(interval.high)
    return {"difference": float(statistic(*data)), "low": low, "high": high}
