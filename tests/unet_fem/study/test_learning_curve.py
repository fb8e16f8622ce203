"""The learning curve: what each size learns from, and how the result is told."""

import numpy as np
import pytest

import fem
from fem.errors import InputError
from fem.reduced.build import held_out
from unet_fem.study.measure import learning_curve as curve
from unet_fem.study.report.learning_curve import draw, table, write


@pytest.fixture
def dataset(unseen_dataset, tmp_path, monkeypatch):
    """Two interactions to train on and a hard one, in a cache of its own."""
    monkeypatch.setenv("UNET_FEM_CACHE", str(tmp_path / "cache"))
    return fem.open_dataset(unseen_dataset)


def test_every_size_has_its_share_of_hard_interactions(dataset):
    assert [curve.shares(dataset, n, 1).tolist() for n in (1, 2, 3)] == [[1, 0], [1, 1], [2, 1]]
    assert curve.shares(dataset, 2, 0).tolist() == [2, 0]
    with pytest.raises(InputError, match="size 3 is not among the 2"):
        curve.shares(dataset, 3, 0)


def test_a_part_holds_what_the_dataset_holds(dataset, tmp_path):
    part = curve.part_of(dataset, 3, 1, tmp_path / "data.h5").for_learning()
    assert part.split.tolist() == ["train"] * 3 + ["validation", "test"]
    pairs = {("train", 1): ("train", 1), ("train", 3): ("hard", 1), ("validation", 1): None}
    for (split, number), source in pairs.items():
        whole, own = dataset.sequence(*(source or (split, number))), part.sequence(split, number)
        np.testing.assert_array_equal(own.force, whole.force)
        np.testing.assert_array_equal(own.displacement, whole.displacement)
    assert held_out(part, 0) == {"usual": [("validation", 1)]}
    again = curve.part_of(dataset, 3, 1, tmp_path / "data.h5")
    assert again.path == part.path


def test_the_curve_is_kept_and_told(dataset, tmp_path):
    answers = tuple(name for name in curve.REGRESSIONS if "POD" not in name)
    told: list[str] = []
    result = curve.learning_curve(dataset, dataset, [1, 3], 1, answers, tell=told.append)
    assert result == curve.learning_curve(dataset, dataset, [1, 3], 1, answers, tell=told.append)
    assert len(result["rows"]) == len(told) / 2 == 2 * len(answers)
    assert result == curve.learning_curve(dataset, dataset, [1, 3], 1, kept=True, tell=told.append)
    free = [row for row in result["rows"] if row["answer"].startswith("linear elastic")]
    assert {row["interactions"] for row in free} == {0} and free[0]["usual"] == free[1]["usual"]
    assert all(row["simulation"] > 0 for row in result["rows"] if row["interactions"])
    lines = table(result).splitlines()
    assert lines[0] == "| usual / hard % | 1 | 3 |"
    assert len(lines) == 2 * len(answers) + 6
    assert len(draw(result).axes) == 2
    write(result, tmp_path / "curve", "python tools/learning_curve.py")
    assert "![curve](curve.png)" in (tmp_path / "curve.md").read_text()
