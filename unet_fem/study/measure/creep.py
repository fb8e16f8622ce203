"""What of an answer is time dependence: the decomposition that the stage time_dependence
reports."""

import numpy as np

from fem.data.dataset import Dataset


def fields(dataset: Dataset, displacement: np.ndarray) -> np.ndarray:
    """(interactions, frames, d) of displacement (interactions and frames, nx, ny, nz, 3): the free
    nodes' components in a row."""
    return displacement.reshape(-1, len(dataset.time), *dataset.grid, 3)[
        :, :, dataset.free
    ].reshape(-1, len(dataset.time), 3 * dataset.free.sum())


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(interactions, frames): scalar products of fields (interactions, frames, d)."""
    return np.einsum("ifd,ifd->if", a, b, dtype=float)


def judge(
    time: np.ndarray,
    truth: np.ndarray,
    elastic: np.ndarray,
    answers: dict[str, tuple[str, np.ndarray]],
) -> dict:
    """How far each answer is from the viscoelastic truth, and how much of that is time dependence.

    time (frames,) s; truth, elastic and the fields in answers {name: (label, field)}:
    (interactions, frames, d) mm. With the error e = u - u_ve of an answer and the time dependence d
    = u_ve - u_el, all of one interaction at one frame:

        relative_l2 = sqrt(sum |e|^2 / sum |u_ve|^2)
        along       = sum (<e, d>^2 / |d|^2) / sum |e|^2
        missed      = -sum <e, d> / sum |d|^2
        common      = missed^2 sum |d|^2 / sum |e|^2
        creep       = sum <u, u_el> / sum |u_el|^2

    Sums run over the interactions at each frame, and in "overall" over the frames too.

    along: share of the squared error in the direction of each d. An upper bound of what is time
    dependence: any wrong size of u lies along d too.
    missed: share of the time dependence that the answer lacks: 1 for the elastic answer, 0 for the
    truth, below 0 for more creep than there is.
    common: share of the squared error that this lack makes up, the same for all in the sum. A lower
    bound; the rest is at right angles to it.
    creep: size of the answer, in elastic answers.
    followed, overall alone: slope of <u, u_el> / |u_el|^2 against <u_ve, u_el> / |u_el|^2 over the
    frames of each interaction, about its mean, weighed by |u_el|^2: 1 for the truth, 0 for an
    answer of one size in elastic answers, however long the force has been held. Answers to the last
    force alone know nothing of that: what they reach by the answer's shape is no memory, and the
    mark to beat.

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
        along = np.divide(ed**2, dd, out=np.zeros_like(dd), where=dd > 0)
        parts = ee, along, ed, ul, vv, dd, ll
        by_frame = shares(*(part.sum(axis=0) for part in parts))
        over_all = shares(*(part.sum() for part in parts))
        judged[name] = (
            {"label": label, "squared_error": ee.sum(axis=1).tolist()}
            | {key: value.tolist() for key, value in by_frame.items()}
            | {
                "overall": {key: value[()] for key, value in over_all.items()}
                | {"followed": slope(vl, ul, ll)}
            }
        )
    return {
        "time": time.tolist(),
        "interactions": len(truth),
        "squared_truth": vv.sum(axis=1).tolist(),
        "creep": ratio(vl.sum(axis=0), ll.sum(axis=0)).tolist(),
        "time_dependence": ratio(dd.sum(), vv.sum(), root=True)[()],
        "answers": judged,
    }


def shares(
    ee: np.ndarray,
    along: np.ndarray,
    ed: np.ndarray,
    ul: np.ndarray,
    vv: np.ndarray,
    dd: np.ndarray,
    ll: np.ndarray,
) -> dict[str, np.ndarray]:
    """The shares that `judge` describes, from its sums."""
    lack = np.divide(ed**2, dd, out=np.zeros_like(dd), where=dd > 0)
    return {
        "relative_l2": ratio(ee, vv, root=True),
        "along": ratio(along, ee),
        "missed": ratio(-ed, dd),
        "common": ratio(lack, ee),
        "creep": ratio(ul, ll),
    }


def ratio(a: np.ndarray, b: np.ndarray, root: bool = False) -> np.ndarray:
    """a / b, or its square root, as an array of floats, with None where b is zero."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    found = np.divide(a, b, out=np.zeros_like(a), where=b > 0)
    return np.where(b > 0, np.sqrt(found) if root else found, np.array(None))


def slope(vl: np.ndarray, ul: np.ndarray, ll: np.ndarray) -> float | None:
    """Slope of ul / ll against vl / ll with weights ll, all (interactions, frames), each
    interaction about its mean; None if no size changes."""
    ll = np.where(ll > 1e-6 * ll.max(), ll, 0)  # before the first touch there is no size
    x, y = (np.divide(part, ll, out=np.zeros_like(ll), where=ll > 0) for part in (vl, ul))
    x -= np.sum(ll * x, axis=1, keepdims=True) / np.maximum(ll.sum(axis=1, keepdims=True), 1e-300)
    spread = float(np.sum(ll * x * x))
    return float(np.sum(ll * x * y)) / spread if spread > 0 else None
