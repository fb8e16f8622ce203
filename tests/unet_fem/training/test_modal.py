"""What the modal network is taught."""

import numpy as np
import pytest

import fem
from fem.reduced.build import Choice
from fem.reduced.build import reduce as reduce_dataset
from unet_fem.training import modal


@pytest.fixture(scope="module")
def model(tiny_dataset, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UNET_FEM_CACHE", str(tmp_path_factory.mktemp("cache")))
        return reduce_dataset(fem.open_dataset(tiny_dataset), Choice(6, 6, 24, frames=3))[0]


def test_lessons_are_what_the_reduced_model_answers_and_the_seed_decides(
    tiny_dataset, model, monkeypatch
):
    dataset = fem.open_dataset(tiny_dataset)
    lessons = modal.taught(dataset, model, 12)
    again = modal.taught(dataset, model, 12)
    np.testing.assert_array_equal(lessons.a, again.a)
    usual = dataset.scene.frames.interval
    assert usual < lessons.interval.max() <= usual * modal.SLOWEST
    assert lessons.interval.min() == usual
    monkeypatch.setattr(modal, "PULLS", 1.0)
    pulled = modal.taught(dataset, model, 12)
    monkeypatch.setattr(modal, "PULLS", 0.0)
    np.testing.assert_array_equal(pulled.g, -modal.taught(dataset, model, 12).g)


def test_interactions_that_the_model_gives_up_are_left_out(tiny_dataset, model, monkeypatch):
    dataset = fem.open_dataset(tiny_dataset)
    monkeypatch.setattr(modal, "UNREST", -1.0)
    assert not len(modal.taught(dataset, model, 3))


def test_past_weighs_features_as_the_prony_series_forgets_them():
    g = np.zeros((2, 4, 3), "float32")
    lessons = modal.Lessons(g, g, np.array([0.25, 1.0]))
    _, past = lessons.inputs(((0.5, 1.0),))
    held = past @ np.ones(4)  # a feature that comes within the first frame and stays
    creep = modal.Creep(((0.5, 1.0),))
    for row, dt in enumerate((0.25, 1.0)):
        late = creep(dt * np.arange(5))
        assert (late[:-1] < held[row]).all() and (held[row] < late[1:]).all()
