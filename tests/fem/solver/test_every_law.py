"""The kernel that takes any law: against the fused one and another code, histories, one value a
cell, and laws of a user's own."""

import dataclasses
from pathlib import Path

import felupe
import numpy as np
import pytest

from fem.errors import InputError
from fem.material import MooneyRivlin, NeoHooke, Ogden
from fem.material.base import shear_modulus
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box, tumour
from fem.solver import internal_force
from fem.solver.energy import EnergyLedger
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS, InternalForce
from fem.solver.rest import equilibrium

EDGE = 1e-3  # m
PAPER = ((0.12, 330.0), (0.8, 11.0))


class Plain(NeoHooke):
    """The neo-Hookean law without its fused kernel."""


class Hard(NeoHooke):
    """A hundred times the neo-Hookean law."""

    def energy(self, F):
        return 100 * super().energy(F)

    def stress(self, F, out=None):
        return np.multiply(100, super().stress(F), out=out)


NEO = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
PLAIN = Plain(mu=400.0, nu=0.42, density=1000.0)
MOONEY = MooneyRivlin(c10=150.0, c01=50.0, nu=0.42, density=1000.0)
OGDEN = Ogden(terms=((40.0, 8.0), (-60.0, -4.0)), nu=0.42, density=1000.0)
LAWS = {"plain": PLAIN, "mooney_rivlin": MOONEY, "ogden": OGDEN}
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
every_element = pytest.mark.parametrize("kind", ELEMENTS)
every_mesh = pytest.mark.parametrize("shape", ["congruent", "distorted"])


@pytest.fixture
def make(distort):
    """make(shape): a block of 3 x 3 x 3 cells."""

    def of(shape):
        mesh = box((3, 3, 3), EDGE)
        return distort(mesh) if shape == "distorted" else mesh

    return of


def wobble(mesh, amount=0.1, seed=3):
    """A random displacement (3, N)."""
    return amount * EDGE * np.random.default_rng(seed).uniform(-1, 1, (3, mesh.n_nodes))


