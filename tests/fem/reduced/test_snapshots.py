"""One pass over the interactions gives the proper orthogonal modes of all of them and of their
mirror images."""

from types import SimpleNamespace

import numpy as np
import pytest

from fem.errors import InputError
from fem.reduced.reduction import Body
from fem.reduced.snapshots import GrowingBasis, open_snapshots, read_snapshots


def interactions(body, count, rank=12):
    """A dataset of random fields of few shapes of falling size."""
    rng = np.random.default_rng(0)
    n = body.mesh.n_nodes
    shapes = rng.normal(size=(rank, n, 3)) * 2.0 ** -np.arange(rank)[:, None, None]
    shapes[:, body.mesh.fixed] = 0
    fields = np.tensordot(rng.normal(size=(count, 5, rank)), shapes, 1)
    force = np.zeros_like(fields)
    force[:, :, body.loadable.left] = 1.0
    return fields, SimpleNamespace(
        time=0.25 * np.arange(5),
        path="none.h5",
        sequence=lambda split, i: SimpleNamespace(displacement=fields[i], force=force[i]),
    )


def read(body, dataset, count, path):
    which = [("train", i) for i in range(count)]
    return read_snapshots(dataset, which, body.free, body.loadable, path)


def test_modes_are_those_of_the_decomposition_of_all_snapshots_and_images(block, tissue, tmp_path):
    body = Body(block, tissue)
    fields, dataset = interactions(body, 8)
    snapshots = read(body, dataset, 8, tmp_path / "s.h5")
    rows = fields.reshape(-1, 60, 3)
    parts = body.free.fold(rows)
    both = np.concatenate([np.linalg.svd(part)[1] for part in parts])
    expected = np.sort(both)[::-1]
    decomposition = snapshots.decomposition(range(8))
    modes = decomposition.modes(10)
    assert sum(phi.shape[1] for phi in modes) == 10
    lost = np.sqrt(np.sum(expected[10:] ** 2) / np.sum(expected**2))
    assert decomposition.left_out(10) == pytest.approx(lost, rel=1e-3)
    assert decomposition.count(1.001 * decomposition.left_out(10)) == 10
    assert decomposition.count(0.999 * decomposition.left_out(10)) == 11
    for part, Q, phi in zip(parts, snapshots.bases, modes, strict=True):
        shape = Q @ phi
        assert np.allclose(shape.T @ shape, np.eye(phi.shape[1]), atol=1e-5)
        singular = np.linalg.svd(part)[1][: phi.shape[1]]
        assert np.allclose(np.linalg.norm(part @ shape, axis=0), singular, rtol=1e-3)


def test_coordinates_are_kept_and_opened_again(block, tissue, tmp_path):
    body = Body(block, tissue)
    fields, dataset = interactions(body, 4)
    snapshots = read(body, dataset, 4, tmp_path / "s.h5")
    again = open_snapshots(tmp_path / "s.h5")
    assert again.which == snapshots.which and again.interval == 0.25
    for i in range(4):
        for part, Q, y in zip(
            body.free.fold(fields[i]), again.bases, again.coordinates(i), strict=True
        ):
            assert np.linalg.norm(y @ Q.T - part) < 3e-4 * np.linalg.norm(part)


def test_the_basis_stops_growing_where_nothing_is_new():
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(6, 200))
    basis = GrowingBasis(200)
    for _ in range(10):
        basis.add(rng.normal(size=(5, 6)) @ shapes)
    assert basis.Q.shape == (200, 6)
    assert basis.lost < 1e-6 * basis.energy


def test_a_full_basis_tells_what_it_leaves_out():
    rng = np.random.default_rng(0)
    basis = GrowingBasis(50, most=10)
    rows = rng.normal(size=(40, 50))
    for part in np.split(rows, 8):
        basis.add(part)
    inside = rows @ basis.Q
    lost = np.sum(rows**2) - np.sum(inside**2)
    assert basis.Q.shape == (50, 10) and 0.5 * lost < basis.lost


def test_fields_that_are_not_finite_are_refused(block, tissue, tmp_path):
    body = Body(block, tissue)
    fields, dataset = interactions(body, 2)
    fields[1, 2, -1] = np.nan
    with pytest.raises(InputError, match="train 1"):
        read(body, dataset, 2, tmp_path / "s.h5")
    assert not (tmp_path / "s.h5").exists()
