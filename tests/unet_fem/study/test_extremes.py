"""Far from what was learned a cell ends as right, put right, flagged, or wrong without a word."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import SolverStopped, Stop
from unet_fem.study.measure import extremes
from unet_fem.study.measure.extremes import AT_REST, TOLERANCE, judge

DT = 0.2


class Scaled:
    """A stepper that answers `sizes` times the force, a size a call, and flags what `flags` says;
    with one evaluation a frame it errs by as much again as `hasty` says."""

    interval = None
    evaluations = 3

    def __init__(self, sizes, flags=(), most=1, hasty=0.0):
        self.sizes, self.flags, self.most, self.hasty = sizes, flags, most, hasty

    def reset(self):
        self.call = 0

    def step(self, force, dt=None):
        size = self.sizes[self.call % len(self.sizes)]
        if size is None:
            raise SolverStopped.because(Stop.DIVERGED, "no equilibrium")
        self.flagged = self.call in self.flags
        self.call += 1
        return (size + self.hasty * (self.most == 1)) * force


@pytest.fixture
def dataset(tiny_dataset):
    return open_dataset(tiny_dataset)


@pytest.fixture
def force(dataset):
    return dataset.read("test")["force"][0]


@pytest.mark.parametrize(
    ("own", "outcome"),
    [
        (Scaled([1.0]), "accurate"),
        (Scaled([1.04]), "accurate"),
        (Scaled([1.0], most=8, hasty=0.5), "corrected"),
        (Scaled([1.0], most=8, hasty=0.01), "accurate"),
        (Scaled([1.5], flags=range(9)), "flagged"),
        (Scaled([1.0, 1.0, 1.5]), "silently wrong"),
        (Scaled([1.5], flags=[2]), "silently wrong"),  # of two wrong frames one says nothing
        (Scaled([np.nan]), "silently wrong"),
        (Scaled([1.0, None]), "stopped"),
    ],
)
def test_every_cell_ends_in_one_of_five_ways(dataset, force, own, outcome):
    cell = extremes._cell(lambda: own, force, force, DT, dataset, slice(None))
    assert cell["outcome"] == outcome and outcome in extremes.OUTCOMES
    assert (cell["error"] is None) == (outcome == "stopped")
    assert (cell["reason"] is not None) == (outcome in ("flagged", "stopped"))


def test_frames_are_judged_each_by_its_own_size_and_those_at_rest_not_at_all():
    truth = np.array([0.05, 1.0, 2.0])[:, None] * np.ones((3, 4))
    answer = truth + np.array([0.05, 0.04, 0.12])[:, None]
    error, worst, wrong = judge(answer, truth)
    assert wrong.tolist() == [False, False, True] and worst == pytest.approx(0.06)
    assert error == pytest.approx(np.sqrt(0.0185 / 5.0025)) and worst > TOLERANCE
    error, worst, wrong = judge(np.full((2, 4), AT_REST), np.zeros((2, 4)))
    assert error is None and worst is None and wrong.all()  # a norm of twice as much


def test_the_loads_differ_from_one_another_and_start_at_rest(dataset):
    own = extremes.loads(dataset)
    assert len(own) > extremes.KNOWN
    late = {name: load(1.0) for name, load in own.items()}
    for name, load in own.items():
        assert np.abs(load(0.0)).max() == 0 and np.isfinite(late[name]).all(), name
    flips = own["sign flips every frame"]
    interval = dataset.scene.frames.interval
    np.testing.assert_allclose(flips(interval), -flips(2 * interval))
    fields = [field.tobytes() for name, field in late.items() if name != "sign flips every frame"]
    assert len(set(fields)) == len(fields)


def test_long_and_short_frames_have_the_same_answer(dataset):
    """The truth at frames of 25 ms and of 250 ms is the same push, but for the straight lines
    between the frames."""
    found = {}
    for dt in (0.025, 0.25):
        force, truth, kept = extremes._of_frames(dataset, dt)
        assert len(force[kept]) == len(truth)
        found[dt] = truth[-1]
    assert np.linalg.norm(found[0.025] - found[0.25]) < 0.02 * np.linalg.norm(found[0.25])


def test_what_cannot_be_told_another_tissue_has_no_cell(dataset):
    (name, tissue, _), *_ = extremes.tissues(dataset)
    assert extremes._with(lambda: Scaled([1.0]), tissue, dataset)() is None
    told = SimpleNamespace(set_material=lambda *given: setattr(told, "given", given))
    assert extremes._with(lambda: told, tissue, dataset)() is told
    assert told.given == (tissue.mu, tissue.K, tissue.prony)
