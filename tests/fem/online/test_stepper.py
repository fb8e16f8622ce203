"""The interval between the calls of a stepper: its own, or any that is positive."""

import pytest

from fem.errors import InputError
from fem.online.stepper import check_interval


@pytest.mark.parametrize(
    "interval, dt", [(0.01, None), (0.01, 0.01), (1 / 3, 0.3333333333), (None, 2.0)]
)
def test_its_own_interval_is_taken_and_any_where_it_has_none(interval, dt):
    check_interval(interval, dt)


@pytest.mark.parametrize(
    "interval, dt, words",
    [
        (
            0.01,
            0.02,
            "dt = 0.02 s, but this stepper is made for 0.01 s between calls; leave dt out",
        ),
        (None, None, "takes any interval; give dt"),
        (0.01, -0.01, "must be positive and finite"),
        (None, 0.0, "must be positive and finite"),
        (None, float("inf"), "must be positive and finite"),
        (None, float("nan"), "must be positive and finite"),
    ],
)
def test_another_dt_is_refused_with_the_remedy(interval, dt, words):
    with pytest.raises(InputError, match=words):
        check_interval(interval, dt)
