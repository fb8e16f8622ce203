"""Meshes from files: every format and selection gives the same mesh, bad cells are named, and
scenes become datasets."""

import dataclasses
import re

import h5py
import meshio
import numpy as np
import pytest

from fem.data.build import generate
from fem.data.dataset import open_dataset
from fem.data.scene import load_scene
from fem.errors import InputError
from fem.mesh.node_grid import node_grid
from fem.mesh.read import read_mesh
from fem.mesh.shapes import box
from unet_fem.training import samples as data


@pytest.fixture(scope="module")
def block():
    """A bent block of 6 x 5 x 4 cells, its nodes on no axis-aligned grid: the HexMesh, with the z =
    0 side fixed."""
    mesh = box((6, 5, 4), 1.0, "bottom")
    x, y, z = mesh.points.T
    return dataclasses.replace(
        mesh, points=np.stack([x + 0.3 * np.sin(y), y + 0.2 * z, z + 0.1 * x**2 / 6], axis=1)
    )


@pytest.fixture(scope="module")
def files(block, tmp_path_factory):
    """The block, shuffled and in mm, in every format; `base` and `top` name its lower and upper
    side, `cap` holds quads."""
    folder = tmp_path_factory.mktemp("meshes")
    rng = np.random.default_rng(0)
    node = rng.permutation(block.n_nodes)
    number = np.argsort(node)  # new number of each node
    points, cells = block.points[node], number[block.cells][rng.permutation(block.n_cells)]
    k = np.unravel_index(block.grid.index, block.grid.shape)[2]  # layer of every node
    base, top = number[k == 0], number[k == 4]
    faces = block.boundary_faces
    quads = {
        name: number[faces[(k[faces] == layer).all(axis=1)]]
        for name, layer in (("base", 0), ("top", 4))
    }
    blocks = [("quad", quads["base"]), ("quad", quads["top"]), ("hexahedron", cells)]
    stray = np.vstack([points, [[1e3, 1e3, 1e3]]])  # a point that no cell uses
    marks = [np.full(len(own), mark) for mark, (_, own) in enumerate(blocks, start=1)]

    def marked(nodes):
        return np.isin(np.arange(len(stray)), nodes).astype(int)

    vtk = meshio.Mesh(
        stray,
        blocks,
        point_data={"base": marked(base), "top": marked(top)},
        cell_data={"side": marks},
    )
    gmsh = meshio.Mesh(
        points,
        blocks,
        cell_data={"gmsh:physical": marks, "gmsh:geometrical": marks},
        field_data={"base": np.array([1, 2]), "top": np.array([2, 2]), "tissue": np.array([3, 3])},
        point_data={
            "gmsh:dim_tags": np.where(
                np.isin(np.arange(len(points)), base)[:, None], [2, 1], [3, 3]
            )
        },
    )
    gmsh.point_data["gmsh:dim_tags"][top] = [2, 2]
    abaqus = meshio.Mesh(
        stray, blocks[2:], point_sets={"base": base, "top": top}, cell_sets={"some": [np.arange(7)]}
    )
    vtk.write(folder / "block.vtu")
    vtk.write(folder / "block.vtk")
    gmsh.write(folder / "block22.msh", file_format="gmsh22")
    gmsh.write(folder / "block41.msh", file_format="gmsh")
    abaqus.write(folder / "block.inp")
    return folder


@pytest.mark.parametrize(
    "name", ["block.vtu", "block.vtk", "block22.msh", "block41.msh", "block.inp"]
)
def test_every_format_gives_the_same_mesh_and_its_named_sides(files, block, name):
    """VTK, Gmsh 2.2 and 4.1 and Abaqus files give nodes, cells, held base and loaded top; a stray
    point is dropped."""
    mesh = read_mesh(files / name, 1e-3, "base", "top")
    grid = node_grid(mesh)
    assert grid.shape == block.grid.shape and mesh.n_cells == block.n_cells
    assert np.allclose(
        grid.to_grid(mesh.points), block.grid.to_grid(block.points) * 1e-3, atol=1e-12
    )
    assert np.array_equal(
        grid.to_grid(mesh.fixed[:, None]), block.grid.to_grid(block.fixed[:, None])
    )
    assert len(mesh.free_faces) == 30 and (grid.to_grid(mesh.loaded[:, None])[..., -1, 0]).all()


