"""Regressions in closed form: they are the ridge solution, and find linear and quadratic maps."""

import numpy as np
import pytest

from fem.errors import InputError
from unet_fem.networks import ridge
from unet_fem.networks.pod import linear, pod
from unet_fem.networks.registry import network
from unet_fem.training.samples import Samples

GRID = (5, 4, 3)
MASK = np.random.default_rng(1).random(GRID) > 0.4


def problem(samples, steps=None, noise=0.0, seed=0):
    """Samples of a known linear map from four loaded nodes to the free nodes of the grid."""
    rng = np.random.default_rng(seed)
    window = () if steps is None else (steps,)
    force = np.zeros((samples, *window, *GRID, 3), "float32")
    force[..., 1:3, 1:3, 2, :] = rng.normal(size=(samples, *window, 2, 2, 3))
    X = force.reshape(samples, -1)
    kernel = np.random.default_rng(2).normal(size=(X.shape[1], 5 * 4 * 3 * 3))
    Y = (X.astype("float64") @ kernel).reshape(samples, *GRID, 3)
    Y = (Y + noise * rng.normal(size=Y.shape)) * MASK[..., None]
    count = np.zeros(samples)
    return Samples(force, Y.astype("float32"), count, count > 0, count)


def columns(samples):
    X = samples.force.reshape(len(samples), -1).astype("float64")
    return X[:, X.any(axis=0)], samples.displacement[:, MASK].reshape(len(samples), -1)


@pytest.mark.parametrize("steps", [None, 2])
def test_linear_regression_recovers_a_linear_map(steps):
    train, unseen = problem(60, steps), problem(20, steps, seed=5)
    model = linear(train, problem(20, steps, seed=6), MASK)
    assert model.input_shape == (None, *train.force.shape[1:]) and model.steps == steps
    predicted = model(unseen.force)
    size = np.abs(unseen.displacement).max()
    np.testing.assert_allclose(predicted, unseen.displacement, atol=1e-4 * size)
    assert np.all(predicted[:, ~MASK] == 0) and np.all(model(0 * unseen.force) == 0)


@pytest.mark.parametrize("samples", [8, 40])  # fewer and more than the 12 loaded components
def test_ridge_is_the_solution_of_the_normal_equations(samples):
    X, Y = columns(problem(samples, noise=0.1))
    kernel, _ = ridge.fit(X, Y, 0.03)
    penalty = 0.03 * np.linalg.norm(X, 2) ** 2
    expected = np.linalg.solve(X.T @ X + penalty * np.eye(X.shape[1]), X.T @ Y)
    np.testing.assert_allclose(kernel, expected, atol=1e-10)


def test_ridge_of_nothing_has_the_least_norm():
    X, Y = columns(problem(5))
    X, Y = np.concatenate(3 * [X]), np.concatenate(3 * [Y])
    least = np.linalg.pinv(X, rcond=1e-10) @ Y
    np.testing.assert_allclose(ridge.fit(X, Y, 0.0)[0], least, atol=1e-5)


def test_linear_regression_is_the_best_ridge_on_the_validation_data():
    train, validation = problem(14, noise=5.0), problem(46, noise=5.0, seed=3)
    (X, Y), shown = columns(train), columns(validation)
    kernels = [ridge.fit(X, Y, value)[0] for value in ridge.RIDGES]
    errors = [np.sum((shown[0] @ kernel - shown[1]) ** 2) for kernel in kernels]
    model = linear(train, validation, MASK)
    np.testing.assert_allclose(model.kernel, kernels[int(np.argmin(errors))], atol=1e-5)
    predicted = model(validation.force)[:, MASK].reshape(len(validation), -1)
    np.testing.assert_allclose(predicted, shown[0] @ model.kernel, atol=1e-4)


def test_rows_fit_what_they_name():
    train, validation = problem(40), problem(20, seed=4)
    options = network("pod").options(modes=5, quadratic=False)
    found = network("pod").fit(train, validation, MASK, options)
    same = pod(train, validation, MASK, modes=5, quadratic=False)
    np.testing.assert_array_equal(found(train.force), same(train.force))
    assert found.family == "POD" and len(found.modes) == 5
    full = network("linear").fit(train, validation, MASK, network("linear").options())
    assert full.family == "linear"
    with pytest.raises(InputError, match="trained, not fitted"):
        network("unet").fit(train, validation, MASK, network("unet").options())


def test_what_cannot_be_fitted_is_refused():
    train = problem(5)
    with pytest.raises(InputError, match="2 values of ridge"):
        ridge.fit(*columns(train), [0.1, 0.2])
    nothing = Samples(*(0 * values for values in vars(train).values() if values is not None))
    with pytest.raises(InputError, match="all 5 training forces are zero"):
        linear(nothing, nothing, MASK)
