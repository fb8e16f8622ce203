"""The surrogate at run time: its window, its checks, its file, and that it needs and leaks
nothing."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import keras
import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from fem.online.stepper import Stepper
from unet_fem.deployment import tflite as lite
from unet_fem.networks.cnn_lstm import cnn_lstm
from unet_fem.networks.unet import unet
from unet_fem.runtime import surrogate_file
from unet_fem.runtime.surrogate import Surrogate, force_size
from unet_fem.runtime.surrogate_file import FORMAT_1, read_surrogate, write_surrogate
from unet_fem.training import losses
from unet_fem.training.samples import windows

ROOT = Path(__file__).parents[3]


def network(dataset, kind, displacement_scale=0.05):
    keras.utils.set_random_seed(0)
    scaled = {"force_scale": 0.05, "displacement_scale": displacement_scale, "mask": dataset.free}
    return (
        unet(dataset.grid, 2, **scaled)
        if kind == "unet"
        else cnn_lstm(dataset.grid, 4, 3, **scaled)
    )


def write(path, model, dataset, variant="float32"):
    write_surrogate(
        path, lite.export(model, variant), **lite.surrogate_facts(dataset), label=f"tiny: {variant}"
    )
    return path


@pytest.fixture(scope="module")
def dataset(tiny_dataset):
    return open_dataset(tiny_dataset)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("surrogates")


@pytest.fixture(scope="module")
def model(dataset):
    return network(dataset, "cnn_lstm")


@pytest.fixture(scope="module")
def file(dataset, model, folder):
    return write(folder / "cnn_lstm.tflite", model, dataset)


@pytest.fixture(scope="module")
def force(dataset):
    return dataset.read("train")["force"]  # (I, F, nx, ny, nz, 3)


def test_steps_see_the_windows_of_training(file, model, force):
    surrogate = Surrogate(file)
    answers = []
    for interaction in force:
        surrogate.reset()
        answers += [surrogate.step(field) for field in interaction]
    expected = np.asarray(model(windows(force, 3)))
    np.testing.assert_allclose(answers, expected, atol=1e-5 * np.abs(expected).max())


def test_unet_needs_no_window(dataset, folder, force):
    unet_model = network(dataset, "unet")
    surrogate = Surrogate(
        write(folder / "unet.tflite", unet_model, dataset), rate=1000 / 3
    )  # any rate will do
    expected = np.asarray(unet_model(force[0]))
    np.testing.assert_allclose(
        [surrogate.step(f) for f in force[0]], expected, atol=1e-5 * np.abs(expected).max()
    )


def test_at_a_rate_the_window_holds_forces_one_interval_apart(dataset, file, model):
    rate, apart = 20.0, 4  # calls in the dataset's 0.2 s
    calls = np.random.default_rng(0).normal(0, 0.01, (11, *dataset.grid, 3)).astype("float32")
    surrogate = Surrogate(file, rate=rate)
    answers = [surrogate.step(field) for field in calls]
    past = np.concatenate([np.zeros_like(calls[: 2 * apart]), calls])  # no force before the start
    seen = np.stack(
        [past[:11], past[apart : apart + 11], past[2 * apart :]], axis=1
    )  # (11, 3, nx, ny, nz, 3)
    expected = np.asarray(model(seen))
    np.testing.assert_allclose(answers, expected, atol=1e-5 * np.abs(expected).max())


def test_rate_must_fit_the_interval(file):
    with pytest.raises(InputError, match="at 7 Hz the 0.2 s .* use a multiple of 5 Hz"):
        Surrogate(file, rate=7.0)
    for wrong in ({"rate": 0.0}, {"rate": -5.0}, {"threads": 0}):
        with pytest.raises(InputError, match="must be from"):
            Surrogate(file, **wrong)


def test_out_is_written_and_returned(file, force):
    out = np.empty_like(force[0, 0])
    surrogate, other = Surrogate(file), Surrogate(file)
    assert surrogate.step(force[0, 1], out=out) is out
    np.testing.assert_array_equal(out, other.step(force[0, 1].astype(float)))


@pytest.mark.parametrize(
    "wrong", [np.zeros((4, 5, 3, 3)), np.zeros((5, 5, 3)), np.zeros((5, 5, 3, 3), complex), "push"]
)
def test_wrong_force_is_an_error_that_names_the_shape(file, wrong):
    with pytest.raises(InputError, match=r"give real numbers of shape .* or \(5, 5, 3, 3\)"):
        Surrogate(file).step(wrong)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_force_that_is_not_finite_is_named_and_leaves_the_window_alone(file, force, value):
    surrogate, other = Surrogate(file), Surrogate(file)
    for s in (surrogate, other):
        s.step(force[0, 1])
    bad = force[0, 2].copy()
    bad[1, 2, 0, 1] = value
    with pytest.raises(InputError, match=r"at \(1, 2, 0, 1\)"):
        surrogate.step(bad)
    np.testing.assert_array_equal(surrogate.step(force[0, 2]), other.step(force[0, 2]))


def test_force_beyond_training_sets_the_flag_and_warns_once(file, force):
    surrogate = Surrogate(file)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for field in force.reshape(-1, *force.shape[2:]):  # all of training is inside
            surrogate.step(field)
            assert not surrogate.outside_training_range
    strongest = force.reshape(-1, *force.shape[2:])[
        np.linalg.norm(force.sum((2, 3, 4)), axis=-1).argmax()
    ]
    with pytest.warns(RuntimeWarning, match="leaves the training range"):
        surrogate.step(1.2 * strongest)
    assert surrogate.outside_training_range
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        surrogate.step(1.2 * strongest)
        assert surrogate.outside_training_range
        surrogate.step(strongest)
        assert not surrogate.outside_training_range
    spread = np.full_like(
        strongest, 1.2 * force_size(force)[0] / strongest[..., 0].size
    )  # weak at each node
    with pytest.warns(RuntimeWarning):
        Surrogate(file).step(spread)


def test_volume_is_that_of_the_loss_and_raises_the_alarm(dataset, folder, force):
    wild = Surrogate(
        write(
            folder / "wild.tflite", network(dataset, "cnn_lstm", displacement_scale=20.0), dataset
        )
    )

    def volume(displacement):
        return float(losses.deformed_volume(displacement[None], *dataset.surface)[0])

    assert wild.rest_volume == pytest.approx(volume(np.zeros_like(force[0, 0])), rel=1e-5)
    with pytest.warns(RuntimeWarning, match="predicted volume is off by"):
        displacement = wild.step(force[0, -1])
    expected = volume(displacement)
    assert wild.volume == pytest.approx(expected, rel=1e-4)
    assert wild.volume_alarm and abs(expected / wild.rest_volume - 1) > 0.07
    wild.reset()
    assert not wild.volume_alarm and wild.volume == wild.rest_volume


def test_small_displacements_raise_no_volume_alarm(file, force):
    surrogate = Surrogate(file)
    surrogate.step(np.zeros_like(force[0, 0]))
    assert not surrogate.volume_alarm and not surrogate.outside_training_range


def test_a_surrogate_is_a_stepper_of_a_fixed_interval(file, force):
    assert isinstance(Surrogate(file), Stepper)
    assert Surrogate(file).interval == 0.2 and Surrogate(file, rate=20.0).interval == 0.05
    surrogate, other = Surrogate(file, rate=20.0), Surrogate(file, rate=20.0)
    for s in (surrogate, other):
        s.step(force[0, 1], 0.05)
    with pytest.raises(InputError, match="made for 0.05 s between calls"):
        surrogate.step(force[0, 2], 0.2)
    np.testing.assert_array_equal(surrogate.step(force[0, 2]), other.step(force[0, 2]))


def test_forces_at_the_nodes_give_displacements_at_the_nodes(file, force):
    on_grid, nodal, into = Surrogate(file), Surrogate(file), Surrogate(file)
    out = np.empty((nodal.nodes.n_nodes, 3), "float32")
    for field in force[0]:
        expected = on_grid.nodes.from_grid(on_grid.step(field))
        at_nodes = nodal.nodes.from_grid(field)
        np.testing.assert_array_equal(nodal.step(at_nodes), expected)
        assert into.step(at_nodes, out=out) is out
        np.testing.assert_array_equal(out, expected)


@pytest.mark.parametrize("calls", [0, 1, 5, 14])
def test_a_state_restored_goes_on_exactly(dataset, file, calls):
    fields = np.random.default_rng(1).normal(0, 0.01, (24, *dataset.grid, 3)).astype("float32")
    surrogate, other = Surrogate(file, rate=20.0), Surrogate(file, rate=20.0)
    for field in fields[:calls]:
        surrogate.step(field)
    state = surrogate.state()
    expected = [surrogate.step(field) for field in fields[calls : calls + 10]]
    other.step(fields[-1])
    for s in (surrogate, other):  # the one that gave it, and another
        s.restore(state)
        np.testing.assert_array_equal(s.state()["forces"], state["forces"])
        answers = [s.step(field) for field in fields[calls : calls + 10]]
        np.testing.assert_array_equal(answers, expected)


def test_the_state_of_another_stepper_is_refused(file):
    surrogate = Surrogate(file, rate=20.0)
    alien = {name: values.astype(float) for name, values in surrogate.state().items()}
    for state in (Surrogate(file).state(), alien, {"u": np.zeros(3)}, {}):
        with pytest.raises(InputError, match="is not the state of a surrogate"):
            surrogate.restore(state)


def test_a_force_too_large_for_float32_is_refused_and_leaves_the_window_alone(file, force):
    surrogate, other = Surrogate(file), Surrogate(file)
    with pytest.raises(InputError, match="too large for float32"), np.errstate(over="ignore"):
        surrogate.step(np.full(force[0, 1].shape, 1e300))
    np.testing.assert_array_equal(surrogate.step(force[0, 2]), other.step(force[0, 2]))


def test_other_files_are_refused(tmp_path, model, tiny_dataset):
    bare = tmp_path / "bare.tflite"
    bare.write_bytes(lite.export(model, "float32"))
    for path in (bare, tiny_dataset):
        with pytest.raises(InputError, match="is not a 'unet-fem surrogate 3' file"):
            Surrogate(path)
    with pytest.raises(InputError, match="no surrogate"):
        Surrogate(tmp_path / "none.tflite")


def rewritten(file, path, graph=None, **changes):
    """A copy of the surrogate `file` at `path` with other arrays behind the graph; None leaves one
    out."""
    with open(file, "rb") as whole, np.lib.npyio.NpzFile(whole) as archive:
        arrays = dict(archive) | changes
        start = archive.zip.infolist()[0].header_offset
    with open(path, "wb") as out:
        out.write(file.read_bytes()[:start] if graph is None else graph)
        np.savez(out, **{name: array for name, array in arrays.items() if array is not None})
    return path


def test_the_file_tells_what_the_graph_does_not(dataset, file):
    surrogate = Surrogate(file)
    assert surrogate.label == "tiny: float32"
    assert surrogate.mesh == lite.mesh_digest(dataset) and len(surrogate.mesh) == 16
    index = np.flatnonzero(dataset.mask)
    np.testing.assert_array_equal(surrogate.nodes.index, index)
    np.testing.assert_array_equal(surrogate.points, dataset.points.reshape(-1, 3)[index])


def test_files_of_format_1_still_open_and_take_forces_on_the_grid_alone(file, tmp_path, force):
    old = rewritten(
        file, tmp_path / "old.tflite", format=FORMAT_1, index=None, mesh=None, label=None
    )
    surrogate = Surrogate(old)
    np.testing.assert_array_equal(surrogate.step(force[0, 1]), Surrogate(file).step(force[0, 1]))
    assert surrogate.nodes is None and surrogate.label == "old"
    with pytest.raises(InputError, match="no places of the mesh's nodes .* format 1 .* made again"):
        surrogate.step(np.zeros((75, 3)))


def test_a_mesh_embedded_in_the_grid_takes_forces_on_the_grid_alone(file, tmp_path, force):
    embedded = rewritten(file, tmp_path / "embedded.tflite", index=np.empty(0, int))
    assert Surrogate(embedded).step(force[0, 1]).shape == force[0, 1].shape
    with pytest.raises(InputError, match="no places of the mesh's nodes"):
        Surrogate(embedded).step(np.zeros((75, 3)))


def test_a_format_of_the_future_is_refused(file, tmp_path):
    newer = rewritten(file, tmp_path / "newer.tflite", format="unet-fem surrogate 4")
    with pytest.raises(InputError, match="format: unet-fem surrogate 4"):
        Surrogate(newer)


@pytest.mark.parametrize(
    "change",
    [
        {"index": None},
        {"index": np.array([0, 75])},
        {"index": np.array([0, 0])},
        {"points": np.full((75, 3), np.nan)},
        {"faces": np.array([[0, 1, 2, -1]])},
        {"interval": np.array(0.0)},
        {"largest_force": np.zeros(3)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_arrays_that_do_not_fit_each_other_are_refused(file, tmp_path, change):
    with pytest.raises(InputError, match="is damaged"):
        Surrogate(rewritten(file, tmp_path / "damaged.tflite", **change))


def test_a_graph_that_does_not_load_or_fit_is_refused(file, tmp_path):
    with pytest.raises(InputError, match="its graph is not the one that was written"):
        Surrogate(rewritten(file, tmp_path / "noise.tflite", graph=bytes(1000)))
    other = lite.export(unet((4, 4, 4), 2), "float32")
    with pytest.raises(InputError, match=r"the graph in .* takes \(1, 4, 4, 4, 3\)"):
        Surrogate(rewritten(file, tmp_path / "other.tflite", graph=other, sha256=None))


def test_no_pickle_is_loaded_and_no_array_without_bounds(file, tmp_path, monkeypatch):
    class Trap:
        def __reduce__(self):
            return os.system, ("touch sprung",)

    trap = rewritten(file, tmp_path / "trap.tflite", label=np.array(Trap(), dtype=object))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="is not a"):
        Surrogate(trap)
    assert not Path("sprung").exists()
    monkeypatch.setattr(surrogate_file, "LARGEST", 1000)
    with pytest.raises(InputError, match="MiB of arrays"):
        read_surrogate(file)


def test_a_failed_write_leaves_the_old_file(dataset, file, model, monkeypatch):
    before = file.read_bytes()
    monkeypatch.setattr(os, "fsync", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError):
        write(file, model, dataset)
    assert file.read_bytes() == before
    assert not list(file.parent.glob(".*partial*"))


def python(code, *arguments):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    result = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


BLOCKED = """
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("h5py keras matplotlib meshio psutil scipy tensorflow"
                                      " tf_keras threadpoolctl tqdm").split():
            raise ModuleNotFoundError(f"{name} is blocked")

