"""Sequences for ParaView: the files open again with the values, times and energies of the
dataset."""

import csv
import importlib.util
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

from fem.data.build import generate
from fem.data.dataset import open_dataset
from fem.data.paraview import write_sequence
from fem.data.scene import load_scene
from fem.errors import InputError
from fem.mesh.shapes import box

SCENE = """
[mesh]
{mesh}
[material]
mu = 400.0
nu = 0.42
density = 1000.0
prony = [[0.8, 11.0]]
[solver]
mass_scaling = 400.0
damping = 20.0
[frames]
count = 4
interval = 0.1
[contact]
count = 1
radius = [1.5e-3, 2e-3]
force = [0.5e-3, 1e-3]
ramp = [0.1, 0.2]
onset = [0.0, 0.05]
[interactions]
seed = 1
train = 1
validation = 1
test = 2
hard = [2, 2]
[health]
kinetic_share = 1.0
disequilibrium = 10.0
confirm = 0
"""
TOOL = Path(__file__).parents[3] / "tools/export.py"


def export(arguments):
    spec = importlib.util.spec_from_file_location("export_tool", TOOL)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    tool.main([str(word) for word in arguments])


@pytest.fixture(scope="module", params=["on the grid", "embedded"])
def dataset(request, tmp_path_factory):
    """A dataset of a box of 4 x 4 x 2 cells, as a box or as a mesh file embedded in another
    grid."""
    folder = tmp_path_factory.mktemp("export")
    mesh = 'kind = "box"\nedge = 1e-3\ncells = [4, 4, 2]'
    if request.param == "embedded":
        block = box((4, 4, 2), 1.0, "none")
        meshio.Mesh(block.points, [("hexahedron", block.cells)]).write(folder / "block.vtu")
        mesh = 'file = "block.vtu"\nscale = 1e-3\nfixed = "all but z max"\ngrid = [6, 4, 4]'
    (folder / "scene.toml").write_text(SCENE.format(mesh=mesh))
    generate(load_scene(folder / "scene.toml"), folder / "block.h5", workers=1)
    return folder / "block.h5"


def test_an_exported_sequence_opens_again_with_its_values_and_times(dataset, tmp_path, capsys):
    """PVD, VTU and energy table hold physical times, displacement, force and J of the cells on the
    mesh that was simulated."""
    export([dataset, tmp_path / "out", "--interaction", 2])
    assert "test-0002.pvd" in capsys.readouterr().out
    sequence = open_dataset(dataset).sequence("test", 2)
    entries = (
        ElementTree.parse(tmp_path / "out/test-0002.pvd").getroot().findall("./Collection/DataSet")
    )
    assert [float(entry.get("timestep")) for entry in entries] == pytest.approx(
        [0.0, 0.1, 0.2, 0.3]
    )
    for frame, entry in enumerate(entries):
        file = meshio.read(tmp_path / "out" / entry.get("file"))
        assert np.array_equal(file.points, sequence.mesh.points * 1e3) and len(file.points) == 75
        assert np.array_equal(file.cells_dict["hexahedron"], sequence.mesh.cells)
        assert np.array_equal(file.point_data["displacement"], sequence.displacement[frame])
        assert np.array_equal(file.point_data["force"], sequence.force[frame])
        assert np.array_equal(file.point_data["fixed"], sequence.mesh.fixed)
        moved = 1e9 * sequence.mesh.volume(1e-3 * sequence.displacement[frame].astype(float))
        assert np.mean(file.cell_data["J"][0]) == pytest.approx(
            moved / 32.0, rel=1e-9
        )  # all 32 cells have 1 mm3
    assert np.linalg.norm(sequence.displacement[-1], axis=1).max() > 0.01
    assert not sequence.displacement[:, sequence.mesh.fixed].any()


def test_energies_come_as_a_table_that_balances(dataset, tmp_path):
    """The table has a row for each frame, in J, whose external work is the sum of what it went
    into."""
    export([dataset, tmp_path, "--split", "train"])
    with open(tmp_path / "train-0001-energy.csv", newline="") as table:
        rows = list(csv.DictReader(table))
    assert [float(row["time (s)"]) for row in rows] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    for row in rows:
        value = {name.split(" ")[0]: float(number) for name, number in row.items()}
        stored = sum(
            value[name] for name in ("kinetic", "strain", "hourglass", "viscous", "damping")
        )
        assert stored == pytest.approx(
            value["external"], abs=0.01 * float(rows[-1]["external (J)"])
        )
    assert float(rows[-1]["external (J)"]) > 1e-10


def test_an_older_dataset_without_energies_is_exported_too(dataset, tmp_path, capsys):
    old = tmp_path / "old.h5"
    old.write_bytes(dataset.read_bytes())
    with h5py.File(old, "r+") as file:
        del file["energy"], file.attrs["embedding_error"]
    export([old, tmp_path / "out"])
    assert "before energies were kept" in capsys.readouterr().out
    assert (
        not list((tmp_path / "out").glob("*.csv"))
        and len(list((tmp_path / "out/test-0001").glob("*.vtu"))) == 4
    )


@pytest.mark.parametrize(
    "words, named",
    [
        (["{data}", "{out}", "--interaction", "3"], ["no test interaction 3", "test 1 to 2"]),
        (["{data}", "{out}", "--interaction", "0"], ["no test interaction 0"]),
        (["nowhere.h5", "{out}"], ["no dataset nowhere.h5"]),
        (["{data}", "{file}"], ["cannot be written", "give another path"]),
    ],
)
def test_wrong_arguments_are_one_line_with_the_remedy(dataset, tmp_path, capsys, words, named):
    (tmp_path / "file").write_text("")
    places = {"data": dataset, "out": tmp_path / "out", "file": tmp_path / "file"}
    with pytest.raises(SystemExit) as stop:
        export([word.format(**places) for word in words])
    message = capsys.readouterr().err.strip()
    assert stop.value.code == 2 and message.startswith("error: ") and "\n" not in message
    for word in named:
        assert word in message


def test_a_simulation_without_a_dataset_is_written_too(tmp_path):
    """Mesh in m, times and fields are enough; without displacement there is no J, without energies
    no table."""
    mesh, times = box((2, 2, 2), 1e-3), [0.0, 0.5]
    stretch = np.stack([0 * mesh.points, 0.1 * mesh.points * 1e3])  # mm
    write_sequence(tmp_path, "stretch", mesh, times, {"displacement": stretch})
    file = meshio.read(tmp_path / "stretch/frame_0001.vtu")
    assert np.allclose(file.points, mesh.points * 1e3, rtol=1e-15)
    assert np.allclose(file.cell_data["J"][0], 1.1**3, rtol=1e-12)
    write_sequence(tmp_path, "load", mesh, times, {"force": stretch})
    assert not meshio.read(tmp_path / "load/frame_0001.vtu").cell_data
    assert not list(tmp_path.glob("*.csv")) and (tmp_path / "load.pvd").is_file()
    with pytest.raises(InputError, match=r"'force' has shape \(1, 27, 3\); 2 frames of 27 nodes"):
        write_sequence(tmp_path, "short", mesh, times, {"force": stretch[:1]})
