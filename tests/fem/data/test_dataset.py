"""The dataset file: what it holds, that it holds what was simulated, and what is refused when it is
opened."""

import dataclasses
import json
import re
import shutil

import h5py
import numpy as np
import pytest

from fem import settings as config
from fem.contact.draw import draw_contacts
from fem.contact.push import Load
from fem.contact.surface import Surface
from fem.data.dataset import FORMAT, open_dataset
from fem.data.interaction import healthy_interaction, unfit
from fem.data.scene import SPLITS, Scene
from fem.data.write import HEALTH, write_dataset
from fem.errors import InputError
from fem.mesh.shapes import tumour

GRID = (5, 5, 3)


def test_schema(tiny, tiny_dataset):
    """The file states format, scene, digest, seed, versions, rejected draws and units, and has the
    documented shapes."""
    scene = config.build(Scene, tiny)
    with h5py.File(tiny_dataset) as file:
        assert file.attrs["format"] == FORMAT
        assert file.attrs["scene"] == scene.toml() and file.attrs["scene_digest"] == scene.digest()
        assert file.attrs["seed"] == 1
        assert {"python", "numpy", "scipy", "h5py", "unet-fem"} <= json.loads(
            file.attrs["versions"]
        ).keys()
        assert sum(json.loads(file.attrs["rejected"]).values()) > 0
        units = {"force": "mN", "displacement": "mm", "volume": "mm3", "points": "mm", "time": "s"}
        assert {name: file[name].attrs["unit"] for name in units} == units
        assert file["force"].shape == file["displacement"].shape == (4, 3, *GRID, 3)
        assert file["force"].dtype == file["displacement"].dtype == np.float32
        assert file["volume"].shape == (4, 3) and file["mask"].shape == file["fixed"].shape == GRID
        assert all(file[f"health/{name}"].shape == (4,) for name in HEALTH)
        assert np.allclose(file["time"], [0, 0.2, 0.4])
        assert file["split"][()].astype(str).tolist() == ["train", "train", "validation", "test"]
        assert file["number"][()].tolist() == [1, 2, 1, 1] and file["hard"][()].tolist() == [
            False
        ] * 3 + [True]


def test_dataset_gives_back_scene_and_mesh(tiny, tiny_dataset):
    """An opened dataset holds the scene that made it, and the mesh in mm with its cells and held
    nodes."""
    dataset, scene = open_dataset(tiny_dataset), config.build(Scene, tiny)
    mesh = scene.mesh.build()
    assert dataset.scene == scene and dataset.scene.digest() == scene.digest()
    assert dataset.grid == GRID and dataset.free.sum() == (~mesh.fixed).sum()
    assert np.array_equal(dataset.mesh.cells, mesh.cells) and np.array_equal(
        dataset.mesh.fixed, mesh.fixed
    )
    assert np.allclose(dataset.mesh.points, mesh.points * 1e3, rtol=1e-6)


def test_mesh_with_holes_in_its_grid_comes_back(tiny, tmp_path):
    """The tumour, which does not fill its grid, is rebuilt from mask, points and cells alone;
    outside all is zero."""
    scene = dataclasses.replace(config.build(Scene, tiny | {"mesh": {"kind": "tumour"}}))
    mesh = tumour()
    result = healthy_interaction(
        config.build(Scene, tiny), config.build(Scene, tiny).mesh.build(), "train", 1
    )
    fields = {name: np.ones((3, mesh.n_nodes, 3), np.float32) for name in ("force", "displacement")}
    write_dataset(tmp_path / "a.h5", scene, mesh, [result | fields] * 4)
    dataset = open_dataset(tmp_path / "a.h5")
    assert dataset.mask.sum() == 1782
    assert np.array_equal(dataset.mesh.cells, mesh.cells) and np.array_equal(
        dataset.mesh.grid_index, mesh.grid_index
    )
    assert dataset.mesh.volume() == pytest.approx(mesh.volume() * 1e9, rel=1e-6)
    assert not dataset.read("train")["displacement"][:, :, ~dataset.mask].any()


def test_volume_is_that_of_the_displaced_mesh(tiny_dataset):
    """The volume of each frame, in mm3, is that of the mesh displaced by the frame's
    displacement."""
    dataset = open_dataset(tiny_dataset)
    for split in SPLITS:
        fields = dataset.read(split)
        u = dataset.mesh.from_grid(fields["displacement"]).astype(float)
        volume = [[dataset.mesh.volume(frame) for frame in sequence] for sequence in u]
        assert np.allclose(fields["volume"], volume, rtol=1e-6)
        assert np.allclose(fields["volume"][:, 0], 4 * 4 * 2, rtol=1e-9)


def test_frames_start_at_rest_and_held_nodes_stay(tiny_dataset):
    """The first frame has no displacement, later ones do, and held nodes never move."""
    dataset = open_dataset(tiny_dataset)
    u = dataset.read("train")["displacement"]
    assert not u[:, 0].any() and u[:, 1:].any()
    assert not u[:, :, dataset.fixed].any()


def test_force_is_the_drawn_contacts(tiny, tiny_dataset):
    """The force of an interaction follows from seed, split, number and attempt alone, in mN at each
    frame."""
    scene, dataset = config.build(Scene, tiny), open_dataset(tiny_dataset)
    surface, fields = Surface(scene.mesh.build()), dataset.read("train")
    for i, number in enumerate(fields["number"]):
        contacts = draw_contacts(
            surface, scene.contact, scene.frames.duration, np.random.default_rng([1, 0, number, 0])
        )
        force = np.stack([Load(surface, contacts)(t).T for t in scene.frames.times]) * 1e3
        assert np.allclose(dataset.mesh.from_grid(fields["force"][i]), force, rtol=1e-6, atol=1e-12)


