"""The reduced stepper against the full-order internal force, closed forms and its own promises."""

import dataclasses

import numpy as np
import pytest

import fem
from fem.errors import InputError
from fem.online.creep import Creep
from fem.online.reduced import ReducedStepper
from fem.online.reduced_model import ReducedModel
from fem.online.stepper import Stepper
from fem.solver.internal_force import InternalForce
from unet_fem.steppers import open_stepper

INTERVALS = (0.25, 0.01, 0.5, 0.25, 1.0)  # s
SIZES = (0.12, 0.25, 0.5, 0.5, 0.12)  # mN


def push(mesh, size=0.3, where=None):
    """A downward force of `size` mN with a sideward part at some nodes, (N, 3)."""
    force = np.zeros(mesh.points.shape, "float32")
    nodes = np.flatnonzero(mesh.loaded)[5:9] if where is None else where
    force[nodes] = np.array([0.3, 0.1, -1.0]) * size / len(nodes)
    return force


def equilibrium_error(mesh, material, forces, intervals, answers):
    """The largest |f_int - f| / |f| of the frames at the free nodes, of the solver's own force."""
    internal, worst = InternalForce(mesh, material), 0.0
    for f, dt, u in zip(forces, intervals, answers, strict=True):
        internal.relax(dt)
        rest = internal(u.T.astype(float) * 1e-3) * 1e3 - f.T
        worst = max(worst, np.linalg.norm(rest[:, ~mesh.fixed]) / np.linalg.norm(f))
    return worst


@pytest.mark.parametrize(
    "material",
    [
        fem.NeoHooke(400.0, 0.42, 1000.0),
        fem.NeoHooke(400.0, 0.42, 1000.0, ((0.12, 330.0), (0.8, 11.0))),
        fem.MooneyRivlin(150.0, 50.0, 0.42, 1000.0, ((0.5, 2.0),)),
        fem.Ogden(((40.0, 8.0), (-60.0, -4.0)), 0.45, 1000.0, ((0.5, 2.0),)),
    ],
)
def test_with_all_modes_and_points_it_is_the_viscoelastic_equilibrium_of_the_full_mesh(
    block, material, reduce_wholly
):
    stepper = ReducedStepper(reduce_wholly(block, material), tolerance=1e-6, most=60)
    forces = [push(block, size) for size in SIZES]
    answers = [stepper.step(f, dt) for f, dt in zip(forces, INTERVALS, strict=True)]
    assert 0.05 < np.abs(answers[2]).max()  # mm: a twentieth of an edge and more
    assert equilibrium_error(block, material, forces, INTERVALS, answers) < 5e-4


def test_without_a_mirror_and_a_node_grid_too(block, tissue, distort, reduce_wholly):
    mesh = dataclasses.replace(distort(block), grid=None)
    model = reduce_wholly(mesh, tissue)
    assert model.axis is None and len(model.blocks) == 1
    stepper = ReducedStepper(model, tolerance=1e-6, most=60)
    forces = [push(mesh, size) for size in SIZES]
    answers = [stepper.step(f, dt) for f, dt in zip(forces, INTERVALS, strict=True)]
    assert equilibrium_error(mesh, tissue, forces, INTERVALS, answers) < 5e-4


def test_cells_of_their_own_stiffness(block, reduce_wholly):
    middle = np.abs(block.points[block.cells].mean(axis=1)[:, 0] - 2e-3) < 1e-3
    material = fem.NeoHooke(np.where(middle, 900.0, 400.0), 0.42, 1000.0, ((0.5, 2.0),))
    model = reduce_wholly(block, material)
    assert len(model.blocks) == 2
    stepper = ReducedStepper(model, tolerance=1e-6, most=60)
    forces = [push(block, size) for size in SIZES]
    answers = [stepper.step(f, dt) for f, dt in zip(forces, INTERVALS, strict=True)]
    assert equilibrium_error(block, material, forces, INTERVALS, answers) < 5e-4


def test_a_small_held_force_creeps_by_the_closed_form_whatever_the_intervals(whole_model, tissue):
    stepper = ReducedStepper(whole_model)
    force = np.zeros((whole_model.meta["nodes"], 3), "float32")
    force[-1] = [0.0, 0.0, -1e-3]
    first = stepper.step(force, 1e-3)
    elapsed = 0.0
    for dt in (0.01, 1.0, 0.25, *[1.0] * 20, 0.01):
        elapsed += dt
        answer = stepper.step(force, dt)
    grown = np.linalg.norm(answer) / np.linalg.norm(first)
    assert grown == pytest.approx(Creep.of(tissue.prony)(elapsed), rel=3e-3)


def test_a_long_frame_is_as_many_short_ones_under_a_force_that_grows(whole_model, block):
    force = push(block)
    long, short = (ReducedStepper(whole_model, None, 1e-6, 60) for _ in range(2))
    for stepper in (long, short):
        stepper.step(force, 1.0)
    found = long.step(3 * force, 40.0)
    count = long._steps
    assert count > 4
    for k in range(1, count + 1):
        wanted = short.step((1 + 2 * k / count) * force, 40.0 / count)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_a_mirrored_force_has_the_mirrored_answer(whole_model, block):
    mirrored = np.argmin(
        np.linalg.norm(block.points - (block.points * [-1, 1, 1] + [4e-3, 0, 0])[:, None], axis=2),
        axis=1,
    )
    stepper, force = ReducedStepper(whole_model), push(block, 2.0)
    answer = stepper.step(force, 0.25)
    stepper.reset()
    image = stepper.step(force[mirrored] * np.float32([-1, 1, 1]), 0.25)
    assert np.allclose(image[mirrored] * [-1, 1, 1], answer, atol=1e-5 * np.abs(answer).max())


