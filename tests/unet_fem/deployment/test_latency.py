"""What is timed, and by whom: steppers in turn, the FEM of any dataset, memory on any system."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from fem import settings as config
from fem.data.build import generate
from fem.data.dataset import open_dataset
from fem.data.scene import load_scene
from fem.mesh.shapes import box
from unet_fem.deployment import latency, process
from unet_fem.deployment.answers import answers


class Counter:
    """A stepper that notes its calls and answers with how many it has had since rest."""

    interval = 0.1

    def __init__(self):
        self.seen, self.resets = [], 0

    def reset(self):
        self.seen, self.resets = [], self.resets + 1

    def step(self, force, dt=None):
        self.seen.append(float(force[0, 0]))
        return np.full_like(force, len(self.seen))


def forces(*values):
    return np.array(values, "float32")[:, None, None] * np.ones((2, 3), "float32")


def test_steppers_answer_their_forces_to_and_fro_so_that_no_force_jumps():
    steppers = {"three": Counter(), "one": Counter()}
    given = {"three": forces(1, 2, 3), "one": forces(5)}
    times = latency.time_steppers(steppers, given, rounds=2, calls=5, warm_up=0)
    assert {name: seconds.shape for name, seconds in times.items()} == {"three": (2,), "one": (2,)}
    assert all((seconds > 0).all() for seconds in times.values())
    three, one = steppers.values()
    assert three.resets == 1 and three.seen == [1, 2, 3, 3]  # from rest again after 1 2 3 3 2 1
    assert one.resets == 0 and one.seen == [5] * 10


def test_what_stands_beside_takes_turns_with_the_steppers():
    order = []
    times = latency.time_steppers(
        {"stepper": Counter()},
        {"stepper": forces(1)},
        rounds=3,
        warm_up=1,
        beside={"graph": lambda: order.append("graph")},
    )
    assert list(times) == ["stepper", "graph"] and len(order) == 4


def test_each_interaction_is_answered_from_rest_by_any_stepper():
    force = np.zeros((3, 4, 2, 3), "float32")  # interactions, frames, nodes
    said = answers(Counter(), force)
    assert said.shape == (12, 2, 3)
    np.testing.assert_array_equal(said[:, 0, 0], [1, 2, 3, 4] * 3)


@pytest.fixture
def dataset_of_a_mesh_file(tiny, tmp_path, monkeypatch):
    """A dataset whose mesh came from a file, opened where that file is not."""
    mesh = box((4, 4, 2), 1.0)
    meshio.Mesh(mesh.points, [("hexahedron", mesh.cells)]).write(tmp_path / "block.vtu")
    tree = tiny | {
        "mesh": {
            "file": "block.vtu",
            "scale": 1e-3,
            "fixed": "all but z max",
            "loaded": "z max",
        },
        "interactions": tiny["interactions"] | {"train": 1},
    }
    (tmp_path / "scene.toml").write_text(config.dump_toml(tree))
    generate(load_scene(tmp_path / "scene.toml"), tmp_path / "data.h5", workers=1)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return open_dataset(tmp_path / "data.h5")


def test_the_fem_of_a_dataset_from_a_mesh_file_is_timed_on_the_datasets_own_mesh(
    dataset_of_a_mesh_file,
):
    assert latency.fem_action(dataset_of_a_mesh_file, "reduced")() is None


def test_memory_is_read_on_any_system(monkeypatch):
    with_proc = process.peak_mb()
    assert 10 < process.resident_mb() < 1.1 * with_proc
    monkeypatch.setattr(process, "Path", lambda name: Path("/nowhere"))  # as without /proc
    assert process.peak_mb() > 0


def test_the_machine_is_described_on_any_system(monkeypatch):
    for name in ("getloadavg", "sched_getaffinity"):
        monkeypatch.delattr(f"os.{name}", raising=False)
    found = latency.machine()
    assert found["cores"] >= 1 and found["load"] >= 0 and found["processor"]
