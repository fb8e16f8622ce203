"""The comparison of inputs: networks and baselines in one table, and nothing trained twice."""

import json
from pathlib import Path

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from unet_fem.study.measure import ablation

ROOT = Path(__file__).parents[3]
CHANGES = ["scene=scene.toml", "data=tiny.h5", "train.epochs=1", "train.batch_size=4"]


@pytest.fixture
def folder(tiny_dataset, tmp_path, monkeypatch):
    """A working directory with the tiny dataset, its scene and the shipped configurations."""
    (tmp_path / "scene.toml").write_text(open_dataset(tiny_dataset).scene.toml())
    (tmp_path / "tiny.h5").symlink_to(tiny_dataset)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_baselines_alone_are_a_table(folder):
    rows = ablation.ablation([], changes=CHANGES)
    assert [(row["label"], row["memory"]) for row in rows] == [
        (label, memory)
        for label in ("linear regression", "POD regression", "linear elastic answer")
        for memory in ("window", "creep")
    ]
    dataset = open_dataset("tiny.h5")
    test = dataset.read("test")
    assert all(0 < row["hard"]["relative_l2"] < 2 for row in rows) and test["hard"].all()
    ablation.write(rows, folder / "table", "a command")
    text = (folder / "table.md").read_text()
    assert "`a command`" in text and text.count("| linear regression |") == 2
    assert json.loads((folder / "table.json").read_text()) == json.loads(json.dumps(rows))


@pytest.mark.slow
def test_networks_are_trained_once(folder, monkeypatch):
    rows = ablation.ablation([1], ["unet"], CHANGES)[:4]
    assert [(row["memory"], row["physics"]) for row in rows] == [
        ("window", "force"),
        ("window", "elastic"),
        ("creep", "force"),
        ("creep", "elastic"),
    ]
    assert {row["parameters"] for row in rows} == {107_251}
    assert [row["usual"] for row in rows] == 4 * [None] and rows[0]["seeds"] == 1
    for row in rows:
        found = row["validation"]
        assert found["relative_l2"] == pytest.approx(np.mean(found["of_seeds"]))
    monkeypatch.setattr(ablation, "train_network", lambda *_: pytest.fail("trained again"))
    assert ablation.ablation([1], ["unet"], CHANGES)[:4] == rows
