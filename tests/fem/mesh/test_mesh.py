"""Meshes: the counts and volume of the paper, orientation, what is refused, sets, refinement, and
the node grid."""

import dataclasses
import doctest
import pickle
import re

import numpy as np
import pytest

from fem.errors import InputError
from fem.mesh import element, hexmesh
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import box, from_voxels, refined, tumour
from fem.online.grid import NodeGrid

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
    assert (mesh.n_nodes, mesh.n_cells, mesh.grid.shape) == (1782, 1314, (17, 17, 8))
    assert mesh.volume() * 1e9 == pytest.approx(173.0, abs=0.05)
    assert 0.07 * mesh.volume() * 1e9 == pytest.approx(12.1, abs=0.05)
    assert mesh.congruent


def test_tumour_is_a_bump_on_five_full_layers_held_at_bottom_and_walls():
    """609 nodes are held: the bottom and the walls up to the top of the fifth layer; the bump's 34
    cells stand alone on it."""
    mesh = tumour(edge=1.0)
    i, j, k = np.rint(mesh.points).astype(int).T
    walls = (k <= 5) & ((i == 0) | (i == 16) | (j == 0) | (j == 16))
    assert mesh.fixed.sum() == 609 and np.array_equal(mesh.fixed, walls | (k == 0))
    assert np.array_equal(mesh.node_sets["walls"], walls)
    assert np.array_equal(mesh.node_sets["bottom"], k == 0)
    assert np.array_equal(mesh.node_sets["top"], k == 6)
    layers = np.bincount(np.rint(mesh.points[mesh.cells[:, 0], 2]).astype(int))
    assert layers.tolist() == [256] * 5 + [34]


def test_tumour_has_its_two_groups_of_cells():
    """1166 cells of tissue come first, then 148 of the tumour: 30, 42, 42 and 34 by layer, x
    fastest in both; in the bump only the tumour exists."""
    mesh = tumour(edge=1.0)
    lump, corner = mesh.cell_sets["tumour"], np.rint(mesh.points[mesh.cells[:, 0]]).astype(int)
    assert np.array_equal(mesh.cell_sets["tissue"], ~lump)
    assert np.array_equal(lump, np.arange(1314) >= 1166)
    assert np.bincount(corner[lump, 2]).tolist() == [0, 0, 30, 42, 42, 34]
    assert lump[corner[:, 2] == 5].all()
    for group in (~lump, lump):
        assert (np.diff(corner[group] @ [1, 16, 256]) > 0).all()


def test_tumour_is_symmetric_in_x_and_not_in_y():
    """Mirrored in x, cells, groups and held nodes are the same, exactly; mirrored in y they are
    not."""
    mesh = tumour(edge=1.0)

    def content(flip):
        points = np.rint(mesh.points).astype(int)
        points = np.where(flip, 16 - points, points)
        cells = {tuple(sorted(map(tuple, points[cell]))) for cell in mesh.cells}
        lump = {tuple(sorted(map(tuple, points[c]))) for c in mesh.cells[mesh.cell_sets["tumour"]]}
        return cells, lump, set(map(tuple, points[mesh.fixed]))

    here, in_x, in_y = (content(flip) for flip in ([0, 0, 0], [1, 0, 0], [0, 1, 0]))
    assert here == in_x and here[2] == in_y[2]
    assert here[0] != in_y[0] and here[1] != in_y[1]


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
    grid = mesh.grid.to_grid(values)
    assert grid.shape == (2, *mesh.grid.shape, 3)
    assert np.array_equal(mesh.grid.from_grid(grid), values)
    assert np.count_nonzero(grid) == values.size


def test_grid_places_nodes_by_position():
    """Grid entry [i, j, k] belongs to the node at (i, j, k) edges, z up; the tumour's seven layers
    leave the grid's last one void."""
    for mesh in (tumour(edge=1.0), box((4, 3, 2), 1.0)):
        i, j, k = np.round(np.moveaxis(mesh.grid.to_grid(mesh.points), -1, 0)).astype(int)
        mask = mesh.grid.mask
        places = np.stack([i[mask], j[mask], k[mask]], axis=1)
        assert np.array_equal(np.argwhere(mask), places)
        assert mask[..., -1].any() == (mesh.n_nodes != 1782)


