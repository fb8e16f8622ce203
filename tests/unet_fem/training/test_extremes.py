"""Loads that no training set holds: the FEM's answer, and models beside it."""

from dataclasses import replace

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import SolverStopped, Stop
from unet_fem.training.extremes import (
    FRAMES,
    extreme_loads,
    extremes_table,
    fem_response,
    judge_extremes,
)

MIDDLE, PULL = "largest training force", "sign flipped (pull)"


@pytest.fixture(scope="module")
def dataset(tiny_dataset):
    return open_dataset(tiny_dataset)


@pytest.fixture(scope="module")
def loads(dataset):
    return extreme_loads(dataset.fem_mesh, dataset.scene.contact)


def test_no_force_moves_nothing_and_a_force_moves_with_it(dataset, loads):
    force, u, volume = fem_response(dataset, loads["zero force"])
    assert force.shape == u.shape == (FRAMES, *dataset.grid, 3) and not u.any()
    assert np.ptp(volume) == 0
    pushed, pulled = (fem_response(dataset, loads[name]) for name in (MIDDLE, PULL))
    np.testing.assert_array_equal(pushed[0], -pulled[0])
    assert np.vdot(pushed[0], pushed[1]) > 0 and np.vdot(pulled[0], pulled[1]) > 0
    assert np.vdot(pushed[1], pulled[1]) < 0


def test_a_crushed_cell_counts_as_a_stop(dataset, loads):
    with pytest.raises(SolverStopped) as stop:
        fem_response(dataset, lambda t: 8 * loads[MIDDLE](t))
    assert stop.value.reason in (Stop.CRUSHED_CELL, Stop.INVERTED_CELL, Stop.DIVERGED)


def test_an_answer_that_no_dataset_would_take_counts_as_a_stop(dataset, loads):
    """The mass is scaled so high that inertia carries the load, and no cell is crushed."""
    heavy = replace(dataset.scene, solver=replace(dataset.scene.solver, mass_scaling=1024.0))
    with pytest.raises(SolverStopped, match="lower solver.mass_scaling") as stop:
        fem_response(replace(dataset, scene=heavy), loads[MIDDLE])
    assert stop.value.reason is Stop.DISEQUILIBRIUM


def test_a_model_that_answers_nothing_is_wholly_wrong(dataset):
    nothing = np.zeros((FRAMES, *dataset.grid, 3), np.float32)
    result = judge_extremes({"still": lambda window: nothing}, dataset, None)
    assert result["zero force"]["still"]["relative_l2"] is None
    judged = [case for case in result.values() if "still" in case and case["FEM"]["largest_mm"]]
    assert judged
    for case in judged:
        assert case["still"]["relative_l2"] == pytest.approx(1.0)
        assert case["still"]["worst_mm"] == pytest.approx(case["FEM"]["largest_mm"])
        assert case["still"]["volume_violation_max"] < 1e-5
    text = extremes_table(result, ["still"])
    assert all(name in text for name in result) and ("stopped" in text) == any(
        "stopped" in case["FEM"] for case in result.values()
    )
