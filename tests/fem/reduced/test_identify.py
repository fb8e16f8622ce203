"""The tissue of a record: recovered from noise, and what the record cannot tell is said."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.retissue import with_tissue
from fem.reduced.identify import Pressed, Record, identify, read_record

PLACE, RADIUS = (2.0, 1.5, 2.0), 1.2


@pytest.fixture(scope="module")
def network(whole_model):
    """(model, learned): Newton's own step, looking at every point."""
    arrays = {"gain": np.ones(whole_model.modes, "float32"), "effort": np.array([1e-3, 8.0])}
    for b, block in enumerate(whole_model.blocks):
        arrays[f"N{b}"] = -block.M[:, : len(block.A)]
    return whole_model, arrays


def record(network, prony, mu, time, noise, seed=0):
    """A press of 0.15 mm in half a second, held, in a tissue with this mu and Prony series."""
    depth = 0.15 * np.minimum(time / 0.5, 1)
    model, learned = with_tissue(*network, mu=mu, K=mu * 2366.667 / 400)
    blank = Record(time, depth, np.ones_like(time))
    force = Pressed(model, learned, blank, PLACE, RADIUS)(prony)
    rng = np.random.default_rng(seed)
    return Record(time, depth, force + noise * force.max() * rng.standard_normal(len(time)))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_noisy_record_gives_the_modulus_and_the_series_within_its_intervals(network, seed):
    true, mu = ((0.5, 4.0),), 650.0
    measured = record(network, true, mu, np.linspace(0.05, 20, 150), 0.02, seed)
    found = identify(Pressed(*network, measured, PLACE, RADIUS), terms=1, rows=80)
    assert found.mu == pytest.approx(mu, rel=0.03)
    for name, value in (("mu", mu), ("g1", 0.5), ("tau1", 4.0)):
        assert found.low[name] < found.high[name] < 1.5 * found.low[name], "the record tells it"
        middle = np.sqrt(found.low[name] * found.high[name])
        half = np.log(found.high[name] / middle)
        assert abs(np.log(value / middle)) < 2 * half
    assert all(found.told.values()) and not found.alike
    assert 0.01 < found.misfit < 0.06, "the noise, and no more"


def test_a_time_far_beyond_the_record_is_not_told(network):
    measured = record(network, ((0.5, 330.0),), 400.0, np.linspace(0.05, 5, 60), 0.02)
    found = identify(Pressed(*network, measured, PLACE, RADIUS), terms=1, rows=60)
    assert found.mu == pytest.approx(400.0, rel=0.03)
    assert not found.told["tau1"]


def test_times_too_near_to_each_other_cannot_be_told_apart(network):
    measured = record(network, ((0.3, 3.0), (0.3, 4.0)), 400.0, np.linspace(0.05, 20, 80), 0.02)
    found = identify(Pressed(*network, measured, PLACE, RADIUS), terms=2, rows=60)
    assert found.mu == pytest.approx(400.0, rel=0.05)
    assert found.alike or not (found.told["tau1"] and found.told["tau2"])


HEAD = "time_s,depth_mm,force_mN\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "columns none"),
        ("time_s,depth_mm\n0,1\n", "force_mN"),
        ("time_s,depth_inch,force_mN\n0,1,1\n", "depth_mm, depth_um"),
        ("time_s,time_ms,depth_mm,force_mN\n0,0,1,1\n", "time_s, time_ms"),
        (HEAD + "0,1,1\n" * 3, "3 rows"),
        (HEAD + "".join(f"{min(i, 9)},1,1\n" for i in range(30)), "line 12"),
        (HEAD + "".join(f"{i},1,1\n" for i in range(9)) + "9,,1\n", "line 11"),
        (HEAD + "1,nan,1\n" * 30, "depth_mm in line 2"),
    ],
)
def test_a_bad_record_is_refused_by_what_is_wrong(tmp_path, text, words):
    path = tmp_path / "record.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_record(path)


def test_units_in_the_names_of_the_columns_count(tmp_path):
    path = tmp_path / "record.csv"
    rows = "".join(f"{i},{i * 10},{i / 1000},x\n" for i in range(25))
    path.write_text("time_ms,depth_um,force_N,remark\n" + rows)
    read = read_record(path)
    np.testing.assert_allclose(read.time[1], 1e-3)
    np.testing.assert_allclose(read.depth[1], 0.01)
    np.testing.assert_allclose(read.force[1], 1.0)


def test_a_probe_beside_the_body_is_refused(network):
    time = np.linspace(0.1, 5, 30)
    blank = Record(time, 0.1 * np.ones(30), np.ones(30))
    with pytest.raises(InputError, match="cannot be followed at 0.1 s"):
        identify(Pressed(*network, blank, (90.0, 0.0, 0.0), RADIUS))