@pytest.mark.parametrize(
    "text, count",
    [
        ("side = 1", 42),  # cell data with a value: 7 x 6 nodes
        ("side = 1, y max", 49),
        ("all but top", 210 - 5 * 4 * 3 - 5 * 4),  # the boundary without the inside of the top
        ("y min", 7),  # one edge of the sheared block
        ("y min, y max", 14),
        ("z<0.0015", None),
        ("x > -1e1", 210),
    ],
)
def test_selections_by_name_value_and_place(files, text, count):
    """Terms select by cell value, extreme and half-space, lists add up, and 'all but' turns the
    boundary round."""
    mesh = read_mesh(files / "block.vtu", 1e-3, text, "top") if text != "x > -1e1" else None
    if mesh is None:  # everything is fixed: nothing is left to push on
        with pytest.raises(InputError, match="no free boundary face"):
            read_mesh(files / "block.vtu", 1e-3, text, "top")
        return
    assert mesh.fixed.sum() == (count or (mesh.points[:, 2] < 1.5e-3).sum())


def test_a_side_of_a_set_of_cells_is_all_their_nodes(files):
    assert read_mesh(files / "block.inp", 1e-3, "some", "top").fixed.sum() > 7 * 3
    assert read_mesh(files / "block22.msh", 1e-3, "gmsh:physical = 1").fixed.sum() == 42


def test_the_names_of_a_file_are_sets_of_the_mesh(files):
    """Groups, sets and data become node sets, those of hexahedra cell sets too, and serve later
    selections."""
    mesh = read_mesh(files / "block.vtu", 1e-3, "base", "top")
    assert {"base", "top", "side = 1", "side = 3"} <= mesh.node_sets.keys()
    assert mesh.cell_sets["side = 3"].all() and not mesh.cell_sets["side = 1"].any()
    again = mesh.with_sets(fixed="side = 1", cap="side = 2.0")
    assert np.array_equal(again.fixed, mesh.fixed)
    assert np.array_equal(again.node_sets["cap"], mesh.node_sets["top"])
    with pytest.raises(InputError, match="'side = 7' selects no node; there is side = 1, side = 2"):
        mesh.with_sets(fixed="side = 7")
    some = read_mesh(files / "block.inp", 1e-3, "some", "top")
    assert some.cell_sets["some"].sum() == 7
    assert read_mesh(files / "block22.msh", 1e-3, "base").cell_sets["tissue"].all()


@pytest.mark.parametrize(
    "selection, words",
    [
        ("bottom", ["mesh.fixed", "'bottom'", "base, side, top", "z min"]),
        ("z < -1", ["'z < -1' selects no node", "z 0 to", "mesh.scale"]),
        ("all but x > -10", ["all but x > -10", "whole boundary"]),
        (None, ["no fixed node", "mesh.fixed"]),
    ],
)
def test_a_wrong_selection_is_named_with_what_there_is(files, selection, words):
    with pytest.raises(InputError) as error:
        read_mesh(files / "block.vtu", 1e-3, selection)
    for word in ["block.vtu", *words]:
        assert word in str(error.value)


def spoiled(block, kind):
    """A meshio.Mesh of the block that must be refused."""
    points, cells = block.points.copy(), block.cells.copy()
    blocks = [("hexahedron", cells)]
    if kind == "inverted":
        cells[7] = cells[7][[4, 5, 6, 7, 0, 1, 2, 3]]
    elif kind == "degenerate":
        cells[7, 1] = cells[7, 0]
    elif kind == "flat":
        points[cells[7, 6]] = points[cells[7, 0]]
    elif kind == "tetra":
        blocks.append(("tetra", cells[:3, [0, 1, 3, 4]]))
    elif kind == "wedge":
        blocks.insert(0, ("wedge", cells[:2, [0, 1, 3, 4, 5, 7]]))
    elif kind == "quadratic":
        blocks = [("hexahedron20", np.arange(20)[None])]
    elif kind == "surface":
        blocks = [("quad", block.boundary_faces)]
    elif kind == "two parts":
        points, blocks = (
            np.vstack([points, points + 100]),
            [("hexahedron", np.vstack([cells, cells + len(points)]))],
        )
    return meshio.Mesh(points, blocks)