def test_the_grid_and_the_nodes_have_the_same_answer(whole_model, block):
    force = push(block, 2.0)
    nodal, gridded = ReducedStepper(whole_model), ReducedStepper(whole_model)
    answer = nodal.step(force, 0.25)
    assert np.array_equal(block.grid.to_grid(answer), gridded.step(block.grid.to_grid(force), 0.25))
    assert not answer[block.fixed].any()


def test_forces_elsewhere_are_carried_by_the_modes_and_told(whole_model, block, tissue):
    inside = np.flatnonzero(~block.fixed & ~block.loaded)[:3]
    stepper, force = ReducedStepper(whole_model, tolerance=1e-6, most=60), push(block, 0.5, inside)
    answer = stepper.step(force, 0.25)
    assert not stepper.carried
    assert equilibrium_error(block, tissue, [force], [0.25], [answer]) < 5e-4
    stepper.step(push(block), 0.25)
    assert stepper.carried


def test_its_state_is_all_that_the_next_answer_depends_on(whole_model, block):
    stepper, other = ReducedStepper(whole_model, 0.25), ReducedStepper(whole_model)
    assert isinstance(stepper, Stepper)
    for size in (0.5, 1.0, 2.0):
        stepper.step(push(block, size))
    state = stepper.state()
    answers = [stepper.step(push(block, size)) for size in (2.0, 1.0)]
    other.restore(state)
    again = [other.step(push(block, size), 0.25) for size in (2.0, 1.0)]
    assert np.array_equal(again, answers)
    with pytest.raises(InputError, match="another stepper"):
        other.restore({"forces": np.zeros(3)})


def test_worthless_secants_move_no_answer(whole_model, block):
    """Such as frames leave in which nothing moved: differences of rounding alone."""
    stepper = ReducedStepper(whole_model, 0.01)
    for _ in range(4):
        stepper.step(push(block, 0.1))
    state = stepper.state()
    answer = stepper.step(push(block, 0.1001))
    dR, dX = np.random.default_rng(0).normal(size=(2, *state["secants"][0].shape))
    noise = {"secants": np.stack([1e-7 * dR, 1e-2 * dX]), "gram": 1e-14 * dR @ dR.T}
    stepper.restore(state | noise | {"count": np.array(len(dR))})
    again = stepper.step(push(block, 0.1001))
    assert np.linalg.norm(again - answer) < 1e-3 * np.linalg.norm(answer)


def test_what_no_tissue_bears_ends_in_finite_numbers_and_is_told(whole_model, block):
    stepper = ReducedStepper(whole_model)
    answer = stepper.step(push(block, 500.0), 0.25)
    assert np.isfinite(answer).all() and stepper.unrest > 0.01
    for _ in range(20):
        answer = stepper.step(np.zeros_like(push(block)), 10.0)
    assert np.isfinite(answer).all()


@pytest.mark.parametrize(
    "force, dt, words",
    [
        (np.zeros((3, 3)), 0.25, "shape"),
        (np.full((60, 3), np.nan, "float32"), 0.25, "not finite"),
        (np.zeros((60, 3)), None, "give dt"),
        (np.zeros((60, 3)), -1.0, "positive"),
    ],
)
def test_bad_calls_are_refused_and_change_nothing(whole_model, block, force, dt, words):
    stepper = ReducedStepper(whole_model)
    stepper.step(push(block), 0.25)
    before = stepper.state()
    with pytest.raises(InputError, match=words):
        stepper.step(force, dt)
    assert all(np.array_equal(before[name], now) for name, now in stepper.state().items())


def test_a_file_gives_the_same_stepper(whole_model, block, tmp_path):
    whole_model.save(tmp_path / "a.npz")
    opened = open_stepper(tmp_path / "a.npz", interval=0.25)
    own = ReducedStepper(whole_model, 0.25)
    for size in (1.0, 2.0):
        assert np.array_equal(opened.step(push(block, size)), own.step(push(block, size)))


def damaged(path, change):
    """The file with `change(arrays)` done to it."""
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    np.savez(path, **arrays)


def test_damaged_files_are_refused_by_what_is_wrong(whole_model, tmp_path):
    path = tmp_path / "a.npz"
    cases = {
        "not a whole 'unet-fem reduced 1' file": lambda a: a.update(format=np.array("other 1")),
        "A0 holds values that are not finite": lambda a: a["A0"].__setitem__(0, np.nan),
        "M1 is float32 of shape": lambda a: a.update(M1=a["M1"][:, :-1]),
        "KeyError.'encoder0'": lambda a: a.pop("encoder0"),
        "outside the mesh": lambda a: a["force"].__setitem__(0, 1000),
    }
    for words, change in cases.items():
        whole_model.save(path)
        damaged(path, change)
        with pytest.raises(InputError, match=words):
            ReducedModel.load(path)
    whole_model.save(path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(InputError, match="not a whole"):
        ReducedModel.load(path)
    with pytest.raises(InputError, match="no reduced model"):
        ReducedModel.load(tmp_path / "none.npz")


def test_a_model_of_another_mesh_or_material_is_refused(whole_model, block):
    whole_model.check(block.digest, whole_model.meta["material"])
    with pytest.raises(InputError, match="another mesh"):
        whole_model.check("0123456789")
    with pytest.raises(InputError, match="another material"):
        whole_model.check(block.digest, "0123456789")


def test_arrays_that_do_not_fit_are_refused(whole_model):
    with pytest.raises(InputError, match="do not fit"):
        dataclasses.replace(whole_model, axis=None)
    with pytest.raises(InputError, match="'clay'"):
        dataclasses.replace(whole_model, meta=whole_model.meta | {"law": {"kind": "clay"}})
