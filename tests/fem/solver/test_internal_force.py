"""The internal force: patch tests, objectivity, balance, energy, and another code's answer."""

import dataclasses

import felupe
import numpy as np
import pytest

from fem.errors import InputError
from fem.material.base import wave_modulus
from fem.material.mooney_rivlin import MooneyRivlin
from fem.material.neo_hooke import NeoHooke
from fem.material.ogden import Ogden
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box, tumour
from fem.solver import internal_force
from fem.solver.internal_force import ELEMENTS, InternalForce

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
EDGE = 1e-3  # m
F = np.eye(3) + np.array([[0.2, -0.1, 0.15], [0.3, -0.15, 0.05], [-0.1, 0.2, 0.1]])
LAWS = {
    "neo_hooke": TISSUE,
    "mooney_rivlin": MooneyRivlin(c10=150.0, c01=50.0, nu=0.42, density=1000.0),
    "ogden": Ogden(terms=((40.0, 8.0), (-60.0, -4.0)), nu=0.42, density=1000.0),
}
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
every_element = pytest.mark.parametrize("kind", ELEMENTS)
every_mesh = pytest.mark.parametrize("shape", ["congruent", "sheared", "distorted"])


@pytest.fixture
def make(distort):
    """make(shape): a block of 4 x 3 x 3 cells."""

    def of(shape):
        mesh = box((4, 3, 3), EDGE)
        if shape == "sheared":
            return dataclasses.replace(
                mesh, points=mesh.points @ np.array([[1, 0.2, 0], [0, 0.8, 0.1], [0.3, 0, 1]])
            )
        return distort(mesh) if shape == "distorted" else mesh

    return of


def wobble(mesh, amount=0.1, seed=3):
    """A random displacement (3, N)."""
    return amount * EDGE * np.random.default_rng(seed).uniform(-1, 1, (3, mesh.n_nodes))


def rotation(seed=0):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def difference(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def traction_forces(mesh, P):
    """Consistent nodal forces (3, N) of the traction P n on the whole boundary, face by face."""
    shape, gradient = element.quad_shape(
        np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3)
    )
    faces = mesh.boundary_faces
    s, t = np.moveaxis(np.einsum("qra,mai->mqri", gradient, mesh.points[faces]), 2, 0)
    share = np.einsum("qa,mqj,ij->mai", shape, np.cross(s, t), P)
    forces = np.zeros((mesh.n_nodes, 3))
    np.add.at(forces, faces, share)
    return forces.T


@every_mesh
@every_element
@every_law
def test_patch(law, kind, shape, make):
    """A linear displacement gives zero force inside and the traction of NeoHooke.stress on the
    boundary, in any mesh."""
    mesh = make(shape)
    u = (F - np.eye(3)) @ mesh.points.T
    force = InternalForce(mesh, law, kind)(u)
    expected = traction_forces(mesh, law.stress(F))
    assert np.abs(force - expected).max() < 1e-12 * np.abs(expected).max()
    inside = np.setdiff1d(np.arange(mesh.n_nodes), mesh.boundary_faces)
    assert len(inside) and np.abs(force[:, inside]).max() < 1e-12 * np.abs(expected).max()


@every_mesh
@every_element
@every_law
def test_rigid_motion_is_stress_free(law, kind, shape, make):
    """Any rotation and translation of the rest shape gives no force."""
    mesh = make(shape)
    force = InternalForce(mesh, law, kind, hourglass_stiffness=0.2)
    for seed in range(4):
        u = (rotation(seed) - np.eye(3)) @ mesh.points.T + EDGE
        assert np.abs(force(u)).max() < 1e-11 * wave_modulus(law) * EDGE**2


@every_mesh
@every_element
@every_law
def test_force_turns_with_the_tissue(law, kind, shape, make):
    """f(R (X + u) - X) = R f(u): hourglass control is as objective as the stress."""
    mesh, R = make(shape), rotation()
    force, u = InternalForce(mesh, law, kind, hourglass_stiffness=0.2), wobble(mesh)
    turned = R @ (mesh.points.T + u) - mesh.points.T
    assert difference(force(turned), R @ force(u)) < 1e-12


@every_mesh
@every_element
@every_law
def test_internal_forces_balance(law, kind, shape, make):
    """Internal forces add up to no force and no moment, for any displacement."""
    mesh = make(shape)
    u = wobble(mesh)
    force = InternalForce(mesh, law, kind)(u)
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=1)).max() < 1e-13 * size
    moment = np.cross((mesh.points.T + u).T, force.T).sum(axis=0)
    assert np.abs(moment).max() < 1e-13 * size * np.ptp(mesh.points)


@every_mesh
@every_element
@every_law
def test_force_is_the_gradient_of_the_energy(law, kind, shape, make):
    """f . w is the derivative of strain plus hourglass energy along w."""
    mesh = make(shape)
    force, u, w = (
        InternalForce(mesh, law, kind, hourglass_stiffness=0.2),
        wobble(mesh),
        wobble(mesh, 1.0, 4),
    )
    step = 1e-5
    slope = (sum(force.energies(u + step * w)) - sum(force.energies(u - step * w))) / (2 * step)
    assert np.vdot(force(u), w) == pytest.approx(slope, rel=1e-7)


@every_mesh
@every_element
@every_law
def test_float32_is_close_to_float64(law, kind, shape, make):
    """Single precision inside cells changes the force by less than 1e-5 of its size."""
    mesh = make(shape)
    u = wobble(mesh)
    single, double = (
        InternalForce(mesh, law, kind, precision)(u) for precision in ("float32", "float64")
    )
    assert single.dtype == np.float64
    assert difference(single, double) < 1e-5


