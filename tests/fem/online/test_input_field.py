"""What a network sees in place of the force: one frame at a time as whole interactions, kept in a
file."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.creep import Creep, remembered_force
from fem.online.input_field import InputField
from fem.online.regression import Regression

GRID = (3, 4, 2)
rng = np.random.default_rng(0)
MASK = rng.random(GRID) > 0.3
CREEP = Creep.of(((0.12, 330.0), (0.8, 11.0)))
ACTIVE = np.flatnonzero(np.repeat(MASK.ravel(), 3))[::2]
KERNEL = rng.normal(size=(len(ACTIVE), 3 * int(MASK.sum()))).astype("float32")
ELASTIC = Regression(MASK, ACTIVE, KERNEL, elastic=True)
FORCE = np.zeros((2, 5, 72), "float32")
FORCE[..., ACTIVE] = rng.normal(size=(2, 5, len(ACTIVE)))
FORCE = FORCE.reshape(2, 5, *GRID, 3)
FIELDS = {
    "remembered": (CREEP, None),
    "elastic": (Creep.of(()), ELASTIC),
    "both": (CREEP, ELASTIC),
}


def expected(creep, elastic):
    flat = FORCE.reshape(2, 5, -1).astype(float)
    seen = remembered_force(creep, flat, 0.2).reshape(FORCE.shape)
    if elastic is None:
        return seen
    return elastic(seen.reshape(-1, *GRID, 3).astype("float32")).reshape(FORCE.shape)


@pytest.mark.parametrize("name", FIELDS)
def test_frames_and_whole_interactions_are_seen_alike(name):
    field = InputField(GRID, *FIELDS[name])
    sequences = field.sequences(FORCE, 0.2)
    assert sequences.dtype == "float32"
    np.testing.assert_allclose(sequences, expected(*FIELDS[name]), rtol=1e-5, atol=1e-5)
    field.reset()
    frames = [field.step(frame, 0.2) for frame in FORCE[1]]
    np.testing.assert_allclose(frames, sequences[1], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", FIELDS)
def test_a_saved_field_is_the_same(name, tmp_path):
    field = InputField(GRID, *FIELDS[name])
    field.save(tmp_path / "input.npz", MASK)
    again = InputField.beside(tmp_path / "best.keras")
    assert again.creep == field.creep and again.corrects == field.corrects
    np.testing.assert_array_equal(again.sequences(FORCE, 0.2), field.sequences(FORCE, 0.2))


def test_its_state_goes_on_exactly():
    field, again = (InputField(GRID, CREEP, ELASTIC) for _ in range(2))
    field.step(FORCE[0, 1], 0.2)
    again.restore(field.state())
    np.testing.assert_array_equal(again.step(FORCE[0, 2], 0.1), field.step(FORCE[0, 2], 0.1))
    assert InputField(GRID, Creep.of(()), ELASTIC).state() == {}


def test_a_file_that_is_none_is_refused(tmp_path):
    assert InputField.beside(tmp_path / "best.keras") is None
    for damaged in (b"", b"nothing"):
        (tmp_path / "input.npz").write_bytes(damaged)
        with pytest.raises(InputError, match="not a whole 'unet-fem input 1' file"):
            InputField.load(tmp_path / "input.npz")
    np.savez(tmp_path / "input.npz", format="unet-fem input 1", mask=MASK)
    with pytest.raises(InputError, match="not a whole"):
        InputField.load(tmp_path / "input.npz")


def test_a_force_elsewhere_leaves_the_memory_as_it_was():
    field = InputField(GRID, CREEP, ELASTIC)
    field.step(FORCE[0, 1], 0.2)
    before = field.state()["remembered"]
    with pytest.raises(InputError, match="not on the contact surface"):
        field.step(np.ones((*GRID, 3), "float32"), 0.2)
    np.testing.assert_array_equal(field.state()["remembered"], before)
