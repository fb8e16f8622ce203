"""Generation: the same data whatever the workers and interruptions, whole files only, and errors of
one line."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import h5py
import numpy as np
import pytest

import fem.generate
from fem import settings as config
from fem.data import build
from fem.data.build import generate
from fem.data.scene import Scene
from fem.errors import InputError
from fem.generate import main
from fem.locks import lock

SLOW = {"frames": {"count": 3, "interval": 0.6}, "health": {"min_J": 0.15}}


def contents(path):
    """{name: array or attribute} of everything in an HDF5 file."""
    found = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = item[()]
        found.update({f"{name}@{key}": value for key, value in item.attrs.items()})

    with h5py.File(path) as file:
        file.visititems(visit)
        return found | dict(file.attrs)


def assert_same(a, b):
    a, b = contents(a), contents(b)
    assert a.keys() == b.keys() and len(a) > 20
    for name in a:
        assert np.array_equal(a[name], b[name]), name


def write_scene(folder, tree):
    path = folder / "scene.toml"
    path.write_text(config.dump_toml(tree))
    return path


def command(*words):
    """`python -m fem.generate`, as the leader of a process group of its own, which hears Ctrl-C
    also where the tests run in the background and are deaf to it."""
    return subprocess.Popen(
        [sys.executable, "-m", "fem.generate", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def test_one_worker_and_two_give_the_same_file(tiny, tiny_dataset, tmp_path):
    """The data are the same to the bit with one process and with two, rejected draws included."""
    path = tmp_path / "one.h5"
    rejected = generate(config.build(Scene, tiny), path, workers=1)
    assert_same(path, tiny_dataset)
    assert sum(rejected.values()) > 0
    assert [item.name for item in tmp_path.iterdir()] == ["one.h5"]


def test_a_killed_run_goes_on_and_ends_with_the_same_data(tiny, tmp_path):
    """Killed half way nothing is at the final path; the same command then ends with the data of an
    undisturbed run."""
    tree = config.merge(tiny, SLOW)
    scene, out = write_scene(tmp_path, tree), tmp_path / "killed" / "out.h5"
    process = command(scene, "--out", out, "--workers", 1)
    deadline = time.monotonic() + 60
    while (
        not list(tmp_path.glob("killed/.out.h5.*.parts/[!.]*.npz")) and time.monotonic() < deadline
    ):
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    finished = {
        part.name: part.stat().st_mtime_ns
        for part in tmp_path.glob("killed/.out.h5.*.parts/[!.]*.npz")
    }
    assert 1 <= len(finished) < 4 and not out.exists()
    resumed = command(scene, "--out", out, "--workers", 1)
    stdout, stderr = resumed.communicate(timeout=120)
    assert resumed.returncode == 0 and f"{len(finished)}/4" in stderr, stderr
    assert [item.name for item in out.parent.iterdir()] == ["out.h5"]
    generate(config.build(Scene, tree), tmp_path / "undisturbed.h5", workers=2)
    assert_same(out, tmp_path / "undisturbed.h5")


def test_an_interrupted_run_says_how_to_go_on(tiny, tmp_path):
    """Ctrl-C ends with code 130, the number of interactions that are kept, and the remedy."""
    scene, out = write_scene(tmp_path, config.merge(tiny, SLOW)), tmp_path / "out.h5"
    process = command(scene, "--out", out, "--workers", 1)
    while not list(tmp_path.glob(".out.h5.*.parts/[!.]*.npz")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGINT)
    stderr = process.communicate(timeout=60)[1]
    kept = len(list(tmp_path.glob(".out.h5.*.parts/[!.]*.npz")))
    assert process.returncode == 130 and not out.exists()
    assert stderr.strip().splitlines()[-1] == (
        f"interrupted; {kept} of 4 interactions are kept; run the same command again to go on"
    )


def test_two_generators_of_one_output_do_not_meet(tiny, tmp_path):
    """While one writes, another is refused at once, with the first one's number."""
    scene, path = config.build(Scene, tiny), tmp_path / "out.h5"
    with lock(path), pytest.raises(InputError, match=f"written by process {os.getpid()} since"):
        generate(scene, path, workers=1)
    assert not list(tmp_path.iterdir())


