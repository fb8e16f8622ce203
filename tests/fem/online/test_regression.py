"""A regression as a file and as a stepper."""

from dataclasses import fields, replace

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.creep import Creep, remembered_force
from fem.online.regression import FORMAT, FORMAT_1, Regression, RegressionStepper
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
CREEP = Creep.of(((0.12, 330.0), (0.8, 11.0)))
REMEMBERING = replace(LINEAR, interval=0.1).remembering(CREEP)
ELASTIC = replace(LINEAR, elastic=True)


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


@pytest.mark.parametrize("model", [LINEAR, POD, REMEMBERING, ELASTIC])
def test_a_saved_regression_is_the_same(model, tmp_path):
    model.save(tmp_path / "regression.npz")
    again = Regression.load(tmp_path / "regression.npz")
    for field in fields(Regression):
        before, after = getattr(model, field.name), getattr(again, field.name)
        np.testing.assert_array_equal(after, before, strict=isinstance(before, np.ndarray))
        assert type(after) is type(before)
    assert again.family == model.family and again.parameters == model.parameters


def test_only_files_that_need_it_are_of_the_new_format(tmp_path):
    for model, form in ((LINEAR, FORMAT_1), (POD, FORMAT_1), (REMEMBERING, FORMAT)):
        model.save(tmp_path / "regression.npz")
        with np.load(tmp_path / "regression.npz") as file:
            assert str(file["format"]) == form
            assert ("creep" in file.files) == (form == FORMAT) and "elastic" not in file.files


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
    np.savez(path, format="unet-fem regression 3", mask=MASK)
    with pytest.raises(InputError, match="unet-fem regression 2"):
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
    for wrong in (np.ones((2, 3)), np.array([[1.0, -2.0]]), np.array([[np.nan, 2.0]])):
        with pytest.raises(InputError, match="creep is of shape"):
            replace(LINEAR, creep=wrong)


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


def test_elastic_tissue_builds_no_memory():
    body = RegressionStepper(LINEAR.remembering(Creep.of(())))
    assert body.memory is None and body.state().keys() == {"forces"}


def test_a_remembering_stepper_answers_the_remembered_force():
    body = RegressionStepper(REMEMBERING)
    assert isinstance(body, Stepper)
    answers = np.array([body.step(force) for force in FORCE])
    remembered = remembered_force(CREEP, FORCE.reshape(7, -1).astype(float), 0.1)
    expected = REMEMBERING(remembered.reshape(FORCE.shape).astype("float32"))
    np.testing.assert_allclose(answers, expected, rtol=1e-5, atol=1e-5)
    body.reset()
    np.testing.assert_array_equal(body.step(FORCE[0]), answers[0])


def test_a_remembering_stepper_takes_any_interval_and_two_halves_are_a_whole():
    whole, halves = RegressionStepper(REMEMBERING), RegressionStepper(REMEMBERING)
    expected = whole.step(FORCE[0])
    halves.step(FORCE[0] / 2, 0.05)
    np.testing.assert_allclose(halves.step(FORCE[0], 0.05), expected, rtol=1e-5, atol=1e-5)
    for wrong in (0.0, -0.1, np.nan):
        with pytest.raises(InputError, match="positive"):
            halves.step(FORCE[0], wrong)
    windowed = RegressionStepper(POD.remembering(CREEP))
    with pytest.raises(InputError, match="0.1 s between calls"):
        windowed.step(FORCE[0], 0.05)


def test_the_memory_is_part_of_the_state(tmp_path):
    body = RegressionStepper(REMEMBERING)
    body.step(FORCE[0])
    kept = body.state()
    after = body.step(FORCE[1])
    np.savez(tmp_path / "state.npz", **kept)
    again = RegressionStepper(REMEMBERING)
    with np.load(tmp_path / "state.npz") as file:
        again.restore(dict(file))
    np.testing.assert_array_equal(again.step(FORCE[1]), after)
    with pytest.raises(InputError, match="the state holds nothing as remembered"):
        again.restore({"forces": kept["forces"]})


def test_the_elastic_answer_refuses_forces_that_it_does_not_know():
    body = RegressionStepper(ELASTIC.remembering(CREEP))
    known = np.zeros(72, "float32")
    known[ELASTIC.active] = 1.0
    known.reshape(*GRID, 3)[~MASK] = 2.0  # fixed nodes do not move, whatever acts on them
    body.step(known.reshape(*GRID, 3), 0.1)
    before = body.state()["remembered"]
    free = np.repeat(MASK.ravel(), 3)
    free[ELASTIC.active] = False
    wrong = known.copy()
    wrong[np.flatnonzero(free)[0]] = 1e-3
    with pytest.raises(InputError, match="not on the contact surface"):
        body.step(wrong.reshape(*GRID, 3), 0.1)
    np.testing.assert_array_equal(body.state()["remembered"], before)
