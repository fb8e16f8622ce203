"""Contacts: exact and consistent footprints, directions inside the cone, force histories, and
reproducible draws."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fem.contact.draw import PATTERNS, ContactRange, draw_contacts, tilt
from fem.contact.push import Contact, Load
from fem.contact.surface import Surface, surface_of
from fem.data.draws import drawn_contacts
from fem.data.scene import load_scene
from fem.errors import InputError
from fem.mesh.shapes import TUMOUR_EDGE, box, tumour

CONFIGS = Path(__file__).parents[3] / "configs"
EDGE = 1e-3  # m
RANGES = ContactRange(
    count=2, radius=(1.2e-3, 2.6e-3), force=(0.3e-3, 1.8e-3), travel=(0.0, 3e-3), cone=30.0
)
DURATION = 5.0  # s


@pytest.fixture(scope="module")
def surface():
    return Surface(tumour())


def contact(**changes):
    """A push straight down that climbs from 0.5 s to 1.5 s, stays to 2.5 s, and goes on as
    `pattern`."""
    ground = {
        "start": np.zeros(3),
        "end": np.array([3e-3, 0, 0]),
        "direction": np.array([0.0, 0.0, -1.0]),
        "radius": 1e-3,
        "peak": 2e-3,
        "onset": 0.5,
        "ramp": 1.0,
        "hold": 1.0,
        "pattern": "hold",
        "low": 0.25,
        "rate": 0.5,
        "duration": DURATION,
    }
    return Contact(**(ground | changes))


def many_draws(surface, ranges=RANGES, factor=None, n=60):
    return [
        draw_contacts(surface, ranges, DURATION, np.random.default_rng(seed), factor)
        for seed in range(n)
    ]


def test_surface_area_and_normals_of_a_flat_top():
    """The free surface of a block held at bottom and sides is its top: area, and normals straight
    up."""
    top = Surface(box((4, 3, 2), EDGE))
    assert top.area.sum() == pytest.approx(12 * EDGE**2, rel=1e-12)
    assert np.allclose(top.normal, [0, 0, 1])


@pytest.mark.parametrize("radius", [0.15e-3, 0.6e-3, 2.2e-3, 20e-3])
def test_shares_add_up_to_one_for_any_footprint(radius, surface, distort):
    """The total force is exact to rounding and nowhere negative for any radius and position, also
    across the rim."""
    for where in (surface, Surface(distort(tumour()))):
        for i in np.random.default_rng(0).choice(len(where.points), 60):
            share = where.footprint(where.points[i], radius)
            assert abs(share.sum() - 1) < 1e-14 and share.min() >= 0
        rim = where.points[where.clearance.argmin()]
        assert abs(where.footprint(rim + [-0.1e-3, 0, 0], radius).sum() - 1) < 1e-14


def test_resultant_acts_at_the_centre_of_the_footprint():
    """The moment about a footprint's centre falls faster than the square of the cell edge, from 0.5
    % of the radius."""
    length, radius, cells, errors = 8e-3, 2e-3, [8, 16, 32], []
    centres = np.random.default_rng(0).uniform(3e-3, 5e-3, (30, 3)) * [1, 1, 0] + [0, 0, 1e-3]
    for n in cells:
        mesh = box((n, n, n // 8), length / n)
        where = Surface(mesh)
        errors.append(
            max(
                np.linalg.norm(where.footprint(centre, radius) @ mesh.points - centre) / radius
                for centre in centres
            )
        )
    assert errors[0] < 5e-3
    assert -np.polyfit(np.log(cells), np.log(errors), 1)[0] > 3


@pytest.fixture(scope="module")
def drawn():
    """Of 200 interactions of the shipped scene, its 400 contacts, drawn as the dataset's are."""
    scene = load_scene(CONFIGS / "tumour.toml")
    wide = replace(scene, interactions=replace(scene.interactions, train=200))
    where = surface_of(wide.mesh.build())
    return [c for n in range(200) for c in drawn_contacts(wide, where, "train", n + 1, 0)]


