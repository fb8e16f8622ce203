"""The contacts behind an interaction of a dataset can be drawn again, whatever attempt it took."""

from dataclasses import replace

import numpy as np
import pytest

from fem import settings as config
from fem.contact.push import Load
from fem.contact.surface import Surface
from fem.data.dataset import open_dataset
from fem.data.interaction import contacts_of, drawn_contacts, simulate, unfit
from fem.data.scene import Scene
from fem.errors import InputError


def test_contacts_are_found_again_after_rejected_draws(tiny_dataset):
    """Their load gives the dataset's forces to the bit, also where the first draw was unfit."""
    dataset = open_dataset(tiny_dataset)
    scene, surface = dataset.scene, Surface(dataset.fem_mesh)
    first = []
    for split, number in scene.interactions.all():
        force = dataset.sequence(split, number).force
        contacts = contacts_of(dataset, split, number)
        load = Load(surface, contacts)
        np.testing.assert_array_equal(
            np.array([load(t).T * 1e3 for t in dataset.time], np.float32), force
        )
        first.append(contacts[0].peak == drawn_contacts(scene, surface, split, number, 0)[0].peak)
    assert not all(first)


def test_forces_of_another_scene_have_no_contacts_here(tiny_dataset):
    dataset = open_dataset(tiny_dataset)
    contact = dataset.scene.contact
    stronger = replace(contact, force=tuple(1.01 * peak for peak in contact.force))
    other = replace(dataset, scene=replace(dataset.scene, contact=stronger))
    with pytest.raises(
        InputError, match="no draw of the scene gives the forces of train interaction 1"
    ):
        contacts_of(other, "train", 1)


@pytest.mark.parametrize("prony", [[], [[0.12, 330.0], [0.8, 11.0]]], ids=["elastic", "viscous"])
def test_a_run_of_ten_steps_is_judged_by_its_frames(tiny, prony):
    """The ledger's only row is that at rest; the frames show that the tissue has hardly followed
    the load."""
    short = {"material": {"prony": prony}, "frames": {"interval": 0.005}}
    gentle = {"contact": {"force": [1e-5, 1e-4], "ramp": [0.05, 0.05], "onset": [0.0, 0.0]}}
    scene = config.build(Scene, config.merge(config.merge(tiny, short), gentle))
    mesh = scene.mesh.build()
    surface = Surface(mesh)
    result = simulate(scene, mesh, drawn_contacts(scene, surface, "train", 1, 0), surface)
    assert result["steps"] <= 12 and result["energy"][-1].all(where=[1, 1, 0, 0, 1, 1, 1])
    assert result["kinetic_share"] > 0.1 and result["imbalance"] > 0
    assert unfit(scene, result) == "kinetic energy"
