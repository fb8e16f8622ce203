"""The dataset file: what it holds, that it holds what was simulated, and what is refused when it is
opened."""

import dataclasses
import json
import re
import shutil

import h5py
import meshio
import numpy as np
import pytest

from fem import settings as config
from fem.contact.draw import draw_contacts
from fem.contact.push import Load
from fem.contact.surface import Surface, surface_of
from fem.data import dataset as dataset_module
from fem.data import mesh_choice
from fem.data.build import generate
from fem.data.dataset import open_dataset
from fem.data.draws import drawn_contacts, redrawn_contacts
from fem.data.interaction import healthy_interaction, unfit
from fem.data.scene import MeshChoice, Scene
from fem.data.schema import FIRST_FORMAT, FORMAT
from fem.data.write import HEALTH, write_dataset
from fem.errors import InputError
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box, tumour
from fem.solver.gate import Signs

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
        assert file["contacts"].shape == (4, 2)
        assert file["volume"].shape == (4, 3) and file["mask"].shape == file["fixed"].shape == GRID
        assert all(file[f"health/{name}"].shape == (4,) for name in HEALTH)
        assert np.allclose(file["time"], [0, 0.2, 0.4])
        assert file["split"][()].astype(str).tolist() == ["train", "train", "validation", "test"]
        assert file["number"][()].tolist() == [1, 2, 1, 1] and file["hard"][()].tolist() == [
            False
        ] * 3 + [True]


def test_dataset_gives_back_scene_and_mesh(tiny, tiny_dataset):
    """An opened dataset holds the scene that made it, and the mesh with its cells and held
    nodes."""
    dataset, scene = open_dataset(tiny_dataset), config.build(Scene, tiny)
    mesh = scene.mesh.build()
    assert dataset.scene == scene and dataset.scene.digest() == scene.digest()
    assert dataset.grid == GRID and dataset.free.sum() == (~mesh.fixed).sum()
    assert np.array_equal(dataset.mesh.cells, mesh.cells) and np.array_equal(
        dataset.mesh.fixed, mesh.fixed
    )
    assert np.allclose(dataset.mesh.points, mesh.points, rtol=1e-12)
    assert dataset.fem_mesh == mesh and dataset.for_learning() is dataset
    with h5py.File(tiny_dataset) as file:
        assert file.attrs["mesh_digest"] == dataset.mesh_digest == mesh.digest


def test_the_digest_of_a_scene_tells_meshes_of_one_name_apart(tiny, monkeypatch):
    """Another mesh behind mesh.kind = "tumour" makes another scene's digest."""
    scene = config.build(Scene, tiny | {"mesh": {"kind": "tumour"}})
    before = scene.digest()
    other = tumour().with_sets(fixed="bottom")
    monkeypatch.setattr(mesh_choice, "_build", lambda choice: other)
    assert scene.digest() != before


def test_a_dataset_of_the_former_tumour_opens_for_reading(tiny, tmp_path):
    """Its scene names the block that it was cut from; it reads, and is not to be learned from."""
    scene = config.build(Scene, tiny | {"mesh": {"kind": "tumour"}})
    mesh = tumour().with_sets(fixed="bottom")
    fields = {
        "displacement": np.zeros((3, mesh.n_nodes, 3), np.float32),
        "force": np.ones((3, mesh.n_nodes, 3), np.float32),
    }
    box_scene = config.build(Scene, tiny)
    result = healthy_interaction(box_scene, box_scene.mesh.build(), "train", 1)
    path = tmp_path / "a.h5"
    write_dataset(path, scene, mesh, [result | fields] * 4)
    with h5py.File(path, "r+") as file:
        text = file.attrs["scene"].replace("[mesh]", "[mesh]\ncells = [16, 16, 7]")
        file.attrs["scene"] = text
        del file.attrs["mesh_digest"]
    dataset = open_dataset(path)
    assert dataset.scene == scene and dataset.read("test")["force"].any()
    with pytest.raises(InputError, match="reading only: .* another mesh than .* 'tumour' is now"):
        dataset.for_learning()


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
        dataset.mesh.grid.index, mesh.grid.index
    )
    assert dataset.rest_volume == pytest.approx(mesh.volume() * 1e9, rel=1e-12)
    assert not dataset.read("train")["displacement"][:, :, ~dataset.mask].any()