def above_the_bump(surface, centre):
    """Whether the surface under a centre is the bump's top."""
    under = np.square(surface.points[:, :2] - centre[:2]).sum(axis=1).argmin()
    return surface.points[under, 2] == surface.points[:, 2].max()


def test_contacts_start_on_the_bump_beside_it_and_cross_its_edge(surface, drawn):
    """Of 400 contacts on the tumour at least 1 % start beside the bump, half on it, and 5 % of the
    paths cross its edge, both ways."""
    start, end = (
        np.array([above_the_bump(surface, at) for at in ends])
        for ends in zip(*((c.start, c.end) for c in drawn), strict=True)
    )
    assert start.mean() > 0.5 and (~start).mean() > 0.01
    assert (start != end).mean() > 0.05 and (start & ~end).any() and (~start & end).any()


def test_a_footprint_over_a_step_keeps_its_force_and_its_line_of_action(surface, drawn):
    """On and across the bump's edge the nodal forces add up to the contact's force to 1e-12, none
    of them on a held node; seen from above the resultant is within 0.3 % of the radius of the
    centre. It lies as high as the surface that carries it, so that for a tilted force the line of
    action is off by up to 8 % of the radius."""
    mesh = tumour()
    for c in drawn:
        for t in np.linspace(c.onset, DURATION, 5):
            share = surface.footprint(c.centre(t), c.radius)
            off = share @ mesh.points - c.centre(t)
            assert abs(share.sum() - 1) < 1e-12 and not share[mesh.fixed].any()
            assert np.linalg.norm(off[:2]) < 0.003 * c.radius
            assert np.linalg.norm(np.cross(off, c.direction)) < 0.08 * c.radius


def test_a_footprint_that_reaches_over_the_rim_is_cut(surface):
    """What of it would fall on held nodes, or beyond, falls away; the rest takes the whole force,
    so that the resultant moves inwards."""
    mesh, radius = tumour(), 2.4e-3
    x, y = 0.75e-3, 8 * TUMOUR_EDGE
    share = surface.footprint(np.array([x, y, 5 * TUMOUR_EDGE]), radius)
    resultant = share @ mesh.points
    assert abs(share.sum() - 1) < 1e-12 and not share[mesh.fixed].any()
    assert x + 0.1 * radius < resultant[0] < x + 0.3 * radius
    assert resultant[1] == pytest.approx(y, abs=1e-3 * radius)


def test_pressure_falls_off_as_it_should():
    """The mean square distance of the shares from the centre is R^2/4, that of the pressure (1 -
    r^2/R^2)^2."""
    mesh, radius, centre = box((32, 32, 1), EDGE / 4), 3e-3, np.array([4.1, 3.9, 0.25]) * EDGE
    share = Surface(mesh).footprint(centre, radius)
    assert share @ np.sum((mesh.points - centre) ** 2, axis=1) == pytest.approx(
        radius**2 / 4, rel=0.01
    )


def test_footprint_is_smooth_in_its_position():
    """A moving footprint hands its force from node to node without jumps: 1 % of an edge changes no
    share by 1 %."""
    where = Surface(box((8, 8, 2), EDGE))
    path = [
        where.footprint(np.array([x, 4.1e-3, 2e-3]), 2e-3)
        for x in np.arange(3e-3, 5e-3, 0.01 * EDGE)
    ]
    assert np.abs(np.diff(path, axis=0)).max() < 0.01 * np.max(path)


def test_a_footprint_beside_the_surface_is_refused(surface):
    """A footprint that holds no point of the surface is an InputError that names radius and
    place."""
    with pytest.raises(InputError, match="radius 0.001 m at .* misses the free surface"):
        surface.footprint(np.array([0.1, 0.0, 0.0]), 1e-3)
    mesh = box((2, 2, 2), EDGE)
    with pytest.raises(InputError, match="no free surface"):
        Surface(dataclasses.replace(mesh, fixed=np.ones(mesh.n_nodes, bool)))