def test_a_grid_of_another_shape_is_refused():
    """A field on a grid that is not the mesh's is an InputError."""
    mesh = box((4, 3, 2), EDGE)
    with pytest.raises(InputError, match="does not fit"):
        mesh.grid.from_grid(np.zeros((17, 17, 8, 3)))


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
    with pytest.raises(InputError, match="must be from 1"):
        box((0, 2, 2), EDGE)
    with pytest.raises(InputError, match="'sides' is neither .* bottom, top"):
        box((2, 2, 2), EDGE, "sides")
    mesh = box((2, 2, 2), EDGE)
    points = mesh.points.copy()
    points[5, 1] = np.nan
    with pytest.raises(InputError, match="node 5"):
        HexMesh(points, mesh.cells, mesh.fixed)


def with_cell(mesh, e, nodes):
    cells = mesh.cells.copy()
    cells[e] = nodes
    return cells


@pytest.mark.parametrize(
    "change, named",
    [
        (lambda m: {"fixed": m.fixed[:-1]}, r"fixed is bool of shape \(59,\); give .* \(60,\)"),
        (lambda m: {"fixed": m.fixed.astype(int)}, "fixed is int64"),
        (lambda m: {"loaded": m.fixed[None]}, r"loaded is bool of shape \(1, 60\)"),
        (lambda m: {"points": m.points[:, :2]}, r"points is float64 of shape \(60, 2\)"),
        (lambda m: {"points": m.points.astype(str)}, "points is <U"),
        (lambda m: {"cells": m.cells.astype(float)}, "cells is float64 of shape"),
        (lambda m: {"cells": m.cells[:, :4]}, r"cells is int64 of shape \(24, 4\)"),
        (lambda m: {"cells": m.cells[:0]}, "no cells"),
        (lambda m: {"cells": with_cell(m, 3, -1)}, r"cell 3 \(nodes \[-1, .* 0 to 59"),
        (lambda m: {"cells": with_cell(m, 3, 60)}, r"cell 3 \(nodes \[60, .* 0 to 59"),
        (lambda m: {"cells": with_cell(m, 5, m.cells[2])}, "cell 5 .* is cell 2 once more"),
        (lambda m: {"grid": NodeGrid((60, 1, 1), np.arange(59))}, "places for 59 nodes"),
        (lambda m: {"node_sets": {"tip": m.fixed[1:]}}, r"node_sets\['tip'\] is bool of"),
        (lambda m: {"cell_sets": {"core": m.fixed}}, r"cell_sets\['core'\] is bool of"),
    ],
)
def test_arrays_that_are_no_mesh_are_named(change, named):
    """Wrong lengths, shapes and types, negative and too large node numbers and a cell given twice
    are InputErrors that name the value."""
    mesh = box((4, 3, 2), EDGE)
    with pytest.raises(InputError, match=named):
        dataclasses.replace(mesh, **change(mesh))


@pytest.mark.parametrize(
    "shape, index, named",
    [
        ((2, 2), [0, 1], "shape"),
        ((2, 2, 0), [0], "positive"),
        ((2, 2, 2), [0, 8], "holds 8"),
        ((2, 2, 2), [0, -1], "holds -1"),
        ((2, 2, 2), [0, 3, 3], "holds 3 twice"),
        ((2, 2, 2), [0.0, 1.0], "float64"),
    ],
)
def test_impossible_node_grids_are_refused(shape, index, named):
    with pytest.raises(InputError, match=named):
        NodeGrid(shape, np.array(index))


def test_meshes_are_equal_by_content_and_usable_as_keys():
    """Equal content is one mesh, here and in another process; any change makes another."""
    mesh = box((4, 3, 2), EDGE)
    again, moved = box((4, 3, 2), EDGE), dataclasses.replace(mesh, points=mesh.points * 1.001)
    assert mesh == again and hash(mesh) == hash(again) and mesh.digest == again.digest
    assert pickle.loads(pickle.dumps(mesh)) == mesh and mesh != "box"
    others = {
        moved,
        mesh.with_sets(fixed="z min"),
        mesh.with_sets(loaded="top"),
        mesh.with_sets(tip="x max"),
        dataclasses.replace(mesh, grid=None),
    }
    assert mesh not in others and len(others) == 5