def test_written_interactions_are_healthy(tiny, tiny_dataset):
    """Every interaction in the file keeps to the scene's limits of imbalance, smallest J and
    kinetic energy."""
    health = config.build(Scene, tiny).health
    with h5py.File(tiny_dataset) as file:
        assert file["health/imbalance"][()].max() <= health.imbalance
        assert file["health/min_J"][()].min() >= health.min_J
        assert file["health/kinetic_share"][()].max() <= health.kinetic_share
        assert file["health/steps"][()].min() > 100


@pytest.mark.parametrize(
    "spoil, reason",
    [
        ({"imbalance": 0.5}, "energy imbalance"),
        ({"imbalance": np.nan}, "energy imbalance"),
        ({"min_J": 0.1}, "crushed cell"),
        ({"min_J": np.nan}, "crushed cell"),
        ({"kinetic_share": 0.2}, "kinetic energy"),
        ({"volume": np.array([1.0, np.inf])}, "not finite"),
        ({}, None),
    ],
)
def test_unfit_results_are_told_apart(tiny, spoil, reason):
    """Each kind of unfit result has its reason, and a NaN is unfit, not fit."""
    good = {
        "force": np.zeros(2),
        "displacement": np.zeros(2),
        "volume": np.ones(2),
        "imbalance": 0.0,
        "min_J": 1.0,
        "kinetic_share": 0.0,
    }
    assert unfit(config.build(Scene, tiny), good | spoil) == reason


def test_unfit_draws_are_counted_and_drawn_again(tiny, tiny_dataset):
    """A tight limit rejects draws of the hard interaction; the next fit draw is taken, and the file
    counts the others."""
    scene = config.build(Scene, tiny)
    result = healthy_interaction(scene, scene.mesh.build(), "test", 1)
    assert result["rejected"]["crushed cell"] > 0 and result["min_J"] >= 0.76
    with h5py.File(tiny_dataset) as file:
        assert json.loads(file.attrs["rejected"]) == result["rejected"]
        assert file["health/min_J"][3] == result["min_J"]


def test_a_scene_without_fit_draws_is_refused(tiny):
    """When 20 draws are unfit the error names the interaction, the reasons, and what to change."""
    scene = config.build(
        Scene, config.merge(tiny, {"health": {"min_J": 0.999}, "frames": {"interval": 0.05}})
    )
    with pytest.raises(
        InputError,
        match=r"train interaction 1 was unfit in all 20 draws \(crushed cell 20\); lower contact.force",
    ):
        healthy_interaction(scene, scene.mesh.build(), "train", 1)


def test_a_failed_write_leaves_nothing(tiny, tmp_path):
    """If the writing fails half way there is no file, and an older one stays as it was."""
    scene = config.build(Scene, tiny)
    mesh = scene.mesh.build()

    def results():
        yield healthy_interaction(scene, mesh, "train", 1)
        raise RuntimeError("power cut")

    (tmp_path / "old.h5").write_text("older")
    for name in ("new.h5", "old.h5"):
        with pytest.raises(RuntimeError, match="power cut"):
            write_dataset(tmp_path / name, scene, mesh, results())
    assert [path.name for path in tmp_path.iterdir()] == ["old.h5"] and (
        tmp_path / "old.h5"
    ).read_text() == "older"


def cut_in_half(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def overwrite_with_text(path):
    path.write_text("time,force\n0,1\n")


def empty(path):
    path.write_bytes(b"")


def change(name, action):
    def spoil(path):
        with h5py.File(path, "r+") as file:
            action(file, name)

    spoil.__name__ = f"change_{name}"
    return spoil


def delete(file, name):
    del file[name]


def other_format(file, name):
    file.attrs[name] = "someone else's"


def put_nan(file, name):
    file[name][0, 1] = np.nan


def garble_chunk(path):
    with h5py.File(path) as file:
        place = file["displacement"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    data[place.byte_offset + 4 : place.byte_offset + place.size - 4] = b"\x5a" * (place.size - 8)
    path.write_bytes(data)


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda path: path.unlink(), "no dataset .*; make it with python -m fem.generate"),
        (empty, "cannot be read as HDF5"),
        (cut_in_half, "cannot be read as HDF5 .*truncated"),
        (overwrite_with_text, "cannot be read as HDF5"),
        (change("format", other_format), "is not a 'unet-fem dataset 1' file"),
        (change("mask", delete), "is damaged"),
        (change("split", delete), "is damaged"),
        (change("displacement", put_nan), "not finite in displacement"),
        (change("volume", put_nan), "not finite in volume"),
        (garble_chunk, "generate it again"),
    ],
)
def test_damaged_files_are_refused(spoil, message, tiny_dataset, tmp_path):
    """A missing, cut, foreign, incomplete or garbled file, or one with a NaN, is an InputError of
    one line with the remedy."""
    path = shutil.copy(tiny_dataset, tmp_path / "copy.h5")
    spoil(path)
    with pytest.raises(InputError) as error:
        open_dataset(path).read("train")
    assert (
        re.search(message, str(error.value))
        and "\n" not in str(error.value)
        and str(path) in str(error.value)
    )


def test_unknown_split_is_refused(tiny_dataset):
    """A misspelt split is an InputError that lists the right ones."""
    with pytest.raises(InputError, match="split 'valid' is not one of train, validation, test"):
        open_dataset(tiny_dataset).read("valid")