def test_load_is_the_sum_of_its_contacts(surface):
    """Each contact puts its whole force on the nodes: the load adds up to the sum of the force
    vectors."""
    contacts = many_draws(surface, n=1)[0]
    load = Load(surface, contacts)
    for t in (0.0, 0.7, 2.3, 5.0):
        total = sum(c.force(t) for c in contacts)
        assert np.allclose(load(t).sum(axis=1), total, rtol=1e-13, atol=1e-18)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.5])
def test_directions_fill_the_cone_evenly(angle):
    """Directions are unit vectors within the half-angle of the axis, spread evenly over the solid
    angle."""
    rng, axis = np.random.default_rng(0), np.array([2.0, -1.0, 2.0]) / 3
    directions = np.array([tilt(axis, angle, rng) for _ in range(2000)])
    cosine = directions @ axis
    assert np.allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-12)
    assert cosine.min() >= np.cos(angle) - 1e-12
    spread = (1 - np.cos(angle)) / np.sqrt(12 * 2000)
    assert cosine.mean() == pytest.approx((1 + np.cos(angle)) / 2, abs=4 * spread + 1e-12)
    assert (
        np.linalg.norm(directions.mean(axis=0) - cosine.mean() * axis)
        < 4 * np.sin(angle) / np.sqrt(2000) + 1e-12
    )


def test_hold_climbs_and_stays():
    """Nothing before the onset, half way up in the middle of the ramp, then the peak for good;
    never a jump."""
    force = np.array([-contact().force(t)[2] for t in np.linspace(0, 5, 501)])
    assert (
        not force[:51].any() and force[100] == pytest.approx(1e-3) and np.all(force[150:] == 2e-3)
    )
    assert np.all(np.diff(force) >= 0) and np.abs(np.diff(force)).max() < 2e-3 * 1.51 * 0.01


def test_release_goes_down_to_its_share():
    """After the hold a release comes down to `low` times the peak over another ramp, and stays
    there."""
    force = np.array([-contact(pattern="release").force(t)[2] for t in np.linspace(0, 5, 501)])
    assert np.allclose(force[150:251], 2e-3, rtol=1e-12)
    assert np.all(np.diff(force[250:]) <= 0) and np.allclose(force[350:], 0.25 * 2e-3, rtol=1e-12)


def test_oscillation_swings_between_peak_and_share():
    """After the hold an oscillation at `rate` swings between the peak and `low` times the peak."""
    force = np.array([-contact(pattern="oscillate").force(t)[2] for t in np.linspace(0, 8.5, 851)])
    assert np.allclose(force[150:251], 2e-3, rtol=1e-12)
    assert force[250:].max() == pytest.approx(2e-3) and force[250:].min() == pytest.approx(0.5e-3)
    assert np.allclose(force[250:450], force[450:650], rtol=1e-9)  # a period of 2 s
    assert force[350] == pytest.approx(0.5e-3)


def test_centre_runs_along_its_path():
    """The centre waits at the start until the onset, is half way in the middle, and ends at the
    end."""
    c = contact()
    assert np.array_equal(c.centre(0.3), c.start) and np.allclose(c.centre(DURATION), c.end)
    assert np.allclose(c.centre((0.5 + DURATION) / 2), (c.start + c.end) / 2)


