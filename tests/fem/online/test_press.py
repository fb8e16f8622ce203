"""A probe at a given place: the force that holds it there, and what becomes of a bad device."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.constitutive import ConstitutiveStepper, save_constitutive
from fem.online.creep import Creep
from fem.online.press import Press
from fem.online.reduced import ReducedStepper

MIDDLE, RADIUS = (2.0, 1.5, 2.0), 1.2  # mm, on top of the block


def learned(model):
    """Of a step that looks at every point: Newton's own."""
    arrays = {"gain": np.ones(model.modes, "float32"), "effort": np.array([1e-4, 20.0])}
    for b, block in enumerate(model.blocks):
        arrays[f"N{b}"] = -block.M[:, : len(block.A)]
    return arrays


@pytest.fixture
def press(whole_model):
    stepper = ConstitutiveStepper(whole_model, learned(whole_model), interval=0.01)
    return Press(stepper, whole_model.surface(), most=20)


def pressed(press, force):
    """(N, 3) mN of a force (3,) at the probe."""
    return np.outer(press.surface.footprint(MIDDLE, RADIUS), force)


def test_the_force_it_answers_moves_the_tissue_as_deep_as_it_was_told(press, whole_model):
    other = ReducedStepper(whole_model, interval=0.01, tolerance=1e-6, most=60)
    for depth in (0.02, 0.1, 0.3, 0.3, 0.3, 0.1):
        touch = press(MIDDLE, depth, RADIUS)
        u = other.step(pressed(press, -touch.force))
        under = press.surface.footprint(MIDDLE, RADIUS) @ u
        assert touch.contact and not touch.flagged
        assert under[2] == pytest.approx(-depth, rel=2e-3)
        np.testing.assert_allclose(touch.displacement, under, atol=2e-3 * depth)
        np.testing.assert_allclose(press.displacement(), u, atol=3e-3 * depth)
    assert -touch.force[2] < 0  # it pushes inwards, along z


def test_one_that_holds_on_moves_the_tissue_where_it_goes(press, whole_model):
    other = ReducedStepper(whole_model, interval=0.01, tolerance=1e-6, most=60)
    for moved in ([0.05, 0.0, -0.1], [0.1, 0.05, -0.1], [0.0, 0.0, 0.15]):
        touch = press(MIDDLE, radius=RADIUS, target=np.add(MIDDLE, moved))
        u = other.step(pressed(press, -touch.force))
        under = press.surface.footprint(MIDDLE, RADIUS) @ u
        np.testing.assert_allclose(under, moved, atol=3e-4)
        assert touch.contact and touch.compliance.shape == (3, 3)
    assert touch.force[2] < 0  # a pull: the tissue draws the probe back


def test_the_compliance_is_the_slope_of_depth_over_force(press):
    press(MIDDLE, 0.2, RADIUS)
    state = press.state()
    low, here, high = (_restored(press, state)(MIDDLE, d, RADIUS) for d in (0.19, 0.2, 0.21))
    slope = 0.02 / (high.force[2] - low.force[2])
    assert here.compliance == pytest.approx(slope, rel=5e-3)
    np.testing.assert_allclose(_restored(press, state)(MIDDLE, 0.21, RADIUS).force, high.force)


def _restored(press, state):
    press.restore(state)
    return press


def test_a_held_depth_relaxes_like_the_tissue(press, tissue):
    """Small and slow enough to be linear: force over time is the relaxation function."""
    first = press(MIDDLE, 1e-3, RADIUS, dt=1e-3).force[2]
    elapsed = 0.0
    for dt in (0.1, 0.4, *[0.5] * 9):
        elapsed += dt
        held = press(MIDDLE, 1e-3, RADIUS, dt=dt).force[2]
    G = 1 - sum(g * (1 - np.exp(-elapsed / tau)) for g, tau in tissue.prony)
    assert held / first == pytest.approx(G, rel=3e-3)
    assert held / first < 0.8 and Creep.of(tissue.prony)(elapsed) > 1.3


def test_it_cannot_pull_and_is_met_again_where_the_tissue_has_come_back_to(press):
    for _ in range(100):
        press(MIDDLE, 0.3, RADIUS, dt=0.1)  # creeping under it for ten seconds
    away = press(MIDDLE, 0.05, RADIUS)
    assert not away.contact and not away.force.any() and not away.flagged
    assert -away.displacement[2] > 0.06, "left behind by the creep"
    for _ in range(100):
        later = press(MIDDLE, 0.05, RADIUS, dt=1.0)
    assert later.contact and later.force[2] > 0


@pytest.mark.parametrize(
    ("place", "depth", "words"),
    [
        ((np.nan, 0.0, 2.0), 0.1, "nan"),
        ((np.inf, 0.0, 2.0), 0.1, "inf"),
        ((2.0, 1.5, 2.0), np.nan, "nan"),
        ((50.0, 1.5, 2.0), 0.1, "misses the free surface"),
        ((2.0, 1.5), 0.1, "point"),
    ],
)
def test_what_a_device_sends_in_error_is_flagged_and_the_loop_goes_on(press, place, depth, words):
    press(MIDDLE, 0.1, RADIUS)
    wrong = press(place, depth, RADIUS)
    assert wrong.flagged and words in wrong.reason
    assert not wrong.contact and not wrong.force.any()
    again = press(MIDDLE, 0.1, RADIUS)
    assert again.contact and not again.flagged and np.isfinite(again.force).all()


def test_a_depth_that_no_tissue_bears_ends_in_finite_numbers_and_is_flagged(press):
    touch = press(MIDDLE, 500.0, RADIUS)
    assert touch.flagged and np.isfinite(touch.force).all() and np.isfinite(press.stepper.a).all()
    press.reset()
    assert press(MIDDLE, 0.1, RADIUS).contact


def test_bad_calls_are_refused(press, whole_model):
    with pytest.raises(InputError, match="depth.*or target"):
        press(MIDDLE)
    with pytest.raises(InputError, match="depth.*or target"):
        press(MIDDLE, 0.1, target=MIDDLE)
    with pytest.raises(InputError, match="dt = -1"):
        press(MIDDLE, 0.1, dt=-1.0)


def test_a_file_gives_the_same_press_and_one_of_before_tells(press, whole_model, tmp_path):
    arrays = learned(whole_model)
    save_constitutive(tmp_path / "net.npz", whole_model, arrays)
    opened = Press.open(tmp_path / "net.npz", interval=0.01, most=20)
    for depth in (0.1, 0.2):
        np.testing.assert_array_equal(
            opened(MIDDLE, depth, RADIUS).force, press(MIDDLE, depth, RADIUS).force
        )
    kept = {name: a for name, a in whole_model.arrays().items() if name not in ("places", "faces")}
    np.savez(tmp_path / "old.npz", format="unet-fem reduced 1", **kept, **arrays)
    with pytest.raises(InputError, match="surface.*fem.reduce"):
        Press.open(tmp_path / "old.npz")
