"""A regression as a file and as a stepper."""

from dataclasses import fields, replace

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.regression import Regression, RegressionStepper
from fem.online.stepper import Stepper

GRID = (3, 4, 2)
rng = np.random.default_rng(0)
MASK = rng.random(GRID) > 0.3
FREE = int(MASK.sum())
FORCE = rng.normal(size=(7, *GRID, 3)).astype("float32")


def numbers(*shape):
    return rng.normal(size=shape).astype("float32")


LINEAR = Regression(MASK, np.arange(0, 72, 5), numbers(15, 3 * FREE))
POD = Regression(
    MASK,
    np.arange(0, 144, 7),
    numbers(21, 4),
    modes=numbers(4, 3 * FREE),
    squares=numbers(21, 4),
    steps=2,
    interval=0.1,
    index=np.flatnonzero(MASK),
)


def test_the_answer_is_its_equation():
    window = rng.normal(size=(5, 2, *GRID, 3)).astype("float32")
    f = window.reshape(5, -1)[:, POD.active]
    expected = (f @ POD.kernel + f**2 @ POD.squares) @ POD.modes
    answer = POD(window)
    np.testing.assert_allclose(answer[:, MASK].reshape(5, -1), expected, rtol=1e-5)
    assert not answer[:, ~MASK].any()
    f = FORCE.reshape(7, -1)[:, LINEAR.active]
    np.testing.assert_allclose(
        LINEAR.predict(FORCE)[:, MASK].reshape(7, -1), f @ LINEAR.kernel, rtol=1e-5
    )


@pytest.mark.parametrize("model", [LINEAR, POD])
def test_a_saved_regression_is_the_same(model, tmp_path):
    model.save(tmp_path / "regression.npz")
    again = Regression.load(tmp_path / "regression.npz")
    for field in fields(Regression):
        before, after = getattr(model, field.name), getattr(again, field.name)
        np.testing.assert_array_equal(after, before, strict=isinstance(before, np.ndarray))
        assert type(after) is type(before)
    assert again.family == model.family and again.parameters == model.parameters


def test_a_file_that_is_no_regression_is_refused(tmp_path):
    path = tmp_path / "regression.npz"
    with pytest.raises(InputError, match="no regression"):
        Regression.load(path)
    POD.save(path)
    whole = path.read_bytes()
    for damaged in (b"", b"nothing", whole[: len(whole) // 2]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="regression.npz is not a whole"):
            Regression.load(path)
    np.savez(path, format="unet-fem regression 2", mask=MASK)
    with pytest.raises(InputError, match="unet-fem regression 1"):
        Regression.load(path)
    np.savez(path, format="unet-fem regression 1", mask=MASK)
    with pytest.raises(InputError, match="damaged.*kernel"):
        Regression.load(path)
    np.savez(path, format="unet-fem regression 1", mask=np.array([object()]))  # a pickle
    with pytest.raises(InputError, match="not a whole"):
        Regression.load(path)


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="kernel has shape"):
        replace(LINEAR, kernel=LINEAR.kernel[:, :-1])
    with pytest.raises(InputError, match="squares has shape"):
        replace(POD, squares=POD.squares[:-1])
    with pytest.raises(InputError, match="modes has shape"):
        replace(POD, modes=POD.modes[:, 1:])
    with pytest.raises(InputError, match="active"):
        replace(POD, steps=None)


@pytest.mark.parametrize("model", [LINEAR, POD])
def test_steps_are_the_answers_to_the_windows(model):
    body = RegressionStepper(model)
    assert isinstance(body, Stepper)
    answers = np.array([body.step(force) for force in FORCE])
    past = np.concatenate([np.zeros_like(FORCE[:1]), FORCE[:-1]])
    window = FORCE if model.steps is None else np.stack([past, FORCE], axis=1)
    np.testing.assert_allclose(answers, model(window), rtol=1e-5, atol=1e-5)
    body.reset()
    np.testing.assert_array_equal(body.step(FORCE[0]), answers[0])


def test_a_restored_state_goes_on_exactly(tmp_path):
    body = RegressionStepper(POD)
    body.step(FORCE[0])
    kept = body.state()
    after = body.step(FORCE[1])
    body.step(FORCE[2])
    np.savez(tmp_path / "state.npz", **kept)
    with np.load(tmp_path / "state.npz") as file:
        body.restore(dict(file))
    np.testing.assert_array_equal(body.step(FORCE[1]), after)
    with pytest.raises(InputError, match="the state holds"):
        body.restore(RegressionStepper(LINEAR).state())
    with pytest.raises(InputError, match="the state holds nothing"):
        body.restore({})


def test_nodes_and_grid_are_answered_alike(tmp_path):
    POD.save(tmp_path / "regression.npz")
    bodies = [RegressionStepper.open(tmp_path / "regression.npz") for _ in range(2)]
    nodal = FORCE[0].reshape(-1, 3)[POD.index].astype("float64")
    grid = POD.grid.to_grid(nodal)
    at_nodes, on_grid = bodies[0].step(nodal), bodies[1].step(grid)
    assert at_nodes.shape == (FREE, 3) and on_grid.shape == (*GRID, 3)
    np.testing.assert_array_equal(at_nodes, on_grid.reshape(-1, 3)[POD.index])


def test_a_refused_step_leaves_the_window_as_it_was():
    body = RegressionStepper(POD)
    body.step(FORCE[0])
    before = body.state()["forces"]
    wrong = FORCE[1].copy()
    wrong[0, 0, 0, 0] = np.nan
    for force, dt, words in (
        (wrong, None, "finite"),
        (FORCE[1][1:], None, "shape"),
        (FORCE[1] > 0, None, "real numbers"),
        (FORCE[1], 0.2, "0.1 s between calls"),
        (FORCE[1], -0.1, "positive"),
    ):
        with pytest.raises(InputError, match=words):
            body.step(force, dt)
    np.testing.assert_array_equal(body.state()["forces"], before)
    body.step(FORCE[1], 0.1)
