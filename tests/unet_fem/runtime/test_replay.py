"""Replay of interactions in real time: of any stepper, at its own rate or one that it takes."""

import numpy as np
import pytest

from fem.errors import InputError
from unet_fem.runtime.__main__ import main
from unet_fem.runtime.replay import read_interaction, replay, report


class Spring:
    """A stepper of one node whose displacement is its force, and that counts its calls."""

    def __init__(self, interval):
        self.interval, self.calls = interval, 0

    def reset(self):
        self.calls = 0

    def step(self, force, dt=None):
        self.calls += 1
        return force.copy()


TIMES = np.array([0.0, 0.1, 0.2])
FORCE = np.arange(3.0, dtype="float32")[:, None, None] * np.ones((1, 3), "float32")


@pytest.mark.parametrize("interval, rate", [(0.01, None), (None, 100.0), (0.01, 100.0)])
def test_a_replay_calls_any_stepper_at_its_rate(interval, rate):
    spring = Spring(interval)
    timing = replay(spring, FORCE, TIMES, rate)
    assert np.all(timing["late"] >= 0)  # no call begins before it is due
    assert spring.calls == len(timing["took"]) == 21
    np.testing.assert_allclose(timing["displacement"], FORCE, atol=1e-6)
    assert " 100 Hz: achieved" in report(timing, 100.0)


def test_a_stepper_of_any_interval_is_replayed_at_a_given_rate_alone():
    with pytest.raises(InputError, match="give the rate"):
        replay(Spring(None), FORCE, TIMES)


def test_the_command_replays_a_surrogate_and_tells_its_rates(tiny_surrogate, tiny_dataset, capsys):
    main([str(tiny_surrogate), str(tiny_dataset), "--rate", "50", "100"])
    text = capsys.readouterr().out
    assert "50 Hz: achieved" in text and "100 Hz: achieved" in text and "deadlines" in text
    with pytest.raises(SystemExit):
        main([str(tiny_surrogate), str(tiny_dataset), "--interaction", "99"])
    assert "no test interaction 99" in capsys.readouterr().err


def test_what_is_no_dataset_is_refused(tmp_path):
    with pytest.raises(InputError, match="no dataset"):
        read_interaction(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("no HDF5")
    with pytest.raises(InputError, match="cannot be read as HDF5"):
        read_interaction(tmp_path / "text.h5")
