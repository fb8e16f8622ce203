"""The split of hard interactions: a part of the dataset like the others, that changes none of
them."""

import contextlib
import io
import json
import runpy
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from fem.contact.draw import draw_contacts
from fem.contact.surface import surface_of
from fem.contact.table import contact_table
from fem.data.dataset import open_dataset
from fem.data.scene import load_scene
from fem.data.write import groups
from fem.errors import InputError
from fem.generate import main


@pytest.fixture(scope="module")
def made(tiny_dataset, tmp_path_factory):
    """(dataset, what the command printed) of the scene `tiny` with a hard set of two."""
    folder, scene = tmp_path_factory.mktemp("hard_set"), open_dataset(tiny_dataset).scene
    scene = replace(scene, interactions=replace(scene.interactions, hard_set=2))
    (folder / "hard.toml").write_text(scene.toml())
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        main([str(folder / "hard.toml"), "--out", str(folder / "hard.h5"), "--workers", "1"])
    return open_dataset(folder / "hard.h5"), printed.getvalue()


def test_the_other_splits_are_the_same_to_the_bit_with_a_hard_set_and_without(made, tiny_dataset):
    assert made[0].split.tolist()[4:] == ["hard"] * 2 and made[0].number.tolist()[4:] == [1, 2]
    with h5py.File(made[0].path) as ours, h5py.File(tiny_dataset) as theirs:
        for name in ("force", "displacement", "volume", "energy", "contacts", "number", "hard"):
            assert np.array_equal(ours[name][:4], theirs[name][()]), name


def test_hard_interactions_are_read_like_any_other(made):
    """Fields, contacts and the sequence of the split; all of it is hard and none of it drawn
    twice."""
    dataset, _ = made
    fields, frames = dataset.read("hard"), len(dataset.time)
    assert fields["hard"].all() and fields["number"].tolist() == [1, 2]
    assert fields["displacement"].shape == (2, frames, *dataset.grid, 3)
    forces = np.concatenate([fields["force"], dataset.read("test")["force"]])
    assert len(np.unique(forces.reshape(3, -1), axis=0)) == 3
    sequence = dataset.sequence("hard", 2)
    on_grid = np.stack([dataset.mesh.grid.to_grid(frame) for frame in sequence.force])
    assert np.array_equal(on_grid, fields["force"][1])
    with pytest.raises(InputError, match="no hard interaction 3; it has .*, hard 1 to 2"):
        dataset.sequence("hard", 3)


def test_hard_contacts_come_from_a_stream_of_their_own_and_reach_beyond_training(made):
    """The file's contacts are those of seed, split, number and the first fit attempt; every peak is
    hard_force times the largest of the range."""
    dataset, _ = made
    scene, surface = dataset.scene, surface_of(dataset.fem_mesh)
    low, high = np.array(scene.interactions.hard_force) * scene.contact.force[1]
    for number in (1, 2):
        contacts = dataset.contacts("hard", number)
        assert all(low <= contact.peak <= high for contact in contacts)
        draws = [
            draw_contacts(
                surface,
                scene.contact,
                scene.frames.duration,
                np.random.default_rng([1, 3, number, attempt]),
                scene.interactions.hard_force,
            )
            for attempt in range(20)
        ]
        assert any(np.array_equal(contact_table(draw), contact_table(contacts)) for draw in draws)


def test_refused_draws_are_counted_by_split_and_printed(made):
    """Those of the test's hard numbers are counted apart from its others."""
    dataset, printed = made
    with h5py.File(dataset.path) as file:
        total = json.loads(file.attrs["rejected"])
    assert list(dataset.rejected) == ["train", "validation", "test, hard", "hard"]
    for reason, count in total.items():
        assert count == sum(counts.get(reason, 0) for counts in dataset.rejected.values())
    count = sum(dataset.rejected["hard"].values())
    assert count > 0 and f"  hard: {count} for 2 interactions (crushed cell" in printed
    count = sum(dataset.rejected["test, hard"].values())
    assert f"  test, hard: {count} for 1 interactions" in printed
    scene = load_scene("configs/tumour_tiny.toml")
    assert groups(scene)[6:] == ["validation"] * 2 + ["test"] * 2 + ["test, hard"]


def test_a_file_without_the_split_says_how_to_get_it(tiny_dataset, tmp_path):
    dataset = open_dataset(tiny_dataset)
    with pytest.raises(InputError, match="no hard interactions; set interactions.hard_set"):
        dataset.read("hard")
    with pytest.raises(InputError, match="has no hard interaction 1; .* test 1 to 1$"):
        dataset.contacts("hard", 1)
    old = tmp_path / "old.h5"
    old.write_bytes(tiny_dataset.read_bytes())
    with h5py.File(old, "r+") as file:
        del file.attrs["rejected_by_split"]
    assert open_dataset(old).rejected == {}


def test_a_hard_interaction_is_exported(made, tmp_path, request):
    tool = runpy.run_path(str(Path(request.config.rootpath, "tools/export.py")))["main"]
    tool([str(made[0].path), str(tmp_path), "--split", "hard", "--interaction", "2"])
    assert (tmp_path / "hard-0002.pvd").is_file()
