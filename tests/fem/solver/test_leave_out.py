"""What a scene does not mention costs nothing and changes no bit: Prony terms, damping, a second
contact, general cells."""

import dataclasses
import time
import tracemalloc

import numpy as np
import pytest

from fem import settings as config
from fem.contact.draw import draw_contacts
from fem.contact.push import Load
from fem.contact.surface import Surface
from fem.data.scene import Scene
from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box, tumour
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS, InternalForce

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
VISCOELASTIC = dataclasses.replace(TISSUE, prony=((0.12, 330.0), (0.8, 11.0)))
EDGE = 1e-3  # m


def shortest(run, repeats=5):
    """Least wall-clock time of some runs, in s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def bytes_of(build):
    """Memory in bytes that the result of `build` holds."""
    tracemalloc.start()
    kept = build()
    size = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    del kept
    return size


def pushed(mesh, material, duration=0.05, **choices):
    solver = Solver(mesh, material, **choices)
    load, centre = (
        np.zeros((3, mesh.n_nodes)),
        [*mesh.points[:, :2].mean(axis=0), mesh.points[:, 2].max()],
    )
    load[2] = -1e-3 * Surface(mesh).footprint(np.array(centre), 2e-3)
    solver.advance(duration, lambda t: load * min(1, t / 0.02))
    return solver


def test_elastic_tissue_keeps_no_history():
    """Without Prony terms there is no history, no old stress, and no second kernel for the
    tangent."""
    elastic, viscous = (
        Solver(box((4, 4, 3), EDGE), material) for material in (TISSUE, VISCOELASTIC)
    )
    assert all(chunk.history is None for chunk in elastic.force._chunks)
    assert all(chunk.history is not None for chunk in viscous.force._chunks)
    assert elastic.leapfrog.elastic_force is elastic.force
    assert viscous.leapfrog.elastic_force is not viscous.force


@pytest.mark.timing
def test_elastic_run_takes_less_time_and_memory():
    """On the tumour Prony terms, brought up to date in every step, cost at least a quarter more
    time and twice the memory."""
    mesh, u = tumour(), np.zeros((3, 1782))
    elastic, viscous = InternalForce(mesh, TISSUE), InternalForce(mesh, VISCOELASTIC)

    def history():
        viscous.relax(1e-3)
        viscous(u)

    assert shortest(lambda: [elastic(u) for _ in range(20)]) < 0.8 * shortest(
        lambda: [history() for _ in range(20)]
    )
    assert bytes_of(lambda: InternalForce(mesh, VISCOELASTIC)) > 2 * bytes_of(
        lambda: InternalForce(mesh, TISSUE)
    )


@pytest.mark.parametrize("kind", ELEMENTS)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_prony_terms_left_out_are_terms_without_weight(kind, precision):
    """A run without Prony terms has bit for bit the displacement of one whose stress history
    weighs nothing; a little weight shows."""
    mesh = box((4, 4, 3), EDGE)
    nothing = dataclasses.replace(TISSUE)  # less than a scene may ask for
    object.__setattr__(nothing, "prony", ((1e-300, 0.1),))
    without, weightless, little = (
        pushed(mesh, law, element=kind, precision=precision)
        for law in (TISSUE, nothing, dataclasses.replace(TISSUE, prony=((1e-3, 0.1),)))
    )
    assert without.u.any() and np.array_equal(without.u, weightless.u)
    assert np.array_equal(without.v, weightless.v) and not np.array_equal(without.u, little.u)


def test_scene_without_prony_is_the_scene_with_an_empty_list(tiny):
    """A scene file that leaves `prony` out is, digest and solver, that of one that sets it to an
    empty list, and not that of one with terms."""
    silent = {key: value for key, value in tiny["material"].items() if key != "prony"}
    left_out, empty, terms = (
        config.build(Scene, tiny | {"material": material})
        for material in (silent, silent | {"prony": []}, tiny["material"])
    )
    assert left_out == empty and left_out.digest() == empty.digest() != terms.digest()
    assert len(left_out.build_solver(left_out.mesh.build()).force.state()) == 0


def test_damping_left_out_is_damping_too_small_to_matter():
    """A run without damping has bit for bit the displacement of the damped step with next to no
    damping; a little of it shows."""
    mesh = box((4, 4, 3), EDGE)
    without, next_to_none, little = (
        pushed(mesh, TISSUE, damping=damping) for damping in (0.0, 1e-300, 1e-3)
    )
    assert without.u.any() and np.array_equal(without.u, next_to_none.u)
    assert np.array_equal(without.v, next_to_none.v) and not np.array_equal(without.u, little.u)


def test_one_contact_is_one_contact(tiny):
    """With count = 1 there is one Contact; its load is bit for bit its own force field, from one
    footprint each time."""
    scene = config.build(Scene, config.merge(tiny, {"contact": {"count": 1}}))
    surface = Surface(scene.mesh.build())
    (contact,) = draw_contacts(
        surface, scene.contact, scene.frames.duration, np.random.default_rng(0)
    )
    evaluations, footprint = [], surface.footprint
    surface.footprint = lambda *where: evaluations.append(where) or footprint(*where)
    load = Load(surface, [contact])
    for t in np.linspace(0, scene.frames.duration, 7):
        alone = contact.force(t)[:, None] * footprint(contact.centre(t), contact.radius)
        assert np.array_equal(load(t), alone)
    assert len(evaluations) == 7
    Load(surface, [contact, contact])(0.1)
    assert len(evaluations) == 9


def test_first_contact_does_not_depend_on_a_second(tiny):
    """With one seed, the contact of a scene with one is the first contact of the same scene with
    two."""
    one, two = (config.build(Scene, config.merge(tiny, {"contact": {"count": n}})) for n in (1, 2))
    surface = Surface(one.mesh.build())
    single, pair = (
        draw_contacts(surface, scene.contact, scene.frames.duration, np.random.default_rng(3))
        for scene in (one, two)
    )
    assert (len(single), len(pair)) == (1, 2)
    for name in dataclasses.asdict(single[0]):
        assert np.array_equal(getattr(single[0], name), getattr(pair[0], name))


def test_congruent_cells_share_one_gradient_matrix():
    """A mesh of equal cubes holds one (24, 8) gradient matrix whatever its size, and no Jacobian
    for each cell."""
    for mesh in (box((2, 2, 2), EDGE), tumour()):
        (chunk,) = InternalForce(mesh, TISSUE)._chunks
        assert chunk.element.gradient.shape == (24, 8) and chunk.element.to_physical is None


@pytest.mark.timing
def test_shared_gradients_take_less_time_and_memory(distort):
    """Equal cubes need less time and memory than cells of different shape."""
    cubes = tumour()
    general, u = distort(cubes), np.zeros((3, cubes.n_nodes))
    shared, own = InternalForce(cubes, TISSUE), InternalForce(general, TISSUE)
    assert shortest(lambda: [shared(u) for _ in range(20)]) < 0.9 * shortest(
        lambda: [own(u) for _ in range(20)]
    )
    assert bytes_of(lambda: InternalForce(cubes, TISSUE)) < 0.8 * bytes_of(
        lambda: InternalForce(general, TISSUE)
    )


def test_hourglass_control_is_of_reduced_cells_alone():
    """Full cells carry no hourglass stiffness, and their answer does not depend on it."""
    mesh = box((4, 4, 3), EDGE)
    soft, hard = (pushed(mesh, TISSUE, hourglass_stiffness=k) for k in (0.0, 1.0))
    assert np.array_equal(soft.u, hard.u)
    assert not hasattr(soft.force._chunks[0].element, "stiffness")
