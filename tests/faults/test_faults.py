"""Faults from outside: processes killed at random moments, a file system that fills, folders that
may not be written to, a clock that jumps. What is there afterwards is whole, and the same command
then ends with the same results.

    pytest tests/faults -m "slow or not slow"      trainings, exports and a study too
"""

import contextlib
import errno
import importlib
import json
import os
import random
import runpy
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import psutil
import pytest

from fem.data.dataset import open_dataset
from fem.locks import lock

ROOT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "TF_CPP_MIN_LOG_LEVEL": "3"}
RUN = """
name = "net"
scene = "tiny.toml"
data = "tiny.h5"
[model]
{model}
[train]
epochs = 3
"""


def start(folder, *words, **options):
    """A command of the project in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        **options,
    )


def run(folder, *words, code=0, **options):
    """What a command says that ends with `code`; a refusal is one line."""
    process = start(folder, *words, **options)
    said = process.communicate(timeout=1800)[0]
    assert process.returncode == code, said[-3000:]
    assert code == 0 or said.splitlines()[-1].startswith("error: "), said[-3000:]
    return said


def killed(folder, *words, after):
    """Whether a command was still at work when it was killed `after` seconds from its start. Its
    workers end with it."""
    process = start(folder, *words)
    time.sleep(after)
    children = psutil.Process(process.pid).children(recursive=True)
    working = process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not psutil.wait_procs(children, timeout=20)[1]
    return working


def survives(folder, words, times, seed):
    """Run a command that is killed `times` times at random moments, each a share of what the whole
    takes, and then to its end. Returns how often it was at work when it was killed, at least
    once: where it was done already, as on a machine that was busier before, it begins anew."""
    rng, hits = random.Random(seed), 0
    aside, before = (folder.with_name(f"{folder.name}_{name}") for name in ("aside", "before"))
    for copy in (aside, before):
        shutil.copytree(folder, copy, symlinks=True)
    began = time.monotonic()
    run(aside, *words)
    whole = time.monotonic() - began
    while hits < times:
        if killed(folder, *words, after=rng.uniform(0.3, 0.9) * whole):
            hits += 1
        elif hits:
            break  # what was kept left too little to do
        else:
            shutil.rmtree(folder)
            shutil.copytree(before, folder, symlinks=True)
            whole /= 2
    with suppress_finished():
        run(folder, *words)
    return hits, aside


@contextlib.contextmanager
def suppress_finished():
    """A training that was killed after its last line is finished, and says so."""
    try:
        yield
    except AssertionError as error:
        if "is finished" not in str(error):
            raise


def contents(path):
    """Every array of an HDF5 file, as bytes by name."""
    found = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = item[()].tobytes()

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def leftovers(folder):
    """Files under `folder` that nothing is to leave behind: partial ones, waiting ones and locks of
    processes that have ended in order."""
    return [path for path in folder.rglob(".*") if path.name != ".cache"]


@pytest.fixture
def folder(tiny_dataset, tmp_path):
    """A folder with the scene of the tiny dataset."""
    (tmp_path / "here").mkdir()
    scene = open_dataset(tiny_dataset).scene
    (tmp_path / "here/tiny.toml").write_text(scene.toml())
    return tmp_path / "here"


@pytest.fixture
def trained(folder, tiny_dataset):
    """The same with its dataset and the settings of a network."""
    shutil.copy(tiny_dataset, folder / "tiny.h5")
    (folder / "net.toml").write_text(RUN.format(model="units = 4"))
    return folder


def test_a_generator_killed_at_random_moments_ends_with_the_same_data(folder, tiny_dataset):
    words = "-m", "fem.generate", "tiny.toml", "--out", "out.h5", "--workers", "2"
    rng, hits = random.Random(1), 0
    for _ in range(3):
        hits += killed(folder, *words, after=rng.uniform(0.5, 3))
    if not (folder / "out.h5").is_file():
        run(folder, *words)
    assert hits and contents(folder / "out.h5") == contents(tiny_dataset)
    assert [path.name for path in leftovers(folder)] in ([], [".out.h5.lock"])


def apart(folder, script):
    """What a script says whose file systems are its own: it may mount some."""
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")
    words = ["unshare", "-rm", sys.executable, "-c", MOUNTED + script]
    process = subprocess.run(words, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    assert process.returncode == 0 and "Traceback" not in process.stderr, process.stderr[-3000:]
    errors = [line for line in process.stderr.splitlines() if line.startswith("error: ")]
    return json.loads(process.stdout.splitlines()[-1]), errors


MOUNTED = """
import importlib, json, runpy, subprocess
from pathlib import Path
def mount(*words):
    subprocess.run(["mount", *words], check=True)
