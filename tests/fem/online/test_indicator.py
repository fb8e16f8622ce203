"""The residual tells how far a displacement is from the truth, whoever gave it."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.indicator import ErrorIndicator
from fem.online.reduced import ReducedStepper


@pytest.fixture
def frames(whole_model, block):
    """Forces of a push that grows and goes, and their true displacements, 0.25 s apart."""
    nodes = np.flatnonzero(block.loaded)[5:9]
    stepper = ReducedStepper(whole_model, 0.25, tolerance=1e-6, most=60)
    forces = []
    for size in (0.1, 0.2, 0.4, 0.3, 0.1):
        force = np.zeros(block.points.shape, "float32")
        force[nodes, 2] = -size / 4
        forces.append(force)
    return [(force, stepper.step(force)) for force in forces]


def test_the_truth_has_next_to_no_residual(whole_model, frames):
    indicator = ErrorIndicator(whole_model)
    for force, truth in frames:
        assert indicator(force, truth, 0.25) < 2e-3 * np.linalg.norm(truth)


@pytest.mark.parametrize("size", [0.02, 0.1, 0.3])
def test_an_error_of_any_kind_is_estimated(whole_model, block, frames, size):
    rng, indicator = np.random.default_rng(0), ErrorIndicator(whole_model)
    low = np.sin(block.points @ rng.normal(size=(3, 3)) * 1e3)
    for force, truth in frames:
        error = np.where(block.fixed[:, None], 0, low)
        error *= size * np.linalg.norm(truth) / np.linalg.norm(error)
        estimate = indicator(force, (truth + error).astype("float32"), 0.25)
        assert 0.4 < estimate / np.linalg.norm(error) < 2.5


def test_it_takes_grids_and_forgets(whole_model, block, frames):
    indicator = ErrorIndicator(whole_model)
    first = [indicator(force, 0.9 * truth, 0.25) for force, truth in frames]
    indicator.reset()
    on_grid = block.grid.to_grid
    again = [indicator(on_grid(f), on_grid(np.float32(0.9) * u), 0.25) for f, u in frames]
    assert np.allclose(again, first, rtol=1e-4)


def test_crushed_tissue_is_infinitely_far(whole_model, block, frames):
    indicator, (force, truth) = ErrorIndicator(whole_model), frames[0]
    estimate = indicator(force, truth * 1e14, 0.25)
    assert estimate > 1e20
    assert np.isfinite(indicator(force, truth, 0.25))


def test_bad_input_is_refused(whole_model, frames):
    indicator, (force, truth) = ErrorIndicator(whole_model), frames[0]
    with pytest.raises(InputError, match="displacement is float32 of shape"):
        indicator(force, truth[:-1], 0.25)
    with pytest.raises(InputError, match="displacement holds values that are not finite"):
        indicator(force, truth * np.nan, 0.25)
    with pytest.raises(InputError, match="positive"):
        indicator(force, truth, 0.0)
