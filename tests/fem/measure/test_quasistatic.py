"""The quasi-static solver is measured beside the explicit one."""

from fem import settings as config
from fem.data.scene import Scene
from fem.measure.quasistatic import pair, rise_table


def test_a_pair_tells_the_time_and_the_distance(tiny):
    """Of the same interaction at the true mass and at a mass scaling of 16."""
    tree = config.merge(tiny, {"contact": {"ramp": [0.3, 0.4]}})
    row = pair(config.build(Scene, tree), "train", 1, 0.2, exact=True)
    assert row["interaction"] == "train 1"
    assert row["faster than true mass"] > row["faster than mass scaling 16"] > 0
    assert 0 < row["% from true mass"] < row["% from mass scaling 16"] < 3


def test_a_fast_push_is_not_quasistatic():
    """The error of leaving inertia out falls as the push rises more slowly."""
    fast, slow = rise_table((0.01, 0.05))
    for column in ("% at damping 0/s", "% at damping 20/s"):
        assert fast[column] > 10 * slow[column] and slow[column] < 1