def difference(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


@every_mesh
@every_element
@pytest.mark.parametrize("prony", [(), PAPER], ids=["elastic", "viscoelastic"])
def test_general_kernel_agrees_with_the_fused_one(prony, kind, shape, make):
    """The neo-Hookean law through its own stress has the fused kernel's forces, energies and
    relaxation."""
    mesh = make(shape)
    laws = (dataclasses.replace(law, prony=prony) for law in (NEO, PLAIN))
    fused, plain = (InternalForce(mesh, law, kind) for law in laws)
    for n in range(4):
        u = wobble(mesh, 0.1, n)
        for force in (fused, plain):
            force.relax(3.0 * n, 0.5)
        assert difference(plain(u), fused(u)) < 1e-12
        assert plain.energies(u) == pytest.approx(fused.energies(u), rel=1e-11)
        assert plain.viscous_energy(u) == pytest.approx(fused.viscous_energy(u), rel=1e-11)
        assert np.allclose(plain.dilatation(u), fused.dilatation(u), rtol=1e-13)
        assert plain.min_J == pytest.approx(fused.min_J, rel=1e-13)
        assert plain.worst_cell == fused.worst_cell


@every_law
def test_small_strains_are_linear(law, make):
    """In float32 a strain of 1e-8 has 1e-4 times the force of one of 1e-4, to the second order."""
    force = InternalForce(make("distorted"), law, precision="float32")
    small, large = (force(wobble(force.mesh, size)) for size in (1e-8, 1e-4))
    assert difference(1e4 * small, large) < 1e-2


def felupe_stress(law):
    """P of the law in other formulae: S = 2 dW/dC by invariants, or P by stretches of an SVD."""

    def mooney_rivlin(F):
        C = F.swapaxes(-1, -2) @ F
        J, I1 = np.linalg.det(F)[..., None, None], np.trace(C, axis1=-2, axis2=-1)[..., None, None]
        S = 2 * (law.c10 + law.c01 * I1) * np.eye(3) - 2 * law.c01 * C
        S = S + (law.K * (J - 1) * J - 2 * law.c10 - 4 * law.c01) * np.linalg.inv(C)
        return F @ S

    def ogden(F):
        U, stretch, Vh = np.linalg.svd(F)
        J = np.prod(stretch, axis=-1, keepdims=True)
        slope = law.K * (J - 1) * J / stretch
        for m, a in law.terms:
            slope = slope + m * (stretch ** (a - 1) - 1 / stretch)
        return (U * slope[..., None, :]) @ Vh

    formula = ogden if law is OGDEN else mooney_rivlin
    return lambda F: np.moveaxis(formula(np.moveaxis(F, (0, 1), (-2, -1))), (-2, -1), (0, 1))


@every_mesh
@pytest.mark.parametrize("law", [MOONEY, OGDEN], ids=["mooney_rivlin", "ogden"])
def test_internal_force_of_another_code(law, shape, distort):
    """felupe assembles the same force vector on the tumour, from the law written another way."""
    mesh = tumour(EDGE) if shape == "congruent" else distort(tumour(EDGE))
    u, stress = wobble(mesh), felupe_stress(law)
    region = felupe.RegionHexahedron(felupe.Mesh(mesh.points, mesh.cells, "hexahedron"))
    material = felupe.Material(lambda x, **kwargs: [stress(x[0]), x[-1]], lambda x, **kwargs: [])
    field = felupe.FieldContainer([felupe.Field(region, dim=3, values=u.T.copy())])
    expected = felupe.SolidBody(material, field).assemble.vector().toarray().reshape(-1, 3).T
    assert difference(InternalForce(mesh, law)(u), expected) < 1e-12


@every_element
@every_law
@pytest.mark.parametrize("stretches", [(1.05, 1.05, 0.7), (1.2, 1, 1), (1.3, 1.3, 1.3)])
def test_stiffening_follows_the_stable_step(law, kind, stretches):
    """At rest it is 1, and where the largest frequency grows in a strained block it grows too: the
    step falls no faster than with its power of 3/4."""
    mesh = box((3, 3, 3), EDGE, "none")
    solver, force = Solver(mesh, law, kind), InternalForce(mesh, law, kind)
    force(solver.u, check=True)
    assert force.stiffening == pytest.approx(1, rel=1e-12)
    rest = solver.critical_step
    solver.u[:] = (np.diag(stretches) - np.eye(3)) @ mesh.points.T
    solver.estimate_step()
    force(solver.u, check=True)
    assert solver.critical_step > 0.98 * rest * max(1, force.stiffening) ** -0.75


@every_element
@pytest.mark.parametrize("law", [NEO, OGDEN], ids=["fused", "ogden"])
def test_history_is_saved_and_restored(law, kind, make, monkeypatch):
    """From a `state` another kernel goes on bit for bit; elastic tissue has none."""
    monkeypatch.setattr(internal_force, "CHUNK", 10)
    mesh, viscous = make("distorted"), dataclasses.replace(law, prony=PAPER)
    first, second = InternalForce(mesh, viscous, kind), InternalForce(mesh, viscous, kind)
    for n in range(3):
        first.relax(2.0)
        first(wobble(mesh, 0.1, n))
    state = first.state()
    second.restore(state)
    for n in range(3, 6):
        u = wobble(mesh, 0.1, n)
        for force in (first, second):
            force.relax(2.0)
        assert np.array_equal(first(u), second(u))
        assert first.viscous_energy(u) == second.viscous_energy(u)
    first.restore(state)  # what ran on has not touched it
    assert all(np.array_equal(first.state()[name], state[name]) for name in state)
    assert InternalForce(mesh, law, kind).state() == {}


@every_element
def test_forgetting_is_rest(kind, make):
    """After `forget` the tissue answers as one that was never strained, hourglass control too."""
    mesh, viscous = make("distorted"), dataclasses.replace(NEO, prony=PAPER)
    used, new = InternalForce(mesh, viscous, kind), InternalForce(mesh, viscous, kind)
    used.relax(20.0)
    used(wobble(mesh))
    used.relax(20.0)
    used(wobble(mesh))
    used.forget()
    assert np.array_equal(used(wobble(mesh)), new(wobble(mesh)))


def beside(first, second):
    """One mesh of two that share no node."""
    points = np.vstack([first.points, second.points + [1.0, 0, 0]])
    cells = np.vstack([first.cells, second.cells + first.n_nodes])
    return HexMesh(points, cells, np.concatenate([first.fixed, second.fixed]))


def one_value_a_cell(law, other, n, m):
    """The law with the parameters of `law` in n cells, and of `other` in m more."""

    def joined(a, b):
        if isinstance(a, tuple):
            return tuple(map(joined, a, b))
        return a if a == b else np.repeat([a, b], [n, m])

    names = [field.name for field in dataclasses.fields(law)]
    return type(law)(**{name: joined(getattr(law, name), getattr(other, name)) for name in names})


@every_mesh
@every_element
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("law", [NEO, MOONEY, OGDEN], ids=["fused", "mooney_rivlin", "ogden"])
def test_one_value_a_cell(law, precision, kind, shape, make, monkeypatch):
    """Half a mesh of one tissue and half of another answers as two uniform meshes."""
    monkeypatch.setattr(internal_force, "CHUNK", 20)
    halves = make(shape), make(shape)
    laws = dataclasses.replace(law, prony=PAPER), None
    laws = laws[0], dataclasses.replace(laws[0].scaled(0.3), nu=0.3)
    mesh = beside(*halves)
    both = one_value_a_cell(*laws, *(half.n_cells for half in halves))
    force = InternalForce(mesh, both, kind, precision)
    parts = [InternalForce(*each, kind, precision) for each in zip(halves, laws, strict=True)]
    for n in range(3):
        u = [wobble(halves[0], 0.1, n), wobble(halves[1], 0.1, n + 10)]
        for each in (force, *parts):
            each.relax(4.0 * n, 0.1)
        whole = np.hstack(u)
        expected = np.hstack([part(v) for part, v in zip(parts, u, strict=True)])
        tolerance = 1e-12 if precision == "float64" else 1e-5
        assert difference(force(whole, check=True), expected) < tolerance
        energies = np.sum([p.energies(v) for p, v in zip(parts, u, strict=True)], axis=0)
        assert force.energies(whole) == pytest.approx(energies, rel=10 * tolerance)
        viscous = sum(p.viscous_energy(v) for p, v in zip(parts, u, strict=True))
        assert force.viscous_energy(whole) == pytest.approx(viscous, rel=10 * tolerance)


@pytest.mark.parametrize("law", [NEO, MOONEY], ids=["fused", "mooney_rivlin"])
def test_run_with_one_value_a_cell(law):
    """A run of two tissues side by side is two runs, with densities of their own."""
    block = box((2, 2, 2), EDGE)
    other = dataclasses.replace(law.scaled(0.3), density=500.0)
    both = one_value_a_cell(law, other, block.n_cells, block.n_cells)
    load = np.zeros((3, block.n_nodes))
    load[2, block.points[:, 2] == 2 * EDGE] = -1e-6
    results = []
    for mesh, material in ((beside(block, block), both), (block, law), (block, other)):
        solver = Solver(mesh, material)
        solver.advance(
            0.02, lambda t, n=mesh.n_nodes // block.n_nodes: np.hstack(n * [load]), steps=200
        )
        results.append(solver.u)
    assert difference(results[0], np.hstack(results[1:])) < 1e-12


def test_wrong_number_of_values_is_refused():
    """The error names the parameter and the number of cells."""
    with pytest.raises(InputError, match=r"material.mu has shape \(3,\); .* each of the 8 cells"):
        InternalForce(box((2, 2, 2), EDGE), NeoHooke([400.0] * 3, 0.42, 1000.0))


@every_element
@every_law
def test_energy_balances_in_a_run(law, kind):
    """A smooth push with Prony terms and damping leaves an imbalance below 1 %."""
    mesh = box((4, 4, 3), EDGE)
    viscous = dataclasses.replace(law, prony=((0.5, 0.05),))
    solver, ledger = Solver(mesh, viscous, kind, damping=30.0), EnergyLedger()
    load = np.zeros((3, mesh.n_nodes))
    load[2, mesh.points[:, 2] == mesh.points[:, 2].max()] = -3e-4
    free = np.where(mesh.fixed, 0, load)
    solver.advance(0.1, lambda t: np.sin(30 * t) ** 2 * free, [ledger])
    assert len(ledger.rows) >= 2 and np.abs(solver.u).max() > 0.1 * EDGE
    assert ledger.worst_imbalance() < 0.01


@pytest.mark.parametrize("kind", ["full", "reduced"])
def test_law_of_ones_own_is_used(kind, make):
    """A class that multiplies stress and energy by 100 answers 100 times stiffer, in the force and
    at rest."""
    mesh = make("distorted")
    hard, u = Hard(400.0, 0.42, 1000.0), wobble(mesh)
    force, soft = InternalForce(mesh, hard, kind), InternalForce(mesh, NEO, kind)
    assert difference(force(u), 100 * soft(u)) < 1e-8  # hourglass stiffness by differences
    assert force.energies(u) == pytest.approx(100 * np.array(soft.energies(u)), rel=1e-8)
    load = np.zeros(mesh.points.shape)
    load[~mesh.fixed] = [0, 0, -1e-7]
    viscous = Hard(400.0, 0.42, 1000.0, ((0.5, 1.0),))
    depth, expected = (
        np.linalg.norm(equilibrium(mesh, law, force, element=kind).displacement)
        for law, force in ((viscous, 100 * load), (NEO, 2 * load))
    )
    assert depth == pytest.approx(expected, rel=1e-4) and depth > 0


def test_law_of_ones_own_is_refused():
    """Where stress and energy do not fit together, or an element needs what the law lacks."""

    class Wrong(NeoHooke):
        def stress(self, F, out=None):
            return np.multiply(100, super().stress(F), out=out)

    mesh = box((2, 2, 2), EDGE)
    with pytest.raises(InputError, match="Wrong: stress is not the derivative of energy"):
        InternalForce(mesh, Wrong(400.0, 0.42, 1000.0))
    with pytest.raises(
        InputError, match="'mean_dilatation' needs the modulus K .* Hard names none"
    ):
        InternalForce(mesh, Hard(400.0, 0.42, 1000.0), "mean_dilatation")


def test_mean_dilatation_takes_a_law_that_names_its_modulus(make):
    """With K beside its energy, a law of one's own runs in every element."""

    class Named(Hard):
        @property
        def K(self):
            return 100 * super().K

        def energy(self, F):
            return 100 * NEO.energy(F)

        def stress(self, F):  # no `out`: it is an offer
            return 100 * NEO.stress(F)

    mesh, named = make("distorted"), Named(400.0, 0.42, 1000.0)
    u = wobble(mesh)
    expected = 100 * InternalForce(mesh, NEO, "mean_dilatation")(u)
    assert difference(InternalForce(mesh, named, "mean_dilatation")(u), expected) < 1e-12


def test_law_of_the_manual_works():
    """The class that docs/fem.md shows passes the checks and gives a force."""
    text = (Path(__file__).parents[3] / "docs" / "fem.md").read_text()
    names = {}
    exec(text.split("```python\n")[1].split("```")[0], names)
    mesh, law = box((2, 2, 2), EDGE), names["SaintVenant"](400.0, 2000.0, 1000.0)
    u = np.diag([0.1, -0.05, 0.2]) @ mesh.points.T
    force = InternalForce(mesh, law, "reduced")
    assert (force(u) * u).sum() > 0 and shear_modulus(law) == pytest.approx(400.0)
