"""The whole study in small: from configurations to the page with its figures, once, and then again
from what is there."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from fem.errors import InputError
from unet_fem.study.measure.points import against_fem, pareto
from unet_fem.study.report import page as results_page
from unet_fem.study.settings import load_study
from unet_fem.study.stages import STAGES

ROOT = Path(__file__).parents[3]


def report(folder, *words):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, "tools/report.py", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder like the project's, with nothing trained or measured in it."""
    folder = tmp_path_factory.mktemp("study")
    for name in ("configs", "tools"):
        (folder / name).symlink_to(ROOT / name)
    return folder


@pytest.mark.slow
def test_one_command_makes_the_page_and_the_next_one_uses_what_is_there(folder, monkeypatch, capfd):
    first = report(folder, "--quick")
    assert first.returncode == 0, first.stdout[-3000:] + first.stderr[-3000:]
    page = folder / "runs/study_quick/results.md"
    text = page.read_text()
    pictures = re.findall(r"\]\((results/[^)]+\.(?:png|gif))\)", text)
    assert len(pictures) > 8 and all(
        (page.parent / name).stat().st_size > 2000 for name in pictures
    )
    assert not re.search(r"\bnan\b|\bNone\b|\binf\b", text)
    assert all((page.parent / f"results/{stage}.json").is_file() for stage in STAGES)
    assert "tiny_unet: int8" in text and "FEM full" in text
    weights = folder / "runs/tiny/best.keras"
    before = weights.stat().st_mtime_ns
    # again, here: without the figures, which are the same
    tool = runpy.run_path(str(ROOT / "tools/report.py"))
    monkeypatch.chdir(folder)
    monkeypatch.delenv("UNET_FEM_CACHE", raising=False)
    monkeypatch.setattr(results_page, "figures", lambda *stages: {})
    monkeypatch.setattr(results_page.paper_figures, "animate", lambda *stages: None)
    tool["main"](["--quick"])
    printed = capfd.readouterr().out
    assert "wrote" in printed and "measuring" not in printed and "training" not in printed
    assert weights.stat().st_mtime_ns == before and page.read_text() == text


def test_what_it_cannot_do_is_one_line_with_the_remedy(folder):
    for words, remedy in (
        (("--quick", "configs/study.toml"), "not both"),
        (("--again", "errors"), "accuracy"),
        (("--draw",), "without --draw"),
    ):
        found = report(folder, *words)
        assert found.returncode == 2 and remedy in found.stderr and found.stderr.count("\n") == 1, (
            found.stderr
        )


def test_a_study_names_only_its_own_networks():
    with pytest.raises(InputError, match="run 'other' is not among the networks"):
        load_study(
            ROOT / "configs/study_quick.toml",
            ['main=[{label = "other", run = "other"}]', "order=[]"],
        )


@pytest.mark.parametrize(
    ("change", "remedy"),
    [
        ("main=[]", "main = .. is empty"),
        (
            'main=[{label = "A", run = "tiny"}, {label = "A", run = "tiny_unet"}]',
            "must differ from each other",
        ),
        ('main=[{label = "linear regression", run = "tiny"}]', "and from linear regression"),
        (
            'order=[{better = "CNN-LSTM", worse = "ResNet", gain = 0.3, says = "so"}]',
            "'ResNet' is no label",
        ),
        ('cnn_lstm="tiny"', "unknown key 'cnn_lstm'"),
    ],
)
def test_a_study_that_cannot_be_is_refused(change, remedy):
    with pytest.raises(InputError, match=remedy):
        load_study(ROOT / "configs/study_quick.toml", [change])


def test_every_network_of_the_shipped_studies_has_valid_settings(monkeypatch):
    monkeypatch.chdir(ROOT)
    for name in ("study", "study_quick"):
        study = load_study(f"configs/{name}.toml")
        assert [network.settings.name for network in study.networks] == [
            network.name for network in study.networks
        ]


def test_the_front_holds_what_no_other_beats():
    points = [
        {"seconds": s, "test": e} for s, e in ((1, 9), (2, 9), (3, 4), (4, 5), (5, 1), (5, 2))
    ]
    assert [(p["seconds"], p["test"]) for p in pareto(points, "test")] == [(1, 9), (3, 4), (5, 1)]


def test_the_fem_at_equal_error_and_in_equal_time():
    """Data of 60 s and training of 30 s are earned back in 90 frames where each saves 1 s, and
    never where none is saved."""
    known = {
        "net: int8": (1.0, 0.2),
        "net: float32": (3.0, 0.1),
        "unet: int8": (5.0, 0.3),
        "linear": (0.5, 0.4),
        "FEM 1": (2.0, 0.15),
        "FEM 9": (4.0, 0.01),
    }
    headlines = {
        name: {
            "kind": "network" if ":" in name else "regression",
            "family": "any",
            "run": name.split(":")[0] if ":" in name else None,
            "frame": None,
            "parent": None,
            "form": "float32",
            "made": [],
            "interactions": 58,
            "hard_in_training": False,
            "headline": {which: {"relative_l2": error} for which in ("usual", "hard")},
        }
        for name, (_, error) in known.items()
    }
    fem = [
        {"name": name, "frame": 0.25, "coarse": False, "element": "full", "stopped": []}
        | {"steps": 1, "hourglass_stiffness": 0.2, "damping": 0.1, "rise": 1.0}
        | model["headline"]
        for name, model in headlines.items()
        if "FEM" in name
    ]
    results = {
        "run_time": {
            "seconds": {name: {"p50": seconds} for name, (seconds, _) in known.items()},
            "interaction_s": {"": 1.0},
            "simulated": 60,
        },
        "accuracy": {
            "models": {n: m for n, m in headlines.items() if "FEM" not in n},
            "runs": {"net": {"seconds": 30.0}, "unet": {"seconds": None}},
        },
        "fixed_latency": {"points": fem},
    }
    mains = [SimpleNamespace(run=run) for run in ("net", "unet")]
    study = SimpleNamespace(fem=SimpleNamespace(frames=(0.25,)), main=mains, answers=())
    rows = {row["own"]["name"]: row for row in against_fem(study, results)}
    assert set(rows) == {"linear", "net: int8", "unet: int8"}
    net, unet = rows["net: int8"], rows["unet: int8"]
    assert (
        net["equal"]["name"] == "FEM 1"
        and net["timely"] is None
        and net["hours"] == pytest.approx(90 * 0.25 / 3600)
    )
    assert (
        unet["equal"]["name"] == "FEM 1"
        and unet["timely"]["name"] == "FEM 9"
        and unet["hours"] is None
    )