def stopped_while_writing(scene, path, monkeypatch):
    """Leave the parts of `scene` waiting for `path`; their folder."""

    def full_disk(*arguments):
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("fem.data.build.write_dataset", full_disk)
        with pytest.raises(OSError, match="no space"):
            generate(scene, path, workers=1)
    (folder,) = path.parent.glob(f".{path.name}.*.parts")
    return folder


def spoil(folder):
    """Make the volume in a waiting part 12345."""
    part = folder / "validation-0001.npz"
    fields = dict(np.load(part))
    np.savez(part, **fields | {"volume": fields["volume"] * 0 + 12345})


def test_finished_interactions_are_not_simulated_again(tiny, tmp_path, monkeypatch):
    """After a failure while writing, the next run takes the finished interactions as they are."""
    scene, path = config.build(Scene, tiny), tmp_path / "out.h5"
    spoil(stopped_while_writing(scene, path, monkeypatch))
    generate(scene, path, workers=1)
    with h5py.File(path) as file:
        assert np.all(file["volume"][2] == 12345) and np.all(file["volume"][0] < 100)


def test_parts_of_older_code_or_another_scene_are_not_taken(
    tiny, tiny_dataset, tmp_path, monkeypatch
):
    """A changed scene or a raised version starts afresh; the stale parts go at the end, those of
    other outputs stay."""
    scene, path = config.build(Scene, tiny), tmp_path / "out.h5"
    folder = stopped_while_writing(scene, path, monkeypatch)
    spoil(folder)
    stale = folder.with_name(".out.h5.0123456789abcdef.parts")
    folder.rename(stale)
    others = [".out.h5.more.0123456789abcdef.parts", ".other.h5.0123456789abcdef.parts"]
    for name in others:
        (tmp_path / name).mkdir()
    generate(scene, path, workers=1)
    assert_same(path, tiny_dataset)
    assert sorted(item.name for item in tmp_path.iterdir()) == sorted([*others, "out.h5"])


def test_the_key_of_parts_sees_scene_mesh_and_version(tiny, tmp_path, monkeypatch):
    """Another setting, another content of the mesh file or a raised version: another folder."""
    scene, path = config.build(Scene, tiny), tmp_path / "out.h5"
    mesh = scene.mesh.build()
    other = config.build(Scene, config.merge(tiny, {"material": {"mu": 401.0}}))
    moved = replace(mesh, points=mesh.points * (1 + 1e-15))
    held = replace(mesh, fixed=~mesh.fixed)
    folders = {
        build._waiting(path, *which)
        for which in ((scene, mesh), (other, mesh), (scene, moved), (scene, held))
    }
    assert build._waiting(path, scene, scene.mesh.build()) in folders
    monkeypatch.setattr(build, "SIMULATION_VERSION", build.SIMULATION_VERSION + 1)
    assert len(folders | {build._waiting(path, scene, mesh)}) == 5


def test_an_executor_of_the_user_gives_the_same_file(tiny, tiny_dataset, tmp_path):
    """Threads of the user's own simulate without a file of their own; the executor stays open."""
    with ThreadPoolExecutor(2) as executor:
        fem.generate(config.build(Scene, tiny), tmp_path / "out.h5", executor=executor)
        assert executor.submit(abs, -1).result() == 1
    assert_same(tmp_path / "out.h5", tiny_dataset)


