"""The reduced solver moves a body as the quasi-static one does, and scenes take it."""

import numpy as np
import pytest

import fem
from fem import settings as config
from fem.data.scene import Scene, load_scene
from fem.errors import InputError, SolverStopped, Stop
from fem.material.base import Hyperelastic
from fem.solver.quasistatic import QuasiStatic
from fem.solver.reduced import ReducedSolver


@pytest.fixture
def model(whole_model, tmp_path):
    """The file of a model of all modes and points."""
    whole_model.save(tmp_path / "whole.npz")
    return tmp_path / "whole.npz"


def push(mesh, size):
    """A load that climbs to `size` N in a second."""
    shape = np.zeros((3, mesh.n_nodes))
    shape[2, np.flatnonzero(mesh.loaded)[5:9]] = -size / 4
    return lambda t: min(t, 1.0) * shape


def test_with_all_modes_it_is_the_quasi_static_solver(block, tissue, model):
    full, reduced = QuasiStatic(block, tissue), ReducedSolver(block, tissue, model)
    for solver in (full, reduced):
        for _ in range(6):
            solver.advance(0.25, push(block, 0.4e-3))
    assert reduced.time == full.time and reduced.steps == full.steps
    assert np.linalg.norm(reduced.u - full.u) < 3e-3 * np.linalg.norm(full.u)
    assert reduced.min_J == pytest.approx(full.min_J, abs=1e-2)


def test_a_snapshot_goes_on(block, tissue, model):
    solver, other = (ReducedSolver(block, tissue, model) for _ in range(2))
    solver.advance(0.5, push(block, 0.4e-3))
    kept = solver.snapshot()
    solver.advance(0.5, push(block, 0.4e-3))
    other.restore(kept)
    other.advance(0.5, push(block, 0.4e-3))
    assert np.array_equal(other.u, solver.u)


def test_what_comes_to_no_rest_is_stopped(block, tissue, model):
    solver = ReducedSolver(block, tissue, model)
    with pytest.raises(SolverStopped) as stop:
        for _ in range(8):
            solver.advance(0.25, push(block, 1.0))
    assert stop.value.reason is Stop.NOT_IN_EQUILIBRIUM


def test_models_of_another_body_are_refused(block, tissue, model):
    with pytest.raises(InputError, match="another mesh"):
        ReducedSolver(fem.box((4, 3, 2), edge=2e-3), tissue, model)
    stiffer: Hyperelastic = tissue.scaled(2.0)
    with pytest.raises(InputError, match="another material"):
        ReducedSolver(block, stiffer, model)
    with pytest.raises(InputError, match="no reduced model"):
        ReducedSolver(block, tissue, "none.npz")


def test_a_scene_finds_its_model_beside_it(tiny, model, tmp_path):
    tree = tiny | {"solver": {"kind": "reduced", "model": "whole.npz"}}
    (tmp_path / "scene.toml").write_text(config.dump_toml(tree))
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.solver.sha256 and scene.health.disequilibrium == 0.1
    again = config.build(Scene, config.read_toml(tmp_path / "scene.toml"))
    assert again.digest() != scene.digest()  # until the content is known
    with pytest.raises(InputError, match="another mesh"):
        scene.build_solver(scene.mesh.build())
    model.write_bytes(b"other")
    with pytest.raises(InputError, match="is another model than"):
        scene.solver.located(tmp_path)


@pytest.mark.parametrize(
    "solver, words",
    [
        ({"kind": "reduced"}, "needs solver.model"),
        ({"model": "a.npz"}, "solver.model = 'a.npz' has no meaning"),
        ({"kind": "reduced", "model": "a.npz", "element": "reduced"}, "element = 'reduced'"),
        ({"kind": "reduced", "model": "a.npz", "mass_scaling": 4.0}, "mass_scaling = 4.0"),
        ({"kind": "reduced", "model": "a.npz", "tolerance": 0.1}, "tolerance = 0.1"),
    ],
)
def test_settings_of_another_solver_are_refused(tiny, solver, words):
    with pytest.raises(InputError, match=words):
        config.build(Scene, tiny | {"solver": solver})