def code(name, *words):
    load = importlib.import_module if name[:6] != "tools/" else runpy.run_path
    found = load(name)
    try:
        (found["main"] if isinstance(found, dict) else found.main)(list(words))
    except SystemExit as end:
        return end.code
    return 0
"""

FULL = """
mount("-t", "tmpfs", "-o", "size=8k", "none", "disk")
found = []
for size in ("8k", "32k", "64k", "8m"):
    mount("-o", f"remount,size={size}", "disk")
    ended = code("fem.generate", "tiny.toml", "--out", "disk/out.h5", "--workers", "1")
    found.append((ended, [str(path) for path in Path("disk").rglob("*")]))
Path("out.h5").write_bytes(Path("disk/out.h5").read_bytes())
print(json.dumps(found))
"""


def test_a_file_system_that_fills_stops_a_generator_in_one_line(folder, tiny_dataset):
    """It grows from try to try: each time one line that says what is kept, nothing half-written,
    and at last the same data."""
    (folder / "disk").mkdir()
    found, errors = apart(folder, FULL)
    assert [ended for ended, _ in found] == [2, 2, 2, 0]
    assert len(errors) == 3 and all("make room there" in line for line in errors)
    assert "2 of 4 interactions are kept" in errors[1]
    assert not [path for _, there in found for path in there if "partial" in path]
    assert found[-1][1] == ["disk/out.h5"]
    assert contents(folder / "out.h5") == contents(tiny_dataset)


READ_ONLY = """
for name in ("shut", "runs"):
    mount("--bind", name, name)
    mount("-o", "remount,ro,bind", name)
print(json.dumps([code(*words) for words in (
    ("fem.generate", "tiny.toml", "--out", "shut/out.h5"),
    ("fem.generate", "tiny.toml", "--out", "shut/new/out.h5"),
    ("fem.reduce", "tiny.h5", "--out", "shut/reduced.npz"),
    ("tools/make_lobe.py", "shut/lobe.vtu"),
    ("tools/export.py", "tiny.h5", "shut/out"),
    ("unet_fem.train", "lin.toml"),
    ("unet_fem.evaluate", "runs/net"),
    ("tools/quantize.py", "runs/net"),
)]))
"""


@pytest.fixture
def begun(trained):
    """A folder with the runs net, a network without its weights, and lin, which is not begun."""
    (trained / "tools").symlink_to(ROOT / "tools")
    text = RUN.format(model='kind = "linear"').replace('"net"', '"lin"')
    (trained / "lin.toml").write_text(text.split("[train]")[0])
    (trained / "runs/net").mkdir(parents=True)
    (trained / "runs/net/config.toml").write_text((trained / "net.toml").read_text())
    mesh = open_dataset(trained / "tiny.h5").mesh_digest
    (trained / "runs/net/mesh.sha256").write_text(mesh)
    (trained / "runs/net/best.keras").write_text("")
    return trained


TWO = {
    "out.h5": ["-m fem.generate tiny.toml --out out.h5"],
    "out.npz": ["-m fem.reduce tiny.h5 --out out.npz"],
    "runs/lin": ["-m unet_fem.train lin.toml"],
    "runs/net": [
        "-m unet_fem.train net.toml",
        "-m unet_fem.evaluate runs/net",
        "-m unet_fem.evaluate ./runs/../runs/net/",
        "tools/quantize.py runs/net",
        "tools/prune.py runs/net",
    ],
    "runs/study_quick": ["tools/report.py --quick"],
}


def test_who_is_second_is_refused_with_the_number_of_the_first(begun, monkeypatch, capsys):
    """Every command that writes to an output or a run, while another process does; and nothing has
    changed then."""
    monkeypatch.chdir(begun)
    (begun / "configs").symlink_to(ROOT / "configs")
    before = sorted(begun.rglob("*"))
    for path, commands in TWO.items():
        for command in commands:
            name, *words = command.removeprefix("-m ").split()
            found = runpy.run_path(name) if "/" in name else vars(importlib.import_module(name))
            with lock(path), pytest.raises(SystemExit) as end:
                found["main"](words)
            said = capsys.readouterr().err
            assert end.value.code == 2 and f"is being written by process {os.getpid()}" in said
            assert said.count("\n") == 1 and path.split("/")[-1] in said, said
    assert [path for path in sorted(begun.rglob("*")) if path not in before] == []


def test_folders_that_may_not_be_written_to_are_refused_before_any_work(begun):
    (begun / "shut").mkdir()
    before = sorted(begun.rglob("*"))
    codes, errors = apart(begun, READ_ONLY)
    assert codes == [2] * 8
    for line, named in zip(errors, ["shut"] * 5 + ["runs"] * 3, strict=True):
        assert named in line and os.strerror(errno.EROFS) in line or "nothing may be" in line, line
    assert sorted(begun.rglob("*")) == before


CLOCK = """
import random, sys, time
rng, real, jump = random.Random(3), time.time, [0.0]
def jumping():
    jump[0] = rng.choice([0, 0, 0, -1e6, 1e6, -3600, 1e9, -1e9])
    return real() + jump[0]
