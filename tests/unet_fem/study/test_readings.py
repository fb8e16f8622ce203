"""The table of readings on the tiny scene: what is judged on what."""

import shutil

import pytest

from fem import settings as config
from unet_fem.study.measure import readings

RUN = (
    'name = "{name}"\nscene = "scene.toml"\ndata = "data.h5"\n[model]\n{model}\n'
    "[train]\nepochs = 1\nbatch_size = 4\n"
)


@pytest.fixture
def here(tiny, unseen_dataset, tmp_path, monkeypatch):
    """A folder with the scene, its data, and two networks that hardly learn."""
    monkeypatch.chdir(tmp_path)
    scene = config.merge(tiny, {"interactions": {"test": 2, "hard": [2, 2], "hard_set": 1}})
    (tmp_path / "scene.toml").write_text(config.dump_toml(scene))
    shutil.copy(unseen_dataset, "data.h5")
    networks = {"unet": 'kind = "unet"\nfilters = 2', "lstm": "units = 4"}
    for name, model in networks.items():
        (tmp_path / f"{name}.toml").write_text(RUN.format(name=name, model=model))
    widths = {"unet.toml": "model.filters=1", "lstm.toml": "model.units=2"}
    monkeypatch.setattr(readings, "NETWORKS", widths)


def test_each_reading_is_judged_on_its_own_validation_and_on_the_same_tests(here, monkeypatch):
    rows = readings.run(["A", "B"])
    labels = ["linear, 1 frame", "linear, 2 frames", "U-Net", "CNN-LSTM"]
    assert [row["model"] for row in rows] == labels * 2
    whole, dealt = rows[:4], rows[4:]
    assert all(row["leaking"] == 0 for row in whole) and all(row["leaking"] > 0 for row in dealt)
    assert {row["samples"] for row in rows} == {6} and dealt[0]["interactions"] == 2
    assert all(row["usual"]["count"] == 1 for row in rows)
    assert whole[0]["validation"] != dealt[0]["validation"]
    monkeypatch.setattr(readings, "train_network", lambda *own: pytest.fail("trained again"))
    assert readings.run(["A"]) == whole
    text = readings.table(rows)
    assert text.count("\n") == 9 and "| B | 6 | 2 | 67 | linear, 1 frame |" in text