def test_volume_is_that_of_the_displaced_mesh(tiny_dataset):
    """The volume of each frame, in mm3, is that of the mesh displaced by the frame's
    displacement."""
    dataset = open_dataset(tiny_dataset)
    for split in np.unique(dataset.split):
        fields = dataset.read(split)
        u = 1e-3 * dataset.mesh.grid.from_grid(fields["displacement"]).astype(float)
        volume = [[1e9 * dataset.mesh.volume(frame) for frame in sequence] for sequence in u]
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
        assert np.allclose(
            dataset.mesh.grid.from_grid(fields["force"][i]), force, rtol=1e-6, atol=1e-12
        )


def test_written_interactions_are_healthy(tiny, tiny_dataset):
    """Every interaction in the file keeps to the scene's limits of imbalance, smallest J and
    kinetic energy."""
    health = config.build(Scene, tiny).health
    with h5py.File(tiny_dataset) as file:
        assert file["health/imbalance"][()].max() <= health.imbalance
        assert file["health/min_J"][()].min() >= health.min_J
        for name in ("kinetic_share", "disequilibrium", "hourglass_motion", "hourglass_share"):
            assert file[f"health/{name}"][()].max() <= getattr(health, name)
        assert file["health/corner_J"][()].min() >= health.corner_J
        assert file["health/steps"][()].min() > 100