sys.meta_path.insert(0, Blocker())
"""


def test_the_runtime_needs_numpy_and_litert_alone(file, tiny_dataset):
    code = (
        BLOCKED
        + """
import numpy as np
from fem.errors import InputError
from unet_fem.runtime import Surrogate
from unet_fem.runtime.replay import read_interaction, replay

surrogate = Surrogate(sys.argv[1], rate=100.0)
force = np.zeros((2, *surrogate.grid, 3), "float32")
assert surrogate.step(force[0]).shape == (*surrogate.grid, 3)
assert replay(surrogate, force, np.array([0.0, 0.1]))["took"].shape == (11,)
try:
    read_interaction(sys.argv[2])
except InputError as error:
    print("unet-fem[fem]" in str(error))
"""
    )
    assert python(code, file, tiny_dataset) == ["True"]


@pytest.mark.timing
def test_import_is_light():
    code = """
import time
start = time.process_time()
from unet_fem.runtime import Surrogate
print(time.process_time() - start)
"""
    assert min(float(python(code)[0]) for _ in range(3)) < 0.5


def test_thousands_of_steps_do_not_grow(file):
    code = """
import os, sys, tracemalloc
import numpy as np
from unet_fem.runtime import Surrogate
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
surrogate = Surrogate(sys.argv[1], rate=1000.0)
force = np.random.default_rng(0).normal(0, 1e-3, (*surrogate.grid, 3)).astype("float32")
out = np.empty_like(force)
def soak(count):
    for _ in range(count):
        surrogate.step(force, out=out)
soak(1000)
before = resident()
soak(5000)
print(resident() - before)
tracemalloc.start()
soak(10)
tracemalloc.reset_peak()
held = tracemalloc.get_traced_memory()[0]
soak(100)
print(tracemalloc.get_traced_memory()[1] - held)
"""
    if not Path("/proc/self/statm").exists():
        pytest.skip("needs /proc")
    grown, allocated = map(int, python(code, file))
    assert grown < 300_000
    assert allocated < 5_000  # array headers only: no copy of a field is made
