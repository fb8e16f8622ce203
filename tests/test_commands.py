"""`--help` and the refusals of every command come at once: without TensorFlow, Keras and
Matplotlib."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HEAVY = "tensorflow keras tf_keras matplotlib"
# A command: its name, and words that it refuses, each with a part of what it then says.
COMMANDS = {
    "fem.generate": [
        (["none.toml"], "none.toml"),
        (["configs/quick.toml"], "error: "),
        (["configs/tumour.toml", "--workers", "0"], "--workers 0"),
    ],
    "fem.reduce": [
        (["none.h5"], "none.h5"),
        (["none.h5", "--points", "0"], "points = 0"),
        (["none.h5", "--inputs", "400"], "inputs = 400"),
        (["none.h5", "--judge", "none.npz", "--interval", "0"], "--interval 0"),
    ],
    "unet_fem.train": [
        (["none.toml"], "none.toml"),
        (["scene=none.toml", "name=nothing"], "none.toml"),
        (["model.mods=3"], "model.modes"),
        (["a.toml", "b.toml"], "one configuration file"),
        (["model.kind=cnn"], "cnn_lstm"),
    ],
    "unet_fem.evaluate": [(["runs/none"], "runs/none")],
    "unet_fem.runtime": [
        (["none.tflite", "none.h5"], "none"),
        (["none.tflite", "none.h5", "--rate", "0"], "error: "),
    ],
    "tools/ablation.py": [
        (["--seeds", "-1"], "--seeds"),
        (["--threads", "0"], "--threads 0"),
        (["epochs"], "'epochs' is no key=value"),
    ],
    "tools/benchmark.py": [(["runs/none"], "runs/none")],
    "tools/benchmark_fem.py": [],
    "tools/constitutive.py": [
        (["none.h5", "none.tflite"], "none.h5"),
        (["none.h5", "none.tflite", "--first", "0"], "--first = 0"),
        (["none.h5", "none.tflite", "--interval", "0"], "--interval = 0"),
    ],
    "tools/draw_contacts.py": [(["none.toml", "a.png"], "none.toml")],
    "tools/export.py": [(["none.h5", "out"], "none.h5")],
    "tools/force_ranges.py": [
        (["none.toml"], "none.toml"),
        (["a.toml", "--usual", "0"], "--usual 0"),
    ],
    "tools/identify.py": [
        (["none.npz", "none.csv", "--position", "0", "0", "0"], "none.csv"),
        (["none.npz", "a.csv", "--position", "0", "0", "0", "--terms", "9"], "--terms = 9"),
    ],
    "tools/learning_curve.py": [
        (["none.h5", "--judge", "none.h5"], "none.h5"),
        (["none.h5", "--judge", "none.h5", "--sizes", "0"], "--sizes 0"),
    ],
    "tools/make_lobe.py": [],
    "tools/modal.py": [
        (["none.h5", "none.npz", "out.tflite"], "none.h5"),
        (["none.h5", "none.npz", "out.tflite", "--width", "0"], "--width 0"),
    ],
    "tools/press.py": [
        (["none.h5", "none.npz"], "none.h5"),
        (["none.h5", "none.npz", "--depth", "0"], "--depth = 0"),
    ],
    "tools/prune.py": [(["runs/none"], "runs/none"), (["runs/none", "--sparsity", "2"], "2")],
    "tools/quantize.py": [(["runs/none"], "runs/none")],
    "tools/readings.py": [
        (["--readings", "D"], "--readings D"),
        (["--readings", "C"], "--many SCENE DATA"),
        (["epochs", "--readings", "A"], "'epochs' is no key=value"),
    ],
    "tools/report.py": [
        (["none.toml"], "none.toml"),
        (["--again", "nothing"], "nothing"),
        (["configs/study.toml", "--quick"], "not both"),
    ],
    "tools/stability.py": [(["--only", "nothing"], "nothing")],
    "tools/tissues.py": [
        (["none.h5", "none.tflite"], "none.tflite"),
        (["none.h5", "none.tflite", "--hard", "-1"], "--hard -1"),
    ],
    "tools/void_layer.py": [(["none.h5"], "none.h5"), (["none.h5", "--seeds", "0"], "--seeds 0")],
}

DRIVER = """
import contextlib, io, json, runpy, sys
name, cases, heavy = sys.argv[1], json.loads(sys.argv[2]), sys.argv[3].split()
found = []
for words in cases:
    sys.argv = [name, *words]
    with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(said):
        try:
            if name.endswith(".py"):
                sys.path.insert(0, "tools")
                runpy.run_path(name, run_name="__main__")
            else:
                runpy.run_module(name, run_name="__main__", alter_sys=True)
            code = 0
        except SystemExit as end:
            code = end.code
    present = [module for module in heavy if module in sys.modules]
    found.append([code, said.getvalue(), present])
print(json.dumps(found))
"""


def test_every_command_is_here():
    tools = {f"tools/{path.name}" for path in (ROOT / "tools").glob("*.py")}
    commands = {name for name in tools if "__main__" in (ROOT / name).read_text()}
    commands |= {"fem.generate", "fem.reduce"}
    commands |= {"unet_fem.train", "unet_fem.evaluate", "unet_fem.runtime"}
    assert commands == COMMANDS.keys()


@pytest.mark.parametrize("name", COMMANDS)
def test_help_and_refusals_load_no_heavy_library(name, tmp_path):
    """They are read where nothing is, so that a command refuses for want of its input."""
    (tmp_path / "tools").symlink_to(ROOT / "tools")
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    cases = [(["--help"], "usage: "), *COMMANDS[name]]
    words = json.dumps([words for words, _ in cases])
    run = subprocess.run(
        [sys.executable, "-c", DRIVER, name, words, HEAVY],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert not run.returncode, run.stderr
    for (words, part), (code, said, present) in zip(cases, json.loads(run.stdout), strict=True):
        assert code == (0 if words == ["--help"] else 2), (words, said)
        assert part in said
        assert words == ["--help"] or len(said.strip().splitlines()) == 1, said
        assert present == [], words
    left = {path.name for path in tmp_path.iterdir()} - {"tools", "configs"}
    assert not left  # a refusal leaves nothing behind


@pytest.mark.timing
@pytest.mark.parametrize("name", COMMANDS)
def test_help_takes_less_than_a_second(name):
    how = [name] if name.endswith(".py") else ["-m", name]
    spent = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *how, "--help"], cwd=ROOT, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(spent) < 1