@pytest.mark.parametrize(
    "spoil, reason",
    [
        ({"imbalance": 0.5}, "energy imbalance"),
        ({"imbalance": np.nan}, "energy imbalance"),
        ({"min_J": 0.1}, "crushed cell"),
        ({"min_J": np.nan}, "crushed cell"),
        ({"kinetic_share": 0.2}, "kinetic energy"),
        ({"disequilibrium": 0.2}, "disequilibrium"),
        ({"disequilibrium": np.nan}, "disequilibrium"),
        ({"hourglass_motion": 0.3}, "hourglass motion"),
        ({"hourglass_share": 0.1}, "hourglass energy"),
        ({"corner_J": 0.05}, "crushed corner"),
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
    } | Signs()._asdict()
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
        match=r"train interaction 1 was unfit in all 20 draws \(crushed cell 20\);"
        " lower contact.force",
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


def put(file, name, values):
    del file[name]
    file[name] = values


def drop_last(file, name):
    put(file, name, file[name][..., :-1])


def as_text(file, name):
    put(file, name, file[name][()].astype("S8"))


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
        (change("format", other_format), "is not a 'unet-fem dataset 2' file"),
        (change("mask", delete), "is damaged"),
        (change("split", delete), "is damaged: it has no 'split'"),
        (change("force", delete), "is damaged: it has no 'force'"),
        (change("points", drop_last), r"'points' is float64 of shape \(5, 5, 3, 2\), not of shape"),
        (change("displacement", drop_last), r"'displacement' is float32 of shape \(.*, 2\), not"),
        (change("volume", as_text), "'volume' is .* of shape"),
        (change("mesh/fixed", drop_last), r"'mesh/fixed' is bool of shape \(74,\), not of shape"),
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


@pytest.mark.parametrize(
    "spoil, message",
    [
        (change("mesh/cells", lambda file, name: put(file, name, file[name][()] + 1)), "cell"),
        (change("mesh/points", delete), "mesh/points|points"),
        (change("mesh", delete), "mesh"),
        (
            change("mesh/grid_index", lambda file, name: put(file, name, file[name][()] * 0)),
            "twice",
        ),
    ],
)
def test_a_damaged_mesh_is_refused_when_it_is_asked_for(spoil, message, tiny_dataset, tmp_path):
    path = shutil.copy(tiny_dataset, tmp_path / "copy.h5")
    spoil(path)
    with pytest.raises(InputError, match=message) as error:
        open_dataset(path).fem_mesh  # noqa: B018
    assert str(path) in str(error.value) and "is damaged" in str(error.value)


def test_unknown_split_is_refused(tiny_dataset):
    """A misspelt split is an InputError that lists the right ones."""
    with pytest.raises(InputError, match="split 'valid' is not one of train, validation, test"):
        open_dataset(tiny_dataset).read("valid")


def test_parts_of_a_split_are_read_alone(tiny_dataset, monkeypatch):
    """Chosen fields and numbers equal those of the whole split, in the order asked for; nothing
    else is loaded."""
    dataset = open_dataset(tiny_dataset)
    whole = dataset.read("train")
    loaded = []
    read = h5py.Dataset.__getitem__
    monkeypatch.setattr(
        h5py.Dataset, "__getitem__", lambda self, at: loaded.append(self.name) or read(self, at)
    )
    one = dataset.read("train", ["force"], [2])
    assert loaded == ["/force"] and one.keys() == {"force", "hard", "number"}
    assert np.array_equal(one["force"], whole["force"][1:]) and one["number"].tolist() == [2]
    turned = dataset.read("train", numbers=[2, 1])
    assert all(np.array_equal(turned[name], whole[name][::-1]) for name in whole)
    for wrong, named in (
        ({"fields": ("strain",)}, "strain"),
        ({"fields": "force"}, "'force'"),
        ({"numbers": [3]}, "no train interaction 3"),
    ):
        with pytest.raises(InputError, match=named):
            dataset.read("train", **wrong)


def test_the_file_keeps_the_contacts(tiny, tiny_dataset, monkeypatch):
    """Those that were drawn come back to the bit, also after rejected draws, and are not drawn
    again."""
    scene, dataset = config.build(Scene, tiny), open_dataset(tiny_dataset)
    monkeypatch.setattr(dataset_module, "redrawn_contacts", None)
    for split, number in scene.interactions.all():
        contacts = dataset.contacts(split, number)
        load, force = Load(Surface(dataset.fem_mesh), contacts), dataset.sequence(split, number)
        for t, frame in zip(dataset.time, force.force, strict=True):
            assert np.array_equal((load(t).T * 1e3).astype(np.float32), frame)
    with pytest.raises(InputError, match="no test interaction 2; it has"):
        dataset.contacts("test", 2)


def test_the_contacts_of_a_file_with_forces_on_held_nodes_are_drawn_again(tiny):
    """Files of the first format hold them: what pushed is found all the same."""
    scene = config.build(Scene, tiny)
    mesh = scene.mesh.build()
    drawn = drawn_contacts(scene, surface_of(mesh), "test", 1, 2)
    load = Load(Surface(mesh, on_held=True), drawn)
    force = np.array([load(t).T * 1e3 for t in scene.frames.times], np.float32)
    assert force[:, mesh.fixed].any()
    assert repr(redrawn_contacts(scene, mesh, force, "test", 1)) == repr(drawn)


def as_first_format(path, mesh):
    """Turn a file into one of the first format: no contacts, and no mesh beside the grid."""
    with h5py.File(path, "r+") as file:
        file.attrs["format"] = FIRST_FORMAT
        del file["contacts"]
        if mesh.grid is not None:
            del file["mesh"]
            if mesh.loaded is not None:
                file["loaded"] = mesh.grid.to_grid(mesh.loaded[:, None])[..., 0]
        else:
            put(file["mesh"], "points", mesh.points * 1e3)
            for name in set(file["mesh"]) & {"node_sets", "cell_sets"}:
                del file["mesh"][name]


def ring():
    """A closed ring of hexahedra, which lies on no node grid, pushed on from above."""
    strip = box((12, 2, 2), 1.0, "none")
    i, j, k = np.round(strip.points).astype(int).T
    same, first, place = np.unique(
        ((i % 12) * 3 + j) * 3 + k, return_index=True, return_inverse=True
    )
    angle, radius = 2 * np.pi * i / 12, 3e-3 + 1e-3 * j
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 1e-3 * k], axis=1)[first]
    cells = place[strip.cells][:, [3, 2, 1, 0, 7, 6, 5, 4]]
    mesh = HexMesh(points, cells, np.zeros(len(same), bool))
    return mesh.with_sets(fixed="z min", loaded="z max", right="x > 0", half=np.arange(48) < 24)