time.time = jumping
from fem.generate import main
main(["tiny.toml", "--out", "out.h5", "--workers", "1"])
if len(sys.argv) > 1:
    from unet_fem.train import main
    main(["net.toml"])
"""


def test_a_clock_that_jumps_changes_nothing(folder, tiny_dataset):
    """An hour, a day and thirty years to and fro, at every look."""
    run(folder, "-c", CLOCK)
    assert contents(folder / "out.h5") == contents(tiny_dataset)


def judged(folder):
    return json.loads((folder / "runs/net/metrics.json").read_text())


@pytest.mark.slow
def test_a_clock_that_jumps_does_not_disturb_a_training(trained):
    run(trained, "-c", CLOCK, "train")
    aside = trained.with_name("aside")
    aside.mkdir()
    for name in ("tiny.toml", "tiny.h5", "net.toml"):
        shutil.copy(trained / name, aside)
    run(aside, "-m", "unet_fem.train", "net.toml")
    assert judged(trained) == judged(aside)


@pytest.mark.slow
def test_a_training_killed_at_random_moments_ends_with_the_same_network(trained):
    hits, aside = survives(trained, ("-m", "unet_fem.train", "net.toml"), 4, seed=2)
    assert hits >= 1
    for part in ("validation", "test"):
        same, again = (judged(one)["cnn_lstm"][part]["relative_l2"] for one in (aside, trained))
        assert again == pytest.approx(same, rel=1e-5)


@pytest.mark.slow
def test_an_export_killed_at_random_moments_ends_with_the_same_files(trained):
    (trained / "tools").symlink_to(ROOT / "tools")
    run(trained, "-m", "unet_fem.train", "net.toml")
    hits, aside = survives(trained, ("tools/quantize.py", "runs/net"), 3, seed=3)
    assert hits >= 1
    same, again = (
        json.loads((one / "runs/net/quantization.json").read_text()) for one in (aside, trained)
    )
    assert again == same
    for path in (aside / "runs/net/lite").iterdir():
        assert (trained / "runs/net/lite" / path.name).stat().st_size == path.stat().st_size


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [1, 20, 200])
def test_a_disk_that_fills_stops_training_and_export_in_one_line(trained, blocks):
    """No file may grow beyond some KiB; without that limit the same command ends."""
    (trained / "tools").symlink_to(ROOT / "tools")
    for words, done in (
        (("-m", "unet_fem.train", "net.toml"), "runs/net/metrics.json"),
        (("tools/quantize.py", "runs/net"), "runs/net/quantization.json"),
    ):
        limited = ["-c", LIMITED, str(1024 * blocks), *words]
        process = start(trained, *limited)
        said = process.communicate()[0]
        assert process.returncode in (0, 2) and "Traceback" not in said, said[-2000:]
        assert (process.returncode == 0) == (trained / done).is_file()
        assert not [path for path in trained.rglob("*") if "partial" in path.name]
        if process.returncode:
            run(trained, *words)


LIMITED = """
import resource, runpy, sys
size, *words = sys.argv[1:]
resource.setrlimit(resource.RLIMIT_FSIZE, (int(size), int(size)))
name, sys.argv = words[-2], words[-2:]
if words[0] == "-m":
    runpy.run_module(name, run_name="__main__")
else:
    runpy.run_path(name, run_name="__main__")
"""
