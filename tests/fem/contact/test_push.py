"""Pushes in a few words, and contacts as rows of a table."""

import dataclasses

import numpy as np
import pytest

from fem.contact.draw import ContactRange, draw_contacts
from fem.contact.push import Contact, Load, Push
from fem.contact.surface import Surface, surface_of
from fem.contact.table import contact_table, table_contacts
from fem.errors import InputError
from fem.mesh.shapes import box, tumour


def test_a_push_rises_and_stays_at_its_place():
    """Straight inwards at the middle of the top, 1 mN after the ramp, for good."""
    mesh = box((6, 6, 3), 1e-3)
    load = Load(Surface(mesh), [Push(at="top", force=1e-3, radius=2e-3)])
    assert not load(0.0).any()
    for t in (0.5, 3.0, 1e6):
        assert load(t).sum(axis=1) == pytest.approx([0, 0, -1e-3], abs=1e-15)
    assert np.array_equal(load(3.0), load(1e6))
    centre = load(3.0)[2] @ mesh.points / load(3.0)[2].sum()
    assert centre[:2] == pytest.approx([3e-3, 3e-3], abs=1e-3)


def test_a_push_may_name_a_part_or_a_point_and_a_direction():
    surface = Surface(tumour())
    place = {at: Push(at, 1e-3, 2e-3).on(surface).start for at in ("middle", "rim", "top")}
    clearance = {
        at: surface.clearance[np.flatnonzero((surface.points == x).all(axis=1))[0]]
        for at, x in place.items()
    }
    assert clearance["middle"] == surface.clearance.max() == clearance["top"]
    assert clearance["rim"] == surface.clearance.min()
    point = place["middle"] + [1e-3, 0, 0]
    aside = Push(point, -2e-3, 1e-3, direction=(3, 0, -4), onset=1, ramp=2).on(surface)
    assert np.array_equal(aside.start, point) and not aside.force(1.0).any()
    assert aside.force(3.0) == pytest.approx(-2e-3 * np.array([0.6, 0, -0.8]))


@pytest.mark.parametrize(
    "wrong, named",
    [
        ({"at": "side"}, "push at 'side'"),
        ({"radius": 0.0}, "radius = 0.0"),
        ({"ramp": np.nan}, "ramp = nan"),
        ({"direction": (0, 0, 0)}, "no direction"),
        ({"at": (1.0, 2.0)}, "at"),
        ({"force": "hard"}, "force = 'hard'"),
    ],
)
def test_impossible_pushes_are_refused(wrong, named):
    with pytest.raises(InputError, match=named):
        Push(**{"at": "top", "force": 1e-3, "radius": 1e-3} | wrong)


def test_contacts_come_back_from_their_table_to_the_bit():
    ranges = ContactRange(count=3, radius=(1e-3, 2e-3), force=(1e-3, 2e-3), cone=20.0)
    contacts = draw_contacts(Surface(tumour()), ranges, 5.0, np.random.default_rng(3))
    contacts.append(Push("rim", 1e-3, 1e-3).on(Surface(tumour())))
    for one, other in zip(contacts, table_contacts(contact_table(contacts)), strict=True):
        for field in dataclasses.fields(Contact):
            assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field


def test_the_surface_of_equal_meshes_is_made_once():
    assert surface_of(tumour()) is surface_of(tumour())
    assert surface_of(tumour()) is not surface_of(tumour(1e-3))
