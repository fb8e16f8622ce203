"""Random mutations of every file that a stepper opens from: regressions, reduced models,
constitutive and modal networks and surrogates. Each is refused in one line, or opened and answers;
no other exception, and no dead process.

    pytest tests/fuzz                      a few hundred, in seconds
    FUZZ=100 pytest -m slow tests/fuzz     ten times as many
"""

import io
import os
import warnings
from pathlib import Path

import numpy as np
import pytest

from fem.errors import InputError, SolverStopped
from fem.files import load_arrays, save_arrays
from fem.online.constitutive import save_constitutive
from fem.online.creep import Creep
from fem.online.input_field import InputField
from fem.online.reduced_model import Block, ReducedModel
from fem.online.regression import Regression
from unet_fem.deployment import tflite as lite
from unet_fem.deployment.constitutive_graph import export_constitutive
from unet_fem.deployment.modal import export_modal, within
from unet_fem.networks.constitutive import ConstitutiveCell
from unet_fem.networks.modal import ModalNetwork
from unet_fem.networks.unet import unet
from unet_fem.runtime.constitutive import write_constitutive
from unet_fem.runtime.modal import write_modal
from unet_fem.runtime.surrogate_file import write_surrogate
from unet_fem.steppers import open_stepper

MORE = int(os.environ.get("FUZZ", "10"))
NODES, GRID, R, SEEN, POINTS = 8, (2, 2, 2), 5, 3, 4
MESH = np.arange(NODES)
KINDS = (
    "regression", "remembering", "reduced", "constitutive", "graph", "unet graph", "modal graph"
)  # fmt: skip
PRONY = ((0.12, 330.0), (0.8, 11.0))


def reduced_model():
    """A ReducedModel of small random arrays without a mirror."""
    rng = np.random.default_rng(3)

    def draw(*shape):
        return (0.02 * rng.standard_normal(shape)).astype("float32")

    law = {"kind": "neo_hooke", "mu": 400.0, "nu": 0.42, "density": 1000.0, "prony": list(PRONY)}
    block = Block(
        draw(9 * POINTS, SEEN), draw(R, 9 * POINTS + SEEN), draw(R, 12), draw(12, R),
        np.eye(R, dtype="float32"), draw(2, 12),
    )  # fmt: skip
    meta = {"mesh": "m", "material": "t", "law": law, "nodes": NODES, "interval": 0.25}
    force, free = MESH[None, :4].astype("int32"), MESH[None, 4:].astype("int32")
    return ReducedModel((block,), force, free, np.array(PRONY), axis=None, grid=None, meta=meta)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """{kind: (path, writer of a file of its arrays)}"""
    folder, rng = tmp_path_factory.mktemp("files"), np.random.default_rng(4)
    paths = {name: folder / f"{name}.{'tflite' if 'graph' in name else 'npz'}" for name in KINDS}
    kernel = rng.normal(size=(24, 24)).astype("f4")
    mask = np.ones(GRID, bool)
    regression = Regression(mask, np.arange(24), kernel, interval=0.25, index=MESH)
    regression.save(paths["regression"])
    regression.remembering(Creep.of(PRONY)).save(paths["remembering"])
    model = reduced_model()
    model.save(paths["reduced"])
    cell = ConstitutiveCell.of(model, 2)
    learned = dict(cell.learned) | {"effort": np.ones(2), "guard": np.full((2, 5), 0.1)}
    save_constitutive(paths["constitutive"], model, learned)
    graph = export_constitutive(cell, model)
    write_constitutive(paths["graph"], graph, model.arrays() | learned)
    facts = {
        "mask": mask, "index": MESH, "points": rng.random((8, 3)),
        "faces": np.array([[0, 1, 3, 2], [4, 6, 7, 5]]), "mesh": "m", "interval": 0.25,
        "largest_force": (1.0, 1.0), "label": "tiny", "field": InputField(GRID, Creep.of(PRONY)),
    }  # fmt: skip
    graphs = {"graph": graph, "unet graph": lite.export(unet(GRID, 2, mask=mask), "float32")}
    write_surrogate(paths["unet graph"], graphs["unet graph"], **facts)
    whole, _ = within(model, np.arange(R))
    network = ModalNetwork(R, 8, 2, remembered=2, scales=(2.0, 0.5))
    graphs["modal graph"] = export_modal(network, whole)
    guard = np.array([0.01, 1.0, 0.0, 0.0, 1e9])
    write_modal(paths["modal graph"], graphs["modal graph"], whole, guard)

    def again(name):
        if "graph" not in name:
            return lambda other, arrays: save_arrays(other, **arrays)

        def write(other, arrays):
            packed = io.BytesIO()
            np.savez(packed, **arrays)
            Path(other).write_bytes(graphs[name] + packed.getvalue())

        return write

    return {name: (path, again(name)) for name, path in paths.items()}


