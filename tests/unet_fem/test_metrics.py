"""The one relative L2 error."""

import numpy as np
import pytest

from unet_fem.metrics import relative_l2, relative_l2_of_sums, squares


def test_relative_l2_is_its_definition():
    truth = np.random.default_rng(0).normal(size=(3, 4))
    assert relative_l2(1.1 * truth, truth) == pytest.approx(0.1)
    assert relative_l2(0 * truth, truth) == 1
    assert relative_l2_of_sums(squares(truth), 4 * squares(truth)) == 0.5


def test_sums_are_taken_in_float64():
    truth = np.full(4_000_000, 1.0, "float32")
    assert squares(truth[:3] * np.float32(1e-30)) == pytest.approx(3e-60, rel=1e-6)
    assert relative_l2(np.float32(1.5) * truth, truth) == 0.5


def test_a_truth_that_does_not_move_has_no_relative_error():
    assert relative_l2(np.ones(3), np.zeros(3)) is None