def test_scene_without_fit_draws_ends_the_run_in_one_line(tiny, tmp_path, capsys):
    """When every draw is unfit the command line ends with code 2, one line, and no file."""
    scene = write_scene(
        tmp_path,
        config.merge(tiny, {"health": {"min_J": 0.999}, "frames": {"count": 2, "interval": 0.1}}),
    )
    with pytest.raises(SystemExit) as exit:
        main([str(scene), "--out", str(tmp_path / "out.h5"), "--workers", "1"])
    assert exit.value.code == 2 and not (tmp_path / "out.h5").exists()
    assert "error: train interaction 1 was unfit in all 20 draws" in capsys.readouterr().err


@pytest.mark.parametrize(
    "change, message",
    [
        ({"materiel": {}}, "unknown key 'materiel'; the nearest valid one is 'material'"),
        ({"material": {"nu": -0.2}}, "material.nu = -0.2"),
        ({"material": {"nu": 0.5}}, "material.nu = 0.5"),
        ({"material": {"mu": "soft"}}, "material.mu = 'soft'"),
        ({"mesh": {"cells": [0, 4, 4]}}, "cells"),
        ({"solver": {"safety": 0.0}}, "solver.safety = 0.0"),
        ({"contact": {"force": [2.0, 1.0]}}, "contact.force"),
    ],
)
def test_bad_scene_ends_with_code_2(change, message, tiny, tmp_path, capsys):
    """A wrong key or value ends the command line with code 2 and one line that names it, before any
    simulation."""
    scene = write_scene(tmp_path, config.merge(tiny, change))
    with pytest.raises(SystemExit) as exit:
        main([str(scene), "--out", str(tmp_path / "out.h5")])
    error = capsys.readouterr().err
    assert (
        exit.value.code == 2
        and error.startswith("error: ")
        and message in error
        and error.count("\n") == 1
    )
    assert [item.name for item in tmp_path.iterdir()] == ["scene.toml"]


def test_missing_scene_ends_without_traceback(tmp_path):
    """As a process of its own: code 2, one line on stderr, nothing on stdout."""
    process = command(tmp_path / "missing.toml")
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 2 and stdout == ""
    assert stderr.startswith("error: no configuration file") and stderr.count("\n") == 1


def test_existing_files_are_not_overwritten(tiny, tmp_path, capsys):
    """An output that exists, or less than one worker, is refused before any work."""
    scene, out = write_scene(tmp_path, tiny), tmp_path / "out.h5"
    out.write_text("precious")
    for words in ([], ["--workers", "0"]):
        with pytest.raises(SystemExit) as exit:
            main([str(scene), "--out", str(out), *words])
        assert exit.value.code == 2
    assert "exists already" in capsys.readouterr().err and out.read_text() == "precious"


def test_scene_that_no_worker_could_start_is_refused_at_once(tiny, tmp_path):
    """A scene whose solver cannot be built fails before parts are made."""
    scene = config.build(Scene, config.merge(tiny, {"mesh": {"cells": [1, 1, 1]}}))
    with pytest.raises(InputError, match="every node"):
        generate(scene, tmp_path / "out.h5")
    assert not list(tmp_path.iterdir())


def test_an_output_that_cannot_be_written_is_refused_before_simulating(tiny, tmp_path):
    """A folder, or a file where a folder should be."""
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file" / "out.h5"):
        with pytest.raises(InputError, match="is a folder|cannot be written"):
            generate(config.build(Scene, tiny), path, workers=1)
    assert [item.name for item in tmp_path.iterdir()] == ["file"]


def test_fem_imports_no_network_library():
    """Importing every module of fem loads neither TensorFlow nor Keras nor Torch."""
    code = (
        "import importlib, pkgutil, sys, fem\n"
        "for module in pkgutil.walk_packages(fem.__path__, 'fem.'):\n"
        "    importlib.import_module(module.name)\n"
        "heavy = {'tensorflow', 'keras', 'tf_keras', 'torch', 'jax', 'unet_fem'}\n"
        "print(*sorted(heavy & {name.split('.')[0] for name in sys.modules}))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert (result.returncode, result.stdout) == (0, "\n"), result.stderr