@pytest.mark.parametrize("own_grid", [True, False], ids=["on its grid", "embedded"])
def test_a_scene_takes_a_mesh_as_it_is(tiny, tmp_path, own_grid):
    """A scene with a ready HexMesh gives a dataset that holds the mesh whole, sets and all, and
    opens without it; a file of the first format gives the same but for rounding."""
    mesh = ring() if not own_grid else box((4, 4, 2), 1e-3).with_sets(loaded="top", side="x max")
    given = dataclasses.replace(mesh, grid=None)  # it is found again
    scene = config.build(Scene, config.merge(tiny, {"health": {"min_J": 0.2}})).with_mesh(given)
    scene = dataclasses.replace(scene, contact=dataclasses.replace(scene.contact, cone=0.0))
    assert scene.mesh.build().grid == mesh.grid and scene == scene.with_mesh(mesh)
    assert scene.digest() != scene.with_mesh(mesh.with_sets(loaded="z max, x max")).digest()
    generate(scene, tmp_path / "a.h5", workers=1)
    dataset = open_dataset(tmp_path / "a.h5")
    assert dataset.fem_mesh == mesh and dataset.scene == scene
    assert dataset.scene.digest() == scene.digest() and (dataset.embedding is None) == own_grid
    with pytest.raises(InputError, match="scene.with_mesh"):
        dataset.scene.mesh.build()
    assert dataset.scene.with_mesh(dataset.fem_mesh).mesh.build() == mesh
    as_first_format(shutil.copy(tmp_path / "a.h5", tmp_path / "old.h5"), mesh)
    old = open_dataset(tmp_path / "old.h5")
    assert np.allclose(old.fem_mesh.points, mesh.points, rtol=1e-15, atol=0)
    assert np.array_equal(old.fem_mesh.free_faces, mesh.free_faces)
    for which in scene.interactions.all():
        assert np.array_equal(old.sequence(*which).force, dataset.sequence(*which).force)
        for one, other in zip(old.contacts(*which), dataset.contacts(*which), strict=True):
            assert one.peak == other.peak and np.allclose(one.end, other.end, rtol=0, atol=1e-15)


def test_a_dataset_does_without_its_mesh_file(tiny, tmp_path):
    """The mesh of a scene from a file is read from the dataset when the file is gone."""
    block = box((4, 4, 2), 1.0, "none")
    path = tmp_path / "block.vtu"
    meshio.Mesh(block.points, [("hexahedron", block.cells)]).write(path)
    choice = MeshChoice(file=path.name, scale=1e-3, fixed="all but z max").located(tmp_path)
    scene = dataclasses.replace(config.build(Scene, tiny), mesh=choice)
    assert dataclasses.replace(choice, loaded="z max").build().n_cells == 32  # knows its folder
    generate(scene, tmp_path / "a.h5", workers=1)
    mesh = scene.mesh.build()
    path.unlink()
    dataset = open_dataset(tmp_path / "a.h5")
    assert dataset.fem_mesh == mesh
    with pytest.raises(InputError, match="no mesh file block.vtu.*dataset.fem_mesh"):
        dataset.scene.mesh.build()
    load = np.zeros((3, mesh.n_nodes))
    dataset.scene.build_solver(dataset.fem_mesh).advance(1e-3, lambda t: load)


def test_a_dataset_knows_the_law_of_each_group_of_its_mesh(tiny, tmp_path):
    """A stiff group enters the simulation, and the file gives back the law of its cells."""
    mesh = box((4, 4, 2), 1e-3)
    middle = np.abs(mesh.points[mesh.cells].mean(axis=1)[:, :2] - 2e-3) < 1e-3
    mesh = mesh.with_sets(core=middle.all(axis=1))
    tiny.pop("mesh")
    sizes = []
    for groups in ({}, {"core": {"mu": 1200.0}}):
        scene = dataclasses.replace(config.build(Scene, tiny), groups=groups).with_mesh(mesh)
        path = tmp_path / f"{len(groups)}.h5"
        generate(scene, path, workers=1)
        dataset = open_dataset(path)
        assert dataset.material == scene.material_on(mesh)
        sizes.append(np.linalg.norm(dataset.read("train", ("displacement",))["displacement"]))
    np.testing.assert_array_equal(dataset.material.mu, np.where(mesh.cell_sets["core"], 1200, 400))
    assert 0 < sizes[1] < 0.9 * sizes[0]


def test_a_mesh_that_was_moved_after_it_was_written_is_refused(tiny_dataset, tmp_path):
    """By its digest, and where the grid has other points than the mesh."""
    for name, place in (("mesh/points", (5, 1)), ("points", (2, 2, 1, 0))):
        path = tmp_path / "moved.h5"
        shutil.copy(tiny_dataset, path)
        with h5py.File(path, "r+") as file:
            values = file[name][()]
            values[place] += 0.01 * np.ptp(values)
            file[name][...] = values
        with pytest.raises(InputError, match="moved.h5 is damaged: '(mesh|points)' "):
            _ = open_dataset(path).fem_mesh
