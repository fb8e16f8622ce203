"""A load is sampled so often that its ramps follow it."""

import numpy as np
import pytest

from fem.solver.load_ramp import LoadRamp

DT, MOST = 1e-3, 64  # s; steps between two samples at most


def ramps(load, end):
    """(times, ramped load) at every step, and the number of samples."""
    ramp, time, now, samples = LoadRamp(np.zeros((3, 1)), MOST), 0.0, load(0.0), 0
    times, found = [0.0], [now]
    while time < end:
        count, then = ramp.sample(load, now, time, DT, MOST)
        for n in range(1, count + 1):
            times.append(time + n * DT)
            found.append(now + n / count * (then - now))
        time, now, samples = time + count * DT, then, samples + 1
    return np.array(times), np.array(found), samples


@pytest.mark.parametrize(("rate", "near"), [(2.0, 0.08), (5.0, 0.12)])
def test_ramps_follow_a_load_that_bends(rate, near):
    """Whole blocks between samples miss it by 15 and by 71 % of its largest."""
    load = lambda t: np.full((3, 1), np.sin(2 * np.pi * rate * t) ** 2)  # noqa: E731
    times, found, samples = ramps(load, 1.0)
    own = np.array([load(t) for t in times])
    assert np.abs(found - own).max() < near
    assert samples < len(times) / 4  # and not at every step


def test_a_load_that_runs_straight_is_sampled_once_a_block():
    _, _, samples = ramps(lambda t: np.full((3, 1), 2.0 * t), 1.0)
    assert samples <= 4 + 1.0 / (DT * MOST)