def test_a_mesh_never_changes():
    """Its arrays are read-only, and what it was made from may go on changing."""
    mesh = box((2, 2, 2), EDGE)
    points, fixed = mesh.points.copy(), mesh.fixed.copy()
    copy = HexMesh(points, mesh.cells, fixed)
    points[:], fixed[:] = 0.0, False
    assert np.array_equal(copy.points, mesh.points) and np.array_equal(copy.fixed, mesh.fixed)
    for values in (mesh.points, mesh.cells, mesh.fixed, mesh.grid.index, mesh.node_sets["top"]):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0


def test_sets_are_selected_by_text_or_given_as_arrays():
    """with_sets takes selections and arrays of nodes or cells, returns a new mesh, and its names
    serve in further selections."""
    mesh = box((4, 3, 2), EDGE, "none")
    core = np.arange(mesh.n_cells) < 5
    held = mesh.with_sets(fixed="bottom", tip="x max", core=core).with_sets(loaded="tip, top")
    assert not mesh.fixed.any() and mesh.loaded is None and "tip" not in mesh.node_sets
    assert np.array_equal(held.fixed, mesh.points[:, 2] == 0)
    assert np.array_equal(held.node_sets["tip"], mesh.points[:, 0] == mesh.points[:, 0].max())
    assert np.array_equal(held.loaded, held.node_sets["tip"] | held.node_sets["top"])
    assert np.array_equal(held.cell_sets["core"], core)
    with pytest.raises(InputError, match="mesh.loaded: 'tpi' is neither .*bottom, tip, top"):
        held.with_sets(loaded="tpi")


def test_the_example_in_the_docstring_holds():
    assert doctest.testmod(hexmesh) == (0, 3)


def test_refined_cubes_are_the_cubes_of_half_the_edge():
    """Every cube of the tumour in eight gives what twice as fine voxels give, supports included."""
    mesh = tumour()
    fine = refined(mesh)
    places = np.unravel_index(mesh.grid.index[mesh.cells[:, 0]], mesh.grid.shape)
    keep = np.zeros(np.array(mesh.grid.shape) - 1, bool)
    keep[places] = True
    edge = np.ptp(mesh.points[mesh.cells[0], 0])
    voxels = from_voxels(keep.repeat(2, 0).repeat(2, 1).repeat(2, 2), edge / 2, "none")
    order = np.argsort(fine.grid.index)
    assert np.array_equal(fine.grid.index[order], voxels.grid.index) and fine.congruent
    assert np.allclose(fine.points[order], voxels.points, rtol=0, atol=1e-15)
    i, j, k = np.rint(fine.points / edge * 2).astype(int).T
    walls = (k <= 10) & ((i == 0) | (i == 32) | (j == 0) | (j == 32))
    assert np.array_equal(fine.fixed, walls | (k == 0))
    assert fine.cell_sets["tumour"].sum() == 8 * 148
    assert fine.n_cells == 8 * mesh.n_cells and len(fine.free_faces) == 4 * len(mesh.free_faces)
    old = fine.grid.to_grid(fine.points)[::2, ::2, ::2]
    assert np.allclose(old, mesh.grid.to_grid(mesh.points), rtol=0, atol=1e-15)


def test_refining_a_distorted_mesh_keeps_volume_surface_and_sets(distort):
    """Trilinear cells are cut exactly: volume, loaded area and the sets of cells stay."""
    mesh = dataclasses.replace(distort(box((4, 3, 2), EDGE)), grid=None)
    mesh = mesh.with_sets(loaded="top", core=np.arange(24) % 3 == 0)
    fine = refined(mesh)
    assert fine.grid is None and fine.volume() == pytest.approx(mesh.volume(), rel=1e-12)
    assert surface_volume(fine) == pytest.approx(mesh.volume(), rel=1e-12)
    assert len(fine.free_faces) == 4 * len(mesh.free_faces)
    assert fine.cell_sets["core"].sum() == 8 * 8
    core, fine_core = (
        element.gauss_volumes(m.points, m.cells)[m.cell_sets["core"]].sum() for m in (mesh, fine)
    )
    assert fine_core == pytest.approx(core, rel=1e-12)
