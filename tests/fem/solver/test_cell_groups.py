"""Two tissues in one mesh: another code's forces, closed forms, stable steps, energy, loops."""

from dataclasses import replace

import felupe
import numpy as np
import pytest

from fem.errors import SolverStopped
from fem.material import MooneyRivlin, NeoHooke, Ogden
from fem.material.groups import by_cells
from fem.mesh.shapes import box
from fem.solver.energy import EnergyLedger
from fem.solver.explicit import Solver
from fem.solver.frame_loop import FrameLoop, LoopSettings, coarse_mesh, longest_step, loop_material
from fem.solver.internal_force import ELEMENTS, InternalForce
from fem.solver.rest import equilibrium

EDGE = 1e-3  # m
NEO = NeoHooke(400.0, 0.42, 1000.0)
every_element = pytest.mark.parametrize("kind", ELEMENTS)


def block(cells=(4, 4, 3), fixed="all but top"):
    """A box with a stiff core, the cells of x and y between 1 and 3 mm, and layers by height."""
    mesh = box(cells, EDGE, fixed)
    centre = mesh.points[mesh.cells].mean(axis=1)
    core = (np.abs(centre[:, :2] - 2 * EDGE) < EDGE).all(axis=1)
    return mesh.with_sets(core=core, upper=centre[:, 2] > cells[2] / 2 * EDGE)


def wobble(mesh, amount=0.1, seed=3):
    """A random displacement (3, N)."""
    return amount * EDGE * np.random.default_rng(seed).uniform(-1, 1, (3, mesh.n_nodes))


