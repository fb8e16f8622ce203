"""Readings of the data: what is learned from, what leaks, and that the usual one pays nothing."""

import numpy as np
import pytest

from fem.data.dataset import open_dataset
from fem.errors import InputError
from unet_fem.training.readings import leaking, read_as, rows_of
from unet_fem.training.samples import training_samples
from unet_fem.training.settings import SampleChoice

SIZES, FRAMES = (58 * 21, 14 * 21), 21
B = SampleChoice(split="frames")


def test_whole_interactions_do_not_leak_and_are_left_as_they_are(unseen_dataset):
    dataset = open_dataset(unseen_dataset)
    own = training_samples(dataset, 2)
    read = read_as(*own, len(dataset.time), SampleChoice())
    assert read[0] is own[0] and read[1] is own[1]
    assert leaking(*rows_of(SIZES, FRAMES, SampleChoice()), FRAMES) == 0


def test_frames_at_random_keep_their_number_and_nearly_all_have_a_neighbour():
    learn, validate = rows_of(SIZES, FRAMES, B)
    assert (len(learn), len(validate)) == SIZES
    assert np.array_equal(np.sort(np.concatenate([learn, validate])), np.arange(sum(SIZES)))
    # of a frame's two neighbours each is learned from in 81 of 100 cases
    assert leaking(learn, validate, FRAMES) == pytest.approx(1 - 0.19**2, abs=0.03)
    assert not np.array_equal(learn, rows_of(SIZES, FRAMES, SampleChoice("frames", seed=1))[0])
    again = rows_of(SIZES, FRAMES, B)
    assert np.array_equal(learn, again[0])


def test_a_window_keeps_the_true_frames_before_its_last(unseen_dataset):
    """Only targets are dealt out: the sample of each frame is the one that it is in its
    interaction."""
    dataset = open_dataset(unseen_dataset)
    train, validation = training_samples(dataset, 2)
    frames = len(dataset.time)
    learn, validate = read_as(train, validation, frames, B)
    rows = rows_of((len(train), len(validation)), frames, B)
    whole = np.concatenate([train.force, validation.force])
    for found, own in zip((learn, validate), rows, strict=True):
        np.testing.assert_array_equal(found.force, whole[own])
    np.testing.assert_array_equal(
        validate.displacement,
        np.concatenate([train.displacement, validation.displacement])[rows[1]],
    )
    assert set(np.concatenate([learn.interaction, validate.interaction])) == {1, 2}


def test_a_few_frames_of_each_interaction():
    learn, validate = rows_of(SIZES, FRAMES, SampleChoice(each=3))
    assert (len(learn), len(validate)) == (58 * 3, 14 * 3)
    assert (np.bincount(learn // FRAMES) == 3).all() and learn.max() < SIZES[0] <= validate.min()
    assert leaking(learn, validate, FRAMES) == 0
    assert len(rows_of(SIZES, FRAMES, SampleChoice(each=99))[0]) == SIZES[0]


def test_what_is_no_reading_is_refused():
    for own in ({"split": "windows"}, {"each": -1}):
        with pytest.raises(InputError, match="samples"):
            SampleChoice(**own)
