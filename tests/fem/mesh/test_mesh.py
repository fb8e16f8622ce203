"""Meshes: the counts and volume of the paper, orientation, and the node grid."""

import dataclasses
import re

import numpy as np
import pytest

from fem.errors import InputError
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box, tumour

EDGE = 1e-3  # m


def surface_volume(mesh):
    """Volume by the divergence theorem, from the boundary faces alone: int x . n dA / 3."""
    shape, gradient = element.quad_shape(
        np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3)
    )
    corners = mesh.points[mesh.boundary_faces]  # (M, 4, 3)
    x = np.einsum("qa,mai->mqi", shape, corners)
    s, t = np.moveaxis(np.einsum("qra,mai->mqri", gradient, corners), 2, 0)
    return np.einsum("mqi,mqi->", x, np.cross(s, t)) / 3


def test_tumour_has_the_counts_and_volume_of_the_paper():
    """The tumour has 1782 nodes, 1314 hexahedra and 173.0 mm3 on a 17 x 17 x 8 node grid."""
    mesh = tumour()
    assert (mesh.n_nodes, mesh.n_cells, mesh.grid_shape) == (1782, 1314, (17, 17, 8))
    assert mesh.volume() * 1e9 == pytest.approx(173.0, abs=0.05)
    assert 0.07 * mesh.volume() * 1e9 == pytest.approx(12.1, abs=0.05)
    assert mesh.congruent


def test_tumour_is_held_at_bottom_and_periphery_and_free_on_top():
    """Every boundary face off the top plane is held, every node of the top away from the rim is
    free."""
    mesh = tumour()
    faces = mesh.boundary_faces
    top = (mesh.points[faces, 2] == mesh.points[:, 2].max()).all(axis=1)
    assert mesh.fixed[faces[~top]].all()
    rim = np.intersect1d(faces[top], faces[~top])
    assert not mesh.fixed[np.setdiff1d(faces[top], rim)].any()
    assert not mesh.fixed[np.setdiff1d(np.arange(mesh.n_nodes), faces)].any()
    assert len(mesh.free_faces) <= top.sum()
    assert (mesh.points[mesh.free_faces, 2] == mesh.points[:, 2].max()).all()


@pytest.mark.parametrize("cells", [(1, 1, 1), (4, 3, 2)])
def test_box_counts_and_volume(cells):
    """A box of n x m x l cubes has (n+1)(m+1)(l+1) nodes, n m l cells and their volume."""
    mesh = box(cells, EDGE)
    assert (mesh.n_nodes, mesh.n_cells) == (np.prod(np.add(cells, 1)), np.prod(cells))
    assert mesh.volume() == pytest.approx(np.prod(cells) * EDGE**3, rel=1e-12)


def test_box_holds_what_it_is_told_to():
    """'bottom' holds the nodes of z = 0, 'all but top' the sides too, 'none' nothing."""
    x, y, z = box((4, 3, 2), 1.0).points.T
    side = (x == 0) | (x == 4) | (y == 0) | (y == 3) | (z == 0)
    assert np.array_equal(box((4, 3, 2), 1.0, "all but top").fixed, side)
    assert np.array_equal(box((4, 3, 2), 1.0, "bottom").fixed, z == 0)
    assert not box((4, 3, 2), 1.0, "none").fixed.any()


@pytest.mark.parametrize("make", [tumour, lambda: box((4, 3, 2), EDGE)])
def test_grid_round_trip(make):
    """to_grid then from_grid gives the nodal field back, and the grid is zero where there is no
    material."""
    mesh = make()
    values = np.random.default_rng(0).normal(size=(2, mesh.n_nodes, 3))
    grid = mesh.to_grid(values)
    assert grid.shape == (2, *mesh.grid_shape, 3)
    assert np.array_equal(mesh.from_grid(grid), values)
    assert np.count_nonzero(grid) == values.size