def difference(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


@pytest.mark.parametrize("shape", ["congruent", "distorted"])
@pytest.mark.parametrize("changes", [{"mu": 1200.0}, {"nu": 0.3}, {"mu": 40_000.0, "nu": 0.49}])
def test_two_bodies_of_another_code_have_these_forces(changes, shape, distort):
    """felupe's bodies, one on the core's cells and one on the others, add up to the force."""
    mesh = block() if shape == "congruent" else distort(block())
    u, expected = wobble(mesh), 0
    for cells, law in (
        (mesh.cell_sets["core"], replace(NEO, **changes)),
        (~mesh.cell_sets["core"], NEO),
    ):
        part = felupe.Mesh(mesh.points, mesh.cells[cells], "hexahedron")
        field = felupe.Field(felupe.RegionHexahedron(part), dim=3, values=u.T.copy())
        neo_hooke = felupe.NeoHookeCompressible(mu=law.mu) & felupe.Volumetric(bulk=law.K)
        body = felupe.SolidBody(neo_hooke, felupe.FieldContainer([field]))
        expected = expected + body.assemble.vector().toarray().reshape(-1, 3).T
    law = by_cells(NEO, mesh, {"core": changes})
    assert difference(InternalForce(mesh, law)(u), expected) < 1e-12
    assert difference(InternalForce(mesh, law, precision="float32")(u), expected) < 2e-6


@every_element
def test_the_step_is_sharp_where_one_group_is_a_hundred_times_stiffer(kind):
    """600 steps of 0.98 of the critical step keep a small motion small; with 1.02 it grows."""
    mesh = block()
    law = by_cells(NEO, mesh, {"core": {"mu": 40_000.0}})
    solver = Solver(mesh, law, kind)
    assert solver.critical_step < 0.2 * Solver(mesh, NEO, kind).critical_step
    speed, still = 1e-9, np.zeros_like(solver.v)
    for share in (0.98, 1.02):
        solver = Solver(mesh, law, kind)
        v = np.random.default_rng(0).normal(0, speed, still.shape)
        solver.v[:] = np.where(mesh.fixed, 0, v)
        start, critical = np.linalg.norm(solver.v), solver.critical_step
        if share < 1:
            solver.advance(600 * share * critical, lambda t: still, steps=600)
            assert np.linalg.norm(solver.v) < 2 * start
        else:
            solver.pace.critical = np.inf  # or the step would be refused at once
            with pytest.raises(SolverStopped):
                solver.advance(600 * share * critical, lambda t: still, steps=600)


@every_element
def test_stiffening_is_relative_to_each_group_at_rest(kind):
    """Groups that differ in mu alone stiffen as one tissue does, each relative to itself, and the
    step falls no faster than with its power of 3/4."""
    mesh = block(fixed="none")
    law = by_cells(NEO, mesh, {"core": {"mu": 40_000.0}})
    force, alone = InternalForce(mesh, law, kind), InternalForce(mesh, NEO, kind)
    solver = Solver(mesh, law, kind)
    rest = solver.critical_step
    for u in (np.zeros_like(solver.u), wobble(mesh), np.diag([0.3, 0.3, 0.2]) @ mesh.points.T):
        for each in (force, alone):
            each(u, check=True)
        assert force.stiffening == pytest.approx(alone.stiffening, rel=1e-12)
    assert force.stiffening > 1.1
    solver.u[:] = u
    solver.estimate_step()
    assert 0.98 * rest * force.stiffening**-0.75 < solver.critical_step < rest


def stretch_under(law, traction):
    """The vertical stretch of a laterally confined cube whose P_33 is `traction`, by bisection."""
    low, high = 0.3, 3.0
    for _ in range(100):
        middle = (low + high) / 2
        above = law.stress(np.diag([1.0, 1.0, middle])[:, :, None])[2, 2, 0] > traction
        low, high = (low, middle) if above else (middle, high)
    return middle


LAYERED = {
    "neo_hooke": (NEO, {"mu": 1200.0, "nu": 0.1}),
    "mooney_rivlin": (MooneyRivlin(150.0, 50.0, 0.42, 1000.0), {"c10": 500.0, "c01": 10.0}),
    "ogden": (
        Ogden(((40.0, 8.0), (-60.0, -4.0)), 0.4, 1000.0),
        {"terms": ((90.0, 8.0), (-20.0, -4.0))},
    ),
}


@every_element
@pytest.mark.parametrize("law, changes", LAYERED.values(), ids=LAYERED)
@pytest.mark.parametrize("traction", [-60.0, 150.0])
def test_two_layers_in_series_rest_at_their_closed_forms(traction, law, changes, kind):
    """Under one vertical traction, and dead loads on the walls that keep them from bulging, each
    layer takes the stretch at which its own P_33 is that traction."""
    mesh = block((2, 2, 4), "bottom")
    half = 2 * EDGE
    laws = law, replace(law, **changes)
    stretches = [stretch_under(each, traction) for each in laws]
    stresses = [
        each.stress(np.diag([1.0, 1.0, s])[:, :, None])[..., 0]
        for each, s in zip(laws, stretches, strict=True)
    ]
    load, centre = np.zeros(mesh.points.shape), mesh.points.mean(axis=0)
    for face in mesh.boundary_faces:
        middle = mesh.points[face].mean(axis=0)
        normal = np.where(np.ptp(mesh.points[face], axis=0) == 0, np.sign(middle - centre), 0)
        load[face] += stresses[int(middle[2] > half)] @ normal * EDGE**2 / 4
    z = mesh.points[:, 2]
    u = np.zeros((3, mesh.n_nodes))
    u[2] = (stretches[0] - 1) * z.clip(0, half) + (stretches[1] - 1) * (z - half).clip(0)
    both = by_cells(law, mesh, {"upper": changes})
    residual = (InternalForce(mesh, both, kind)(u).T - load)[z > 0]
    assert np.abs(residual).max() < 1e-11 * np.abs(load).max()
    found = equilibrium(mesh, both, load, 1e-8, kind).displacement
    assert difference(found.T, u) < 1e-6


@every_element
@pytest.mark.parametrize("prony", [(), ((0.5, 0.05),)], ids=["elastic", "viscoelastic"])
def test_energy_balances_with_two_tissues(prony, kind):
    """A smooth push with damping on a core ten times as stiff and half as dense leaves an imbalance
    below 1 %."""
    mesh = block()
    changes = {"mu": 4000.0, "nu": 0.3, "density": 500.0}
    law = by_cells(replace(NEO, prony=prony), mesh, {"core": changes})
    solver, ledger = Solver(mesh, law, kind, damping=30.0), EnergyLedger()
    load = np.where(mesh.fixed, 0, np.array([[0], [0], [-1e-3]]) * (mesh.points[:, 2] > 2.9 * EDGE))
    solver.advance(0.1, lambda t: np.sin(30 * t) ** 2 * load, [ledger])
    assert len(ledger.rows) >= 2 and ledger.smallest_J < 0.9
    assert ledger.worst_imbalance() < 0.01


def test_densities_of_groups_add_up_to_the_mass():
    mesh = block(fixed="none")
    law = by_cells(NEO, mesh, {"core": {"density": 500.0}})
    expected = 1000.0 * mesh.volume() - 500.0 * mesh.cell_sets["core"].sum() * EDGE**3
    assert Solver(mesh, law).mass.sum() == pytest.approx(expected, rel=1e-12)


def test_a_coarse_loop_takes_the_mean_over_the_volume_of_its_cells():
    """Three layers become two: the upper has a third of the middle layer's tissue."""
    mesh = box((4, 4, 3), EDGE)
    centre = mesh.points[mesh.cells].mean(axis=1)
    mesh = mesh.with_sets(roof=centre[:, 2] > 2 * EDGE, left=(centre < 2 * EDGE)[:, 0])
    coarse = coarse_mesh(mesh)[0]
    middle = coarse.points[coarse.cells].mean(axis=1)
    law = loop_material(mesh, coarse, by_cells(NEO, mesh, {"roof": {"mu": 1000.0}}))
    np.testing.assert_allclose(law.mu, np.where(middle[:, 2] > 1.5 * EDGE, 800.0, 400.0))
    law = loop_material(mesh, coarse, by_cells(NEO, mesh, {"left": {"density": 800.0}}))
    np.testing.assert_allclose(law.density, np.where(middle[:, 0] < 2 * EDGE, 800.0, 1000.0))
    assert law.mu == 400.0 and loop_material(mesh, coarse, NEO) == NEO


@pytest.mark.parametrize("coarse", [False, True])
def test_a_loop_answers_with_the_tissue_of_its_cells(coarse):
    """It is stiffer with a stiffer core, and its longest step is its own."""
    mesh, settings = block((4, 4, 4)), LoopSettings("full", coarse, 0.02, 60)
    force = np.zeros((mesh.n_nodes, 3))
    force[~mesh.fixed & (mesh.points[:, 2] > 3.9 * EDGE), 2] = -0.02
    laws = NEO, by_cells(NEO, mesh, {"core": {"mu": 4000.0}})
    depths = [np.abs(FrameLoop(mesh, law, settings).step(force)).max() for law in laws]
    assert 0 < depths[1] < 0.9 * depths[0]
    assert longest_step(mesh, laws[1], settings) < 0.7 * longest_step(mesh, laws[0], settings)