@every_element
def test_shared_and_cellwise_gradients_agree(kind):
    """The matrix that congruent cells share gives what one matrix for each cell gives."""
    mesh, general = tumour(), tumour()
    object.__setattr__(general, "congruent", False)
    u = wobble(mesh, 0.05)
    shared, own = InternalForce(mesh, TISSUE, kind), InternalForce(general, TISSUE, kind)
    assert difference(shared(u), own(u)) < 1e-12
    assert shared.energies(u) == pytest.approx(own.energies(u), rel=1e-11)


@every_element
def test_chunks_do_not_show(kind, make, monkeypatch):
    """Passing over the cells in chunks of 5 changes neither forces nor energies nor the smallest
    J."""
    mesh = make("distorted")
    u, whole = wobble(mesh), InternalForce(mesh, TISSUE, kind)
    monkeypatch.setattr(internal_force, "CHUNK", 5)
    pieces = InternalForce(mesh, TISSUE, kind)
    assert difference(pieces(u, check=True), whole(u, check=True)) < 1e-13
    assert (pieces.min_J, pieces.worst_cell) == (
        pytest.approx(whole.min_J, rel=1e-13),
        whole.worst_cell,
    )
    assert pieces.energies(u) == pytest.approx(whole.energies(u), rel=1e-12)


def test_dilatation_is_the_ratio_of_volumes(make):
    """J of a cell is its deformed over its rest volume, and `check` finds the cell with the
    smallest J."""
    mesh = make("distorted")
    u = wobble(mesh, 0.05)
    force = InternalForce(mesh, TISSUE)
    ratio = [
        HexMesh(mesh.points + u.T, cell[None], mesh.fixed).volume()
        / HexMesh(mesh.points, cell[None], mesh.fixed).volume()
        for cell in mesh.cells
    ]
    assert np.allclose(force.dilatation(u), ratio, rtol=1e-12)
    u = np.zeros_like(u)
    u[:, mesh.cells[17]] = (
        -0.3 * (mesh.points[mesh.cells[17]] - mesh.points[mesh.cells[17]].mean(axis=0)).T
    )
    force(u, check=True)
    assert force.worst_cell == 17 and force.min_J == pytest.approx(0.7**3, rel=1e-9)


def test_static_equilibrium_of_another_code(reference):
    """felupe's converged displacement under two nodal forces leaves no residual here, at four
    loads, and has our energy."""
    ref = reference("ref1_block_two_nodal_forces_hex8")
    force = InternalForce(HexMesh(ref["points"], ref["cells"], ref["fixed"]), TISSUE)
    free = ~ref["fixed"]
    for level, u, energy in zip(ref["levels"], ref["u"], ref["energy"], strict=True):
        load = level * ref["loads"]
        residual = (force(u.T).T - load)[free]
        assert np.linalg.norm(residual) < 1e-9 * np.linalg.norm(load)
        assert force.energies(u.T)[0] == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("shape", ["congruent", "distorted"])
def test_internal_force_of_another_code(shape, distort):
    """felupe, with its own elements and constitutive law, assembles the same force vector on the
    tumour."""
    mesh = tumour(EDGE) if shape == "congruent" else distort(tumour(EDGE))
    u = wobble(mesh)
    region = felupe.RegionHexahedron(felupe.Mesh(mesh.points, mesh.cells, "hexahedron"))
    law = felupe.NeoHookeCompressible(mu=TISSUE.mu) & felupe.Volumetric(bulk=TISSUE.K)
    body = felupe.SolidBody(
        law, felupe.FieldContainer([felupe.Field(region, dim=3, values=u.T.copy())])
    )
    expected = body.assemble.vector().toarray().reshape(-1, 3).T
    assert difference(InternalForce(mesh, TISSUE)(u), expected) < 1e-12


def test_one_pressure_a_cell_does_not_lock():
    """Near nu = 0.5 the bending of one mean-dilatation cell costs shear energy alone; a full cell
    pays K for it."""
    mesh = box((1, 1, 1), EDGE)
    x, y, z = (mesh.points - EDGE / 2).T
    bend = 0.02 / EDGE * np.stack([x * z, 0 * y, 0 * z])
    stiff = dataclasses.replace(TISSUE, nu=0.4999)
    full, mean = (
        InternalForce(mesh, stiff, kind).energies(bend)[0] for kind in ("full", "mean_dilatation")
    )
    assert full > 100 * mean
    assert mean == pytest.approx(
        InternalForce(mesh, TISSUE, "mean_dilatation").energies(bend)[0], rel=1e-3
    )


def test_hourglass_stiffness_holds_the_zero_energy_modes():
    """An hourglass pattern costs the reduced element nothing without control, and energy with
    it."""
    mesh = box((1, 1, 1), EDGE)
    u = (
        0.05
        * EDGE
        * np.stack([element.HOURGLASS[0], 0 * element.HOURGLASS[0], 0 * element.HOURGLASS[0]])[
            :, np.argsort(mesh.cells[0])
        ]
    )
    without, with_control = (
        InternalForce(mesh, TISSUE, "reduced", hourglass_stiffness=k) for k in (0.0, 0.05)
    )
    assert np.abs(without(u)).max() < 1e-15 * TISSUE.mu * EDGE
    assert without.energies(u) == (pytest.approx(0, abs=1e-25), 0)
    strain, hourglass = with_control.energies(u)
    assert hourglass > 0 and abs(strain) < 1e-9 * hourglass


def test_unknown_elements_and_precisions_are_refused():
    """A misspelt element or precision is an InputError that lists the right ones."""
    with pytest.raises(InputError, match="mean_dilatation"):
        InternalForce(box((1, 1, 1), EDGE), TISSUE, "hex20")
    with pytest.raises(InputError, match="float32"):
        InternalForce(box((1, 1, 1), EDGE), TISSUE, precision="float16")
