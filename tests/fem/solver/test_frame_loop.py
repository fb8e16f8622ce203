"""The FEM as a stepper: frames, layouts, states, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from fem.contact.push import Load, Push
from fem.contact.surface import Surface
from fem.errors import InputError
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box, tumour
from fem.online.grid import MM, MN
from fem.online.stepper import Stepper
from fem.solver.explicit import Solver
from fem.solver.frame_loop import FrameLoop, LoopSettings, coarse_mesh

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0, prony=((0.12, 330.0), (0.8, 11.0)))
MESH = box((4, 4, 2), 1e-3)
GRID = MESH.grid
FRAME = 0.02  # s
SETTINGS = LoopSettings("full", False, FRAME, 6)


def forces(n=6):
    """(n, N, 3) float32 mN that push the top down and sideways."""
    field = np.zeros((MESH.n_nodes, 3))
    top = (MESH.points[:, 2] > 1.9e-3) & ~MESH.fixed
    field[top] = [0.004, 0.002, -0.02]
    return (np.sin(np.arange(1, n + 1) / 2)[:, None, None] * field).astype(np.float32)


def answers(loop, field=None):
    return np.array([loop.step(force) for force in (forces() if field is None else field)])


def test_a_loop_is_a_stepper_of_its_frame():
    loop = FrameLoop(MESH, TISSUE, SETTINGS)
    assert isinstance(loop, Stepper) and loop.interval == FRAME
    loop.step(forces()[0], FRAME)
    with pytest.raises(InputError, match="made for 0.02 s between calls"):
        loop.step(forces()[0], 0.01)
    assert loop.solver.steps == SETTINGS.steps


@pytest.mark.parametrize("element, coarse", [("full", False), ("reduced", False), ("full", True)])
def test_both_layouts_give_the_same_displacement(element, coarse):
    settings = replace(SETTINGS, element=element, coarse=coarse)
    nodal = answers(FrameLoop(MESH, TISSUE, settings))
    on_grid = answers(FrameLoop(MESH, TISSUE, settings), GRID.to_grid(forces()))
    assert nodal.dtype == on_grid.dtype == np.float32 and nodal.any()
    np.testing.assert_array_equal(GRID.from_grid(on_grid), nodal)


def test_a_mesh_without_a_grid_takes_nodal_forces_and_no_coarse_mesh():
    loose = replace(MESH, grid=None)
    np.testing.assert_array_equal(
        answers(FrameLoop(loose, TISSUE, SETTINGS)), answers(FrameLoop(MESH, TISSUE, SETTINGS))
    )
    with pytest.raises(
        InputError, match=r"shape \(5, 5, 3, 3\); give finite mN of shape \(75, 3\)"
    ):
        FrameLoop(loose, TISSUE, SETTINGS).step(GRID.to_grid(forces()[0]))
    for refused in (FrameLoop, lambda mesh, *_: coarse_mesh(mesh)):
        with pytest.raises(InputError, match="does not lie on one; set coarse = False"):
            refused(loose, TISSUE, replace(SETTINGS, coarse=True))


@pytest.mark.parametrize("fixed", ["all but top", "bottom", "x min"])
@pytest.mark.parametrize("cells", [(4, 4, 2), (3, 3, 3), (5, 2, 1)])
def test_a_coarse_box_is_held_as_the_fine_one(cells, fixed):
    coarse, _ = coarse_mesh(box(cells, 1e-3, fixed))
    halves = tuple(n - 1 for n in coarse.grid.shape)
    assert halves == tuple(max(1, round(n / 2)) for n in cells)
    assert np.array_equal(coarse.fixed, box(halves, 1e-3, fixed).fixed)


def test_a_coarse_tumour_keeps_its_levels_symmetry_supports_and_groups():
    """Levels at 0, 2.5, 5 and 6 edges; a bump of ten cells, symmetric in x; held at bottom and
    walls; rigid motion and total forces are exact, and every free node moves along."""
    fine = tumour(1.0)
    coarse, A = coarse_mesh(fine)
    x, y, z = coarse.points.T
    assert np.unique(z).tolist() == [0.0, 2.5, 5.0, 6.0] and coarse.n_cells == 2 * 64 + 10
    walls = (z <= 5) & ((x == 0) | (x == 16) | (y == 0) | (y == 16))
    assert np.array_equal(coarse.fixed, walls | (z == 0))
    centres = coarse.points[coarse.cells].mean(axis=1)
    mirrored = centres * [-1, 1, 1] + [16, 0, 0]
    for cells in (np.ones(coarse.n_cells, bool), coarse.cell_sets["tumour"]):
        assert set(map(tuple, centres[cells])) == set(map(tuple, mirrored[cells]))
    assert (coarse.cell_sets["tumour"] ^ coarse.cell_sets["tissue"]).all()
    assert coarse.cell_sets["tumour"][centres[:, 2] > 5].all()
    np.testing.assert_allclose(A.sum(axis=1), 1, rtol=1e-12)
    loose = A @ (~coarse.fixed).astype(float)
    assert (loose[~fine.fixed] > 0.05).all()


def test_a_coarse_tumour_answers_a_push_about_as_the_fine_one():
    push = Load(Surface(tumour()), [Push("top", 0.5e-3, 2.4e-3, ramp=0.3)])
    u = []
    for coarse in (False, True):
        loop = FrameLoop(tumour(), TISSUE, LoopSettings("full", coarse, 0.02, 60))
        for t in np.arange(1, 31) * 0.02:
            answer = loop.step(push(t).T * MN)
        u.append(answer)
    assert np.linalg.norm(u[1] - u[0]) < 0.25 * np.linalg.norm(u[0])


@pytest.mark.parametrize("element, coarse", [("full", False), ("reduced", True)])
@pytest.mark.parametrize(
    "material", [TISSUE, replace(TISSUE, prony=())], ids=["viscous", "elastic"]
)
def test_a_loop_goes_on_from_its_state_bit_for_bit(material, element, coarse, tmp_path):
    """Restored from a file, in the same loop or another, it gives the bytes that it gave before."""
    settings = replace(SETTINGS, element=element, coarse=coarse)
    loop = FrameLoop(MESH, material, settings)
    answers(loop)
    np.savez(tmp_path / "state.npz", **loop.state())
    went_on = answers(loop, 2 * forces())
    with np.load(tmp_path / "state.npz") as file:
        kept = dict(file)
    for other in (loop, FrameLoop(MESH, material, settings)):
        other.restore(kept)
        assert answers(other, 2 * forces()).tobytes() == went_on.tobytes()


def test_reset_is_the_loop_as_it_was_made():
    loop = FrameLoop(MESH, TISSUE, SETTINGS)
    first = answers(loop)
    assert answers(loop).tobytes() != first.tobytes()  # it remembers
    loop.reset()
    assert answers(loop).tobytes() == first.tobytes()


def test_what_a_loop_cannot_take_is_refused_and_changes_nothing():
    loop = FrameLoop(MESH, TISSUE, SETTINGS)
    answers(loop)
    before = loop.state()
    for bad in (forces()[0].T, np.full((MESH.n_nodes, 3), np.nan)):
        with pytest.raises(InputError):
            loop.step(bad)
    other = FrameLoop(box((2, 2, 2), 1e-3), TISSUE, SETTINGS).state()
    for state in (other, {}, {"load": before["load"]}):
        with pytest.raises(InputError, match="restore one of the same mesh"):
            loop.restore(state)
    after = loop.state()
    assert all(np.array_equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("setting", [{"frame": 0.0}, {"steps": 0}, {"rise": 1.5}, {"damping": -1}])
def test_settings_without_meaning_are_refused(setting):
    ((name, value),) = setting.items()
    with pytest.raises(InputError, match=f"{name} = {value}"):
        replace(SETTINGS, **setting)


def test_many_steps_a_frame_are_the_solver():
    """With steps of half the stable one the loop follows a Solver that estimates its own."""
    steps = int(2 * FRAME / Solver(MESH, TISSUE).critical_step)
    loop = FrameLoop(MESH, TISSUE, replace(SETTINGS, steps=steps, damping=0.02))
    assert loop.mass_scaling == 1
    solver, before = Solver(MESH, TISSUE, damping=loop.damping_rate), np.zeros((3, MESH.n_nodes))
    for force, u in zip(forces(), answers(loop), strict=True):
        now, start = force.T.astype(float) / 1e3, solver.time
        solver.advance(FRAME, lambda t: before + (t - start) / FRAME * (now - before))  # noqa: B023
        before = now
        assert np.linalg.norm(u - solver.u.T * MM) < 0.05 * np.linalg.norm(u)


def test_a_loop_keeps_room_for_what_a_hard_push_takes_from_its_stable_step():
    """A push of the thickness of a cell, at steps that the mass is scaled for: with hardly any
    share of the critical step kept back it ends in a crushed cell."""
    loop = FrameLoop(MESH, TISSUE, replace(SETTINGS, steps=8))
    push = Load(Surface(MESH), [Push("top", 3e-3, 1.5e-3, ramp=0.2)])
    assert loop.mass_scaling > 1
    for t in np.arange(1, 40) * FRAME:
        u = loop.step(push(t).T * MN)
    assert 0.7 < np.abs(u).max() < 0.9  # mm
