"""A run is given up to the last frame until which it is fit for a dataset."""

from dataclasses import replace

import numpy as np
import pytest

from fem import settings as config
from fem.contact.push import Load, smooth_step
from fem.contact.surface import surface_of
from fem.contact.table import table_contacts
from fem.data import fit
from fem.data.fit import fit_frames
from fem.data.interaction import healthy_interaction
from fem.data.scene import Scene
from fem.errors import Stop

TIMES = np.array([0.0, 0.2, 0.4, 0.6])


@pytest.fixture
def scene(tiny):
    return config.build(Scene, tiny)


def push(scene, mesh, peak):
    """A push of `peak` N into the middle that takes 0.6 s."""
    force = np.zeros((3, mesh.n_nodes))
    force[2] = -peak * surface_of(mesh).footprint(np.array([2e-3, 2e-3, 2e-3]), 1.4e-3)
    return lambda t: smooth_step(t / 0.6) * force


def test_a_drawn_interaction_is_fit_to_its_end_and_the_same_as_in_the_dataset(scene):
    mesh = scene.mesh.build()
    drawn = healthy_interaction(scene, mesh, "train", 1)
    load = Load(surface_of(mesh), table_contacts(drawn["contacts"]))
    frames, reason = fit_frames(scene, mesh, load, scene.frames.times)
    assert reason is None
    for name in ("force", "displacement", "volume"):
        assert np.array_equal(getattr(frames, name), drawn[name]), name


@pytest.mark.parametrize(
    "health, reason",
    [
        ({"min_J": 0.97}, Stop.CRUSHED_CELL),
        ({"corner_J": 0.97}, Stop.CRUSHED_CORNER),
        ({"kinetic_share": 1e-12}, Stop.KINETIC_ENERGY),
        ({"imbalance": 1e-12}, Stop.ENERGY_IMBALANCE),
    ],
)
def test_each_limit_of_the_scene_ends_it(scene, health, reason):
    scene = replace(scene, health=replace(scene.health, **health))
    frames, found = fit_frames(scene, mesh := scene.mesh.build(), push(scene, mesh, 5e-4), TIMES)
    assert found is reason and 1 <= len(frames.volume) < len(TIMES)
    assert not frames.displacement[0].any()


def test_what_a_later_frame_takes_back_ends_nothing(scene, monkeypatch):
    mesh, verdicts = scene.mesh.build(), iter([None, Stop.DISEQUILIBRIUM, None, Stop.CRUSHED_CELL])
    monkeypatch.setattr(fit, "unfit", lambda *_: next(verdicts))
    frames, reason = fit_frames(scene, mesh, push(scene, mesh, 5e-4), TIMES)
    assert len(frames.volume) == 3 and reason is Stop.CRUSHED_CELL


def test_a_run_that_stops_is_given_up_to_there(scene):
    frames, reason = fit_frames(scene, mesh := scene.mesh.build(), push(scene, mesh, 2e-2), TIMES)
    assert reason in (Stop.CRUSHED_CELL, Stop.INVERTED_CELL) and len(frames.volume) < len(TIMES)
