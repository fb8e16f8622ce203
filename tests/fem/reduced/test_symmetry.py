"""The mirror plane is found where there is one, and fields fall into halves without loss."""

import dataclasses

import numpy as np
import pytest

import fem
from fem.reduced.points import positions
from fem.reduced.symmetry import mirror_of, point_pairs, sides


def test_the_papers_tumour_is_symmetric_in_x_alone(tissue):
    mesh = fem.tumour()
    axis, image = mirror_of(mesh, tissue)
    assert axis == 0
    assert np.array_equal(image[image], np.arange(mesh.n_nodes))


def test_what_breaks_the_symmetry_is_seen(block, tissue, distort):
    x = block.points[:, 0]
    assert mirror_of(block, tissue)[0] == 0
    assert mirror_of(distort(block), tissue) is None
    one_side = block.fixed | (x == x.min())
    assert mirror_of(dataclasses.replace(block, fixed=one_side), tissue)[0] == 1
    corner = one_side | (block.points[:, 1] == 0)
    assert mirror_of(dataclasses.replace(block, fixed=corner), tissue) is None
    stiff = np.where(np.arange(block.n_cells) == 0, 900.0, 400.0)
    assert mirror_of(block, fem.NeoHooke(stiff, 0.42, 1000.0)) is None


@pytest.mark.parametrize("mirrored", [True, False])
def test_halves_hold_the_whole_field(block, tissue, mirrored):
    nodes = np.flatnonzero(~block.fixed)
    halves = sides(nodes, mirror_of(block, tissue) if mirrored else None)
    field = np.where(block.fixed[:, None], 0, np.random.default_rng(0).normal(size=(60, 3)))
    parts = halves.fold(field)
    assert sum(np.sum(part**2) for part in parts) == pytest.approx(np.sum(field**2))
    again = sum(halves.field(part, b, 60) for b, part in enumerate(parts))
    assert np.allclose(again, field)


def test_a_folded_force_does_the_work_of_the_whole(block, tissue):
    halves = sides(np.flatnonzero(~block.fixed), mirror_of(block, tissue))
    rng = np.random.default_rng(1)
    force = np.where(block.fixed[:, None], 0, rng.normal(size=(60, 3)))
    for parity, folded in enumerate(halves.fold_force(force)):
        shape = halves.fold(rng.normal(size=(60, 3)))[parity]
        mode = halves.field(shape, parity, 60)
        assert folded @ halves.test_values(mode) == pytest.approx(np.sum(force * mode))


def test_points_come_in_pairs(block):
    points = positions(block)
    pairs = point_pairs(points, 0, 1e-3)
    assert len(pairs.left) == len(points) / 2
    assert np.allclose(points[pairs.left] * [-1, 1, 1] + [4e-3, 0, 0], points[pairs.right])
