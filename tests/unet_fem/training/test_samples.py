"""From interactions to samples, windows and batches."""

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from unet_fem.training import samples as data


def test_windows_end_at_their_frame_and_begin_at_rest():
    force = (
        np.arange(2 * 3, dtype=float).reshape(2, 3, 1, 1, 1, 1) + 1
    )  # interactions 1 2 3 and 4 5 6
    assert data.windows(force, 2).reshape(6, 2).tolist() == [
        [0, 1],
        [1, 2],
        [2, 3],
        [0, 4],
        [4, 5],
        [5, 6],
    ]
    assert data.windows(force, None).ravel().tolist() == [1, 2, 3, 4, 5, 6]
    assert data.windows(force, 4).reshape(6, 4)[2].tolist() == [0, 1, 2, 3]


def test_batches_hold_every_sample_once_an_epoch_in_an_order_that_a_resumed_run_repeats():
    x = np.arange(10)
    stream = data.batches(x, x, 4, seed=3)
    epochs = [np.concatenate([next(stream)[0] for _ in range(3)]) for _ in range(3)]
    assert all(sorted(epoch) == list(x) for epoch in epochs)
    assert not np.array_equal(epochs[0], epochs[1])
    resumed = data.batches(x, x, 4, seed=3, first_epoch=2)
    assert np.array_equal(np.concatenate([next(resumed)[0] for _ in range(3)]), epochs[2])


def test_forces_that_are_all_zero_are_named():
    nothing = np.zeros((2, 3, 3, 3, 3), "float32")
    with pytest.raises(InputError, match="contact.force"):
        data.scales(data.Samples(nothing, nothing, np.zeros(2), np.zeros(2, bool), np.ones(2)))


def test_hard_interactions_are_learned_from_where_that_is_asked_for(unseen_dataset):
    dataset = open_dataset(unseen_dataset)
    usual, validation = data.training_samples(dataset, None)
    both, same = data.training_samples(dataset, None, hard=1)
    frames = dataset.scene.frames.count
    assert len(both) == len(usual) + frames and len(same) == len(validation)
    assert both.hard.sum() == frames and not usual.hard.any()
    hard = dataset.read("hard", numbers=[1])
    np.testing.assert_array_equal(both.force[-frames:], hard["force"][0])
    np.testing.assert_array_equal(both.displacement[-frames:], hard["displacement"][0])