ODD = [
    np.array("x"), np.zeros(0), np.full((2, 2), np.nan), np.array(-1), np.arange(9.0),
    np.array(1e9),
    np.array(10**9), np.array([[1, 2]]), np.array(1e-320), np.array(np.inf), np.zeros((3, 3, 3)),
    np.array(True), np.array(b"\xff"), np.array(1j), np.array("unet-fem reduced 1"),
]  # fmt: skip


def changed(arrays, rng):
    """The arrays of a file with one replaced, left out, scaled or of another type or shape."""
    name = list(arrays)[rng.integers(len(arrays))]
    old, kind = arrays[name], rng.integers(7)
    if kind == 0:
        return {own: array for own, array in arrays.items() if own != name}
    if kind == 1:
        return arrays | {name: ODD[rng.integers(len(ODD))]}
    if kind == 2 and old.ndim:
        return arrays | {name: old[rng.integers(2) :: 2]}
    if old.dtype.kind in "fiu" and old.size:
        new = np.array(old)
        if kind == 3:
            new.reshape(-1)[rng.integers(new.size)] = [99, 0, 7, 120][rng.integers(4)]
        elif kind == 4 and old.dtype.kind == "f":
            new.reshape(-1)[rng.integers(new.size)] = [np.nan, np.inf, 3e38, -1e30][rng.integers(4)]
        elif kind == 5:
            new = (new * [0, 2, 1.001, 10][rng.integers(4)]).astype(old.dtype)
        else:
            new = new.astype(["f2", "f8", "i8", "c16", "S4"][rng.integers(5)])
        return arrays | {name: new}
    return arrays | {name: ODD[rng.integers(len(ODD))]}


def use(path):
    """Open and step; an answer that is not finite is flagged."""
    stepper = open_stepper(path)
    for scale in (0.01, 0.02):
        force = np.full((NODES, 3), scale)
        finite = np.isfinite(stepper.step(force, 0.25)).all()
        assert finite or any(getattr(stepper, flag, False) for flag in ("flagged", "volume_alarm"))
    stepper.restore(stepper.state())
    stepper.reset()


def refused(path):
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            use(path)
        except (InputError, SolverStopped) as error:
            assert "\n" not in str(error) and len(str(error)) < 1000, error
            return True
    return False


def fuzz(files, folder, count, seed):
    """Shares of the mutations of arrays and of bytes that are refused, over every kind of file."""
    rng, tally = np.random.default_rng(seed), {"arrays": [], "bytes": []}
    for path, write in files.values():
        assert not refused(path)
        arrays, whole = load_arrays(path), path.read_bytes()
        other = folder / path.name
        for _ in range(count):
            write(other, changed(arrays, rng))
            tally["arrays"].append(refused(other))
            data = bytearray(whole)
            start = rng.integers(len(data))
            kind = rng.integers(4)
            if kind == 0:
                data[start : start + 64] = rng.bytes(len(data[start : start + 64]))
            elif kind == 1:
                data[start : start + 256] = bytes(len(data[start : start + 256]))
            elif kind == 2:
                del data[start:]
            else:
                data[start] ^= 1 << rng.integers(8)
            other.write_bytes(data)
            tally["bytes"].append(refused(other))
    return {kind: np.mean(found) for kind, found in tally.items()}


def test_mutations_of_the_files_of_steppers(files, tmp_path):
    """Twenty of each of seven files' arrays and bytes: some of the arrays mean something else and
    open, bytes are all covered by digests."""
    shares = fuzz(files, tmp_path, 2 * MORE, 1)
    assert 0.3 < shares["arrays"] < 0.95 and shares["bytes"] > 0.9, shares


@pytest.mark.slow
def test_many_mutations_of_the_files_of_steppers(files, tmp_path):
    shares = fuzz(files, tmp_path, 50 * MORE, 2)
    assert 0.3 < shares["arrays"] < 0.95 and shares["bytes"] > 0.9, shares