def test_draws_stay_in_their_ranges(surface):
    """Radius, peak, travel, cone and times of drawn contacts keep to the scene's ranges; every
    pattern occurs."""
    drawn = [c for contacts in many_draws(surface) for c in contacts]
    for c in drawn:
        assert RANGES.radius[0] <= c.radius <= RANGES.radius[1]
        assert RANGES.force[0] <= c.peak <= RANGES.force[1]
        assert RANGES.ramp[0] <= c.ramp <= RANGES.ramp[1] and 0 <= c.onset <= RANGES.onset[1]
        assert np.linalg.norm(c.end - c.start) <= RANGES.travel[1] + 0.5e-3
        assert -c.direction[2] >= np.cos(np.radians(30)) - 1e-12 and np.linalg.norm(
            c.direction
        ) == pytest.approx(1)
    assert {c.pattern for c in drawn} == set(PATTERNS)
    assert max(c.peak for c in drawn) > 1.5e-3 and min(c.peak for c in drawn) < 0.6e-3


def test_drawn_footprints_keep_off_the_rim(surface):
    """A drawn path starts and ends where the whole footprint is on the free surface, if the surface
    is wide enough."""
    rim = tumour().points[tumour().contact_rim]
    for contacts in many_draws(surface):
        for c in contacts:
            for centre in (c.start, c.end):
                assert (
                    np.linalg.norm(rim - centre, axis=1).min()
                    >= min(c.radius, 0.9 * surface.clearance.max()) - 1e-12
                )


def test_same_seed_same_contacts(surface):
    """The draw depends on the generator alone; another seed gives other contacts."""
    for a, b in zip(many_draws(surface, n=5), many_draws(surface, n=5), strict=True):
        assert repr(a) == repr(b)
    assert repr(many_draws(surface, n=2)[0]) != repr(many_draws(surface, n=2)[1])


def test_hard_interactions_push_together_beyond_the_range(surface):
    """Every hard contact peaks at 1.3 to 1.6 times the largest force of the range, and all reach
    their peak together."""
    for contacts in many_draws(surface, factor=(1.3, 1.6)):
        for c in contacts:
            assert 1.3 * RANGES.force[1] <= c.peak <= 1.6 * RANGES.force[1]
            assert np.linalg.norm(c.force(RANGES.ramp[1])) == pytest.approx(c.peak, rel=1e-12)


@pytest.mark.parametrize(
    "change, named",
    [
        ({"count": 0}, "contact.count = 0"),
        ({"cone": 90.0}, "contact.cone = 90"),
        ({"force": (2.0, 1.0)}, r"contact.force = \[2.0, 1.0\]"),
        ({"force": (-1.0, 1.0)}, r"contact.force = \[-1.0, 1.0\]"),
        ({"hold": (0.0, np.inf)}, "contact.hold"),
        ({"rate": (np.nan, 1.0)}, "contact.rate"),
        ({"radius": (0.0, 1.0)}, "contact.radius"),
        ({"ramp": (0.0, 1.0)}, "contact.ramp"),
    ],
)
def test_impossible_ranges_are_refused(change, named):
    """A range without meaning is an InputError that names its key and value."""
    with pytest.raises(InputError, match=named):
        dataclasses.replace(RANGES, **change)


def test_a_share_of_the_contacts_pulls(surface):
    """Outwards, within the same cone; with none, every draw is as it was before there were any."""
    pulling = replace(RANGES, pull=0.3)
    found = [contact for draw in many_draws(surface, pulling, n=100) for contact in draw]
    normal = np.array([nearest_normal(surface, contact.start) for contact in found])
    along = np.einsum("nc,nc->n", [contact.direction for contact in found], normal)
    assert (np.abs(along) >= np.cos(np.radians(30)) - 1e-12).all()
    assert 0.2 < (along > 0).mean() < 0.4
    for ours, theirs in zip(many_draws(surface, pulling), many_draws(surface), strict=True):
        first, same = ours[0], theirs[0]
        assert np.array_equal(np.abs(first.direction), np.abs(same.direction))
        assert (first.peak, first.onset, first.rate) == (same.peak, same.onset, same.rate)
    with pytest.raises(InputError, match="contact.pull = 1.5 must be from 0 to 1"):
        replace(RANGES, pull=1.5)


def nearest_normal(surface, point):
    return surface.normal[np.square(surface.points - point).sum(axis=1).argmin()]