def test_grid_places_nodes_by_position():
    """Grid entry [i, j, k] belongs to the node at (i, j, k) edges, z up: pooling anchored on top
    stays on top."""
    mesh = tumour(edge=1.0)
    i, j, k = np.round(np.moveaxis(mesh.to_grid(mesh.points), -1, 0)).astype(int)
    mask = mesh.to_grid(np.ones((mesh.n_nodes, 1)))[..., 0] > 0
    assert np.array_equal(np.argwhere(mask), np.stack([i[mask], j[mask], k[mask]], axis=1))


def test_a_grid_of_another_shape_is_refused():
    """A field on a grid that is not the mesh's, or for a mesh without grid, is an InputError."""
    mesh = box((4, 3, 2), EDGE)
    with pytest.raises(InputError, match="does not fit"):
        mesh.from_grid(np.zeros((17, 17, 8, 3)))
    with pytest.raises(InputError, match="no regular node grid"):
        dataclasses.replace(mesh, grid_shape=None).to_grid(np.zeros((mesh.n_nodes, 3)))


@pytest.mark.parametrize("make", [tumour, lambda: box((4, 3, 2), EDGE)])
def test_boundary_faces_point_outwards(make, distort):
    """The divergence theorem over the boundary faces gives the Gauss volume, also of a distorted
    mesh."""
    for mesh in (make(), distort(make())):
        assert surface_volume(mesh) == pytest.approx(mesh.volume(), rel=1e-12)


def test_volume_of_a_deformed_mesh_scales_with_the_determinant():
    """A linear map F multiplies the volume by det F."""
    mesh = box((4, 3, 2), EDGE)
    F = np.eye(3) + np.random.default_rng(0).normal(scale=0.1, size=(3, 3))
    assert mesh.volume(mesh.points @ (F - np.eye(3)).T) == pytest.approx(
        np.linalg.det(F) * mesh.volume(), rel=1e-12
    )


def test_congruence_is_seen(distort):
    """Cubes and sheared cubes are congruent; one node moved by a thousandth of an edge ends it."""
    mesh = box((3, 3, 3), EDGE)
    sheared = dataclasses.replace(
        mesh, points=mesh.points @ np.array([[1, 0.2, 0], [0, 1, 0.1], [0.3, 0, 1]])
    )
    assert mesh.congruent and sheared.congruent
    assert not distort(mesh, amount=1e-3).congruent


def swap_layers(mesh, bad):
    cells = mesh.cells.copy()
    cells[bad] = cells[bad][[4, 5, 6, 7, 0, 1, 2, 3]]
    return mesh.points, cells


def collapse(mesh, bad):
    points = mesh.points.copy()
    points[mesh.cells[bad][6]] = points[mesh.cells[bad][0]]
    return points, mesh.cells


def repeat_node(mesh, bad):
    cells = mesh.cells.copy()
    cells[bad][1] = cells[bad][0]
    return mesh.points, cells


@pytest.mark.parametrize("spoil", [swap_layers, collapse, repeat_node])
def test_a_bad_cell_is_named(spoil):
    """An inverted, collapsed or degenerate cell is an InputError that names the cell."""
    mesh, bad = box((3, 2, 2), EDGE), 11
    points, cells = spoil(mesh, bad)
    with pytest.raises(InputError, match=re.escape(f"cell {bad} (nodes {cells[bad].tolist()})")):
        HexMesh(points, cells, mesh.fixed)


def test_impossible_boxes_are_refused():
    """An empty box, an unknown support and a node at no place are InputErrors."""
    with pytest.raises(InputError, match="positive"):
        box((0, 2, 2), EDGE)
    with pytest.raises(InputError, match="all but top"):
        box((2, 2, 2), EDGE, "sides")
    mesh = box((2, 2, 2), EDGE)
    points = mesh.points.copy()
    points[5, 1] = np.nan
    with pytest.raises(InputError, match="node 5"):
        HexMesh(points, mesh.cells, mesh.fixed)