@pytest.mark.parametrize(
    "kind, named",
    [
        ("inverted", r"cell 7 \(nodes \[.*\) is inverted or degenerate"),
        ("degenerate", r"cell 7 \(nodes \[.*\) is inverted or degenerate"),
        ("flat", r"cell \d+ \(nodes \[.*\) is inverted or degenerate"),
        ("tetra", r"cell 120 of the file \(nodes \[.*\]\) is a tetra, one of 3; .* hexahedra only"),
        ("wedge", r"cell 0 of the file .* is a wedge, one of 2"),
        ("quadratic", "is a hexahedron20.* save it with linear cells"),
        ("surface", r"no hexahedron \(148 quad\)"),
        ("two parts", "a part of 120 cells .* has no fixed node"),
    ],
)
def test_cells_that_cannot_be_solved_are_named(block, tmp_path, kind, named):
    """Inverted, degenerate and non-hexahedral cells, surfaces alone and loose parts are InputErrors
    that name file and cell."""
    path = tmp_path / "spoiled.vtu"
    spoiled(block, kind).write(path)
    with pytest.raises(InputError, match=named) as error:
        read_mesh(path, 1.0, "z < 1")
    assert "spoiled.vtu" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "case",
    [
        "missing.vtu",
        "nonsense.vtu",
        "nonsense.msh",
        "nonsense.inp",
        "mesh.docx",
        "voxels.vtu",
        "pieces.vtu",
    ],
)
def test_unreadable_files_are_one_line_with_the_remedy(block, tmp_path, case, capfd):
    """Missing, damaged and unknown files, and those that meshio would read in part, are
    InputErrors; nothing else is printed."""
    path = tmp_path / case
    if case == "voxels.vtu":  # meshio leaves cells of type 11 out with a warning
        meshio.Mesh(block.points, [("hexahedron", block.cells)]).write(path, binary=False)
        head, types, tail = re.split(r'(?<=Name="types" format="ascii">)([^<]*)', path.read_text())
        path.write_text(head + types.replace("12", "11") + tail)
    elif case == "pieces.vtu":  # and reads the last of several pieces alone
        meshio.Mesh(block.points, [("hexahedron", block.cells)]).write(path)
        piece = re.search(r"<Piece.*</Piece>", path.read_text(), re.S)[0]
        path.write_text(path.read_text().replace(piece, piece + piece))
    elif case != "missing.vtu":
        path.write_text("<VTKFile" if case.endswith("vtu") else "nothing")
    capfd.readouterr()
    with pytest.raises(InputError) as error:
        read_mesh(path, 1.0, "z < 1")
    message = str(error.value)
    assert case in message and "\n" not in message
    assert {"voxels.vtu": "voxels", "pieces.vtu": "pieces"}.get(case, case) in message
    assert capfd.readouterr() == ("", "")


SCENE = """
mesh = {{ file = "{file}", scale = 1e-3, fixed = "base", loaded = "top"{grid} }}
[material]
mu = 400.0
nu = 0.42
density = 1000.0
[solver]
mass_scaling = 400.0
damping = 20.0
[frames]
count = 3
interval = 0.1
[contact]
count = 1
radius = [1.5e-3, 2e-3]
force = [0.5e-3, 1.5e-3]
travel = [0.0, 1e-3]
ramp = [0.1, 0.2]
[interactions]
seed = 1
train = 2
validation = 1
test = 1
hard = [1, 1]
[health]
kinetic_share = 1.0
disequilibrium = 10.0
confirm = 0
"""


def scene_with(files, grid="", file="block.vtu"):
    path = files / f"scene{len(grid)}.toml"
    path.write_text(SCENE.format(file=file, grid=grid))
    return load_scene(path)


@pytest.mark.parametrize("grid", ["", ", grid = [6, 6, 5]"])
def test_a_mesh_file_becomes_a_dataset_and_samples(files, tmp_path, grid):
    """A scene with a mesh file gives a dataset on its own or the chosen grid, equal to its scene,
    with total forces and work kept."""
    scene, path = scene_with(files, grid), tmp_path / "block.h5"
    generate(scene, path, workers=1)
    dataset = open_dataset(path)
    assert dataset.scene == scene and dataset.grid == ((6, 6, 5) if grid else (7, 6, 5))
    samples = data.load_samples(dataset, "train", 2)
    assert (
        samples.force.shape == (2 * 3, 2, *dataset.grid, 3)
        and np.abs(samples.displacement).max() > 0.1
    )
    sequence = dataset.sequence("train", 2)
    assert sequence.mesh.n_nodes == 210 and 1e9 * sequence.mesh.volume() == pytest.approx(
        samples.volume[0], rel=1e-9
    )
    assert np.allclose(
        sequence.force.sum(axis=1),
        samples.last_force.reshape(2, 3, -1, 3)[1].sum(axis=1),
        rtol=1e-5,
    )
    assert sequence.energy["external"][-1] > 0 and sequence.energy["imbalance"].max() < 0.01
    force, displacement = dataset.on_grid(sequence.force, sequence.displacement)
    assert np.allclose(
        displacement, samples.displacement[3:], atol=1e-4 * np.abs(displacement).max()
    )
    assert len(dataset.fem_mesh.free_faces) == 30 and dataset.rest_volume == pytest.approx(
        samples.volume[0], rel=0.02
    )
    assert (0 < dataset.embedding_error < 0.1) if grid else dataset.embedding_error == 0
    assert dataset.fem_mesh == scene.mesh.build()  # whole, without the file
    with h5py.File(path) as file:
        assert file["energy"].shape == (4, 3, 7) and file["energy"].attrs["unit"] == "J"


