"""What the deployment commands refuse, and that they do so before TensorFlow is imported."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fem.data.dataset import open_dataset
from unet_fem.training.run import MESH

ROOT = Path(__file__).parents[2]
BLOCKED = """
import os, runpy, sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("tensorflow", "keras", "tf_keras", "ai_edge_litert"):
            raise RuntimeError(f"{name} must not be imported here")

sys.meta_path.insert(0, Blocker())
before = dict(os.environ)
main = runpy.run_path(sys.argv[1])["main"]
assert dict(os.environ) == before
main(sys.argv[2:])
"""


def without_tensorflow(tool, *arguments, cwd=None):
    """(exit code, output, errors) of a tool in a process that cannot import TensorFlow."""
    result = subprocess.run(
        [sys.executable, "-c", BLOCKED, str(ROOT / "tools" / tool), *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    return result.returncode, result.stdout, result.stderr


@pytest.mark.parametrize("tool", ["quantize.py", "prune.py", "benchmark.py"])
def test_help_and_refusals_do_not_wait_for_tensorflow(tool, tiny_dataset, tmp_path):
    code, out, _ = without_tensorflow(tool, "--help")
    assert code == 0 and f"usage: python tools/{tool}" in out
    code, _, err = without_tensorflow(tool, "runs/none", cwd=tmp_path)
    assert code == 2 and "is not a training run" in err
    run = tmp_path / "runs/tiny"
    run.mkdir(parents=True)
    (run / "config.toml").write_text(
        f'name = "tiny"\nscene = "x"\ndata = "{tiny_dataset}"\n[train]\nepochs = 1\n'
    )
    (run / MESH).write_text(open_dataset(tiny_dataset).mesh_digest)
    code, _, err = without_tensorflow(tool, "runs/tiny", cwd=tmp_path)
    assert code == 2 and "no model runs/tiny/best.keras" in err


@pytest.mark.parametrize(
    "tool, arguments, words",
    [
        ("quantize.py", ["--windows", 1], "--windows 1 must be at least 2"),
        ("quantize.py", ["--margin", 0.5], "--margin 0.5 at least 1"),
        ("prune.py", ["--sparsity", 1.5], "--sparsity [1.5] must lie between 0 and 1"),
        ("benchmark.py", ["--rounds", 0], "--rounds 0"),
    ],
)
def test_wrong_options_are_named(tool, arguments, words):
    code, _, err = without_tensorflow(tool, "runs/none", *arguments)
    assert code == 2 and words in err


def test_benchmark_asks_for_the_files_that_it_times(tiny_dataset, tmp_path):
    run = tmp_path / "runs/tiny"
    run.mkdir(parents=True)
    (run / "config.toml").write_text(
        f'name = "tiny"\nscene = "x"\ndata = "{tiny_dataset}"\n[train]\nepochs = 1\n'
    )
    (run / MESH).write_text(open_dataset(tiny_dataset).mesh_digest)
    (run / "best.keras").touch()
    code, _, err = without_tensorflow("benchmark.py", "runs/tiny", cwd=tmp_path)
    assert code == 2 and "holds no .tflite files; make them with python tools/quantize.py" in err