def test_a_mesh_file_is_read_once_in_a_process(files, monkeypatch):
    """Equal choices, also of a scene loaded again, share one mesh; a changed file is read anew."""
    scene, reads = scene_with(files), []
    read = meshio.read
    monkeypatch.setattr(meshio, "read", lambda path: reads.append(path) or read(path))
    mesh = scene.mesh.build()
    assert scene.mesh.build() is mesh and scene_with(files).mesh.build() is mesh
    assert len(reads) <= 1
    assert dataclasses.replace(scene.mesh, loaded="top, z max").build() is not mesh
    moved = meshio.Mesh(mesh.points * 1.001e3, [("hexahedron", mesh.cells)])
    moved.point_data = {name: mesh.node_sets[name].astype(int) for name in ("base", "top")}
    moved.write(files / "moved.vtu")
    other = dataclasses.replace(scene.mesh, file="moved.vtu", sha256=None)
    before = other.build()
    moved.points *= 1.001
    moved.write(files / "moved.vtu")
    assert other.build() != before


def test_a_changed_mesh_makes_another_scene(files, tmp_path):
    """The scene knows the content of its mesh file, wherever it lies; a scene from a dataset
    refuses another mesh."""
    (tmp_path / "a").mkdir()
    for folder in (tmp_path, tmp_path / "a"):
        (folder / "block.vtu").write_bytes((files / "block.vtu").read_bytes())
    here, there = scene_with(tmp_path), scene_with(tmp_path / "a")
    assert here == there and here.digest() == there.digest() and str(tmp_path) not in here.toml()
    (tmp_path / "again.toml").write_text(here.toml())
    assert load_scene(tmp_path / "again.toml") == here
    mesh = meshio.read(tmp_path / "block.vtu")
    mesh.points[0] += 1e-6
    mesh.write(tmp_path / "block.vtu")
    assert scene_with(tmp_path) != here and scene_with(tmp_path).digest() != here.digest()
    with pytest.raises(InputError, match="mesh.sha256"):
        load_scene(tmp_path / "again.toml")


@pytest.mark.parametrize(
    "mesh, words",
    [
        ('{ file = "none.vtu" }', ["none.vtu", "relative to the scene file"]),
        ('{ kind = "file" }', ["mesh.file"]),
        ('{ kind = "tumour", cells = [16, 16, 8] }', ["mesh.cells", "'tumour'"]),
        ('{ kind = "tumour", fixed = "bottom" }', ["mesh.fixed", "'tumour'"]),
        ('{ kind = "box", scale = 1.0 }', ["mesh.scale", "'box'"]),
        ('{ kind = "box", file = "block.vtu" }', ["mesh.file", "'box'"]),
        ('{ file = "block.vtu", edge = 1.0 }', ["mesh.edge", "'file'"]),
        ('{ file = "block.vtu", scale = 0.0 }', ["mesh.scale"]),
        ('{ file = "block.vtu", folder = "x" }', ["mesh.folder", "nearest"]),
    ],
)
def test_wrong_mesh_tables_are_named(files, mesh, words):
    (files / "wrong.toml").write_text(
        re.sub(r"mesh = .*", f"mesh = {mesh}", SCENE.format(file="", grid=""))
    )
    with pytest.raises(InputError) as error:
        load_scene(files / "wrong.toml")
    for word in words:
        assert word in str(error.value)


def test_the_shipped_lobe_is_a_curved_block_on_a_grid(request):
    """configs/lobe.vtu is what tools/make_lobe.py writes: 12 x 12 x 6 distorted cells, pushed on
    from above."""
    scene = load_scene(request.config.rootpath / "configs/lobe.toml")
    mesh = scene.mesh.build()
    assert mesh.grid.shape == (13, 13, 7) and mesh.n_cells == 864 and not mesh.congruent
    grid = mesh.grid.to_grid(mesh.points)
    assert (
        np.diff(np.linalg.norm(grid[..., [0, 2]], axis=-1), axis=2) > 0
    ).all()  # layers go outwards
    assert mesh.grid.to_grid((~mesh.fixed)[:, None])[1:-1, 1:-1, 1:].all()
