"""The volume of a deformed mesh and the losses and metrics made of it."""

import dataclasses
import itertools
from types import SimpleNamespace

import keras
import numpy as np
import pytest
import tensorflow as tf

from fem.errors import InputError
from fem.mesh.shapes import tumour
from unet_fem.training.losses import (
    RelativeError,
    deformed_volume,
    direction_loss,
    gate_open,
    volume_at_rest,
    volume_loss,
    volume_scale,
    volume_violation,
)
from unet_fem.training.surface import volume_surface

GRID = (4, 3, 3)
EDGE = 0.5087  # mm
CORNERS = list(itertools.product((0, 1), repeat=3))


def box(grid=GRID):
    """Reference positions (N, 3) of a box of cubes away from the origin, its boundary quads, its
    cells' nodes."""
    points = np.stack(np.meshgrid(*map(np.arange, grid), indexing="ij"), axis=-1).reshape(
        -1, 3
    ) * EDGE + [5, -3, 2]
    faces, cells = [], []
    for cell in itertools.product(*(range(n - 1) for n in grid)):
        cells.append([np.ravel_multi_index(np.add(cell, corner), grid) for corner in CORNERS])
        for axis, side in itertools.product(range(3), (0, 1)):
            if cell[axis] != side * (grid[axis] - 2):
                continue
            first, second = ((axis + 1) % 3, (axis + 2) % 3)[:: 1 if side else -1]
            quad = []
            for s, t in ((0, 0), (1, 0), (1, 1), (0, 1)):
                node = list(cell)
                node[axis] += side
                node[first] += s
                node[second] += t
                quad.append(np.ravel_multi_index(node, grid))
            faces.append(quad)
    return points, np.array(faces), np.array(cells)


POINTS, FACES, CELLS = box()
ORIGIN = 12 * EDGE**3


def displacements(samples, size, seed=0):
    return np.random.default_rng(seed).normal(size=(samples, *GRID, 3)) * size


def stretched(*factors):
    """Uniform stretches along x, one sample each: volumes ORIGIN * factor."""
    moved = np.zeros((len(factors), *GRID, 3))
    moved[..., 0] = (np.array(factors)[:, None] - 1).reshape(-1, 1, 1, 1) * POINTS[:, 0].reshape(
        GRID
    )
    return moved


def gauss_volume(displacement):
    """Volume of trilinear hexahedra by 2 x 2 x 2 Gauss points, which integrate their Jacobian
    exactly."""
    volume = 0
    x = (POINTS + displacement.reshape(-1, 3))[CELLS]  # (E, 8, 3)
    for point in itertools.product((0.5 - 12**-0.5, 0.5 + 12**-0.5), repeat=3):
        gradient = np.ones((8, 3))
        for n, corner in enumerate(CORNERS):
            for axis, other in itertools.product(range(3), repeat=2):
                value = point[axis] if corner[axis] else 1 - point[axis]
                gradient[n, other] *= (1 if corner[axis] else -1) if axis == other else value
        volume += np.linalg.det(np.einsum("eni,nj->eij", x, gradient)).sum() / 8
    return volume


def gradient(function, displacement):
    u = tf.constant(displacement)
    with tf.GradientTape() as tape:
        tape.watch(u)
        value = function(u)
    return tape.gradient(value, u).numpy()


def finite_difference(function, displacement, direction, step=1e-5):
    ahead, behind = (
        function(tf.constant(displacement + sign * step * direction)) for sign in (1, -1)
    )
    return float(ahead - behind) / (2 * step)


def test_volume_is_exact_for_trilinear_hexahedra():
    u = displacements(3, 0.2)
    exact = np.array([gauss_volume(sample) for sample in u])
    assert np.all(np.abs(exact / ORIGIN - 1) > 1e-3)
    np.testing.assert_allclose(deformed_volume(u, POINTS, FACES), exact, rtol=1e-12)
    np.testing.assert_allclose(
        deformed_volume(u.astype("float32"), POINTS, FACES), exact, rtol=2e-6
    )


def test_volume_face_is_the_average_of_both_triangulations():
    x = POINTS + displacements(1, 0.2).reshape(-1, 3)
    a, b, c, d = np.moveaxis(x[FACES], 1, 0)

    def tetrahedra(p, q, r):
        return np.einsum("fi,fi->", p, np.cross(q, r)) / 6

    one = tetrahedra(a, b, c) + tetrahedra(a, c, d)
    other = tetrahedra(a, b, d) + tetrahedra(b, c, d)
    assert abs(one - other) > 1e-4
    u = (x - POINTS).reshape(1, *GRID, 3)
    np.testing.assert_allclose(deformed_volume(u, POINTS, FACES), [(one + other) / 2], rtol=1e-12)


def test_volume_survives_rigid_motion():
    shape = POINTS + displacements(1, 0.1).reshape(-1, 3)
    rotation, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    rotation *= np.linalg.det(rotation)
    moved = np.stack([shape, shape + [2, -1, 3], shape @ rotation.T]) - POINTS
    volumes = deformed_volume(moved.reshape(3, *GRID, 3).astype("float32"), POINTS, FACES).numpy()
    np.testing.assert_allclose(volumes, volumes[0], rtol=1e-5)


def test_closed_gate_leaves_the_mean_squared_error():
    loss, plain = volume_loss(POINTS, FACES), volume_loss(POINTS, FACES, weight=0.0)
    u, truth = stretched(1.05, 0.95), displacements(2, 0.1)
    np.testing.assert_allclose(
        loss(truth, tf.constant(u)), ((u - truth) ** 2).mean(axis=(1, 2, 3, 4))
    )
    by_loss, by_error = (
        gradient(lambda u, f=f: keras.ops.mean(f(truth, u)), u) for f in (loss, plain)
    )
    np.testing.assert_array_equal(by_loss, by_error)


def test_open_gate_adds_the_squared_change_of_volume():
    loss = volume_loss(POINTS, FACES, weight=0.3)
    u = stretched(1.2, 0.8)
    np.testing.assert_allclose(loss(u, tf.constant(u)), 2 * [0.3 * (0.2 * ORIGIN) ** 2])


def test_gradient_through_an_open_gate_is_that_of_finite_differences():
    loss = volume_loss(POINTS, FACES, weight=10.0)
    truth, u = displacements(2, 0.1), stretched(1.2, 0.8) + displacements(2, 0.02, seed=1)

    def total(u):
        return keras.ops.mean(loss(truth, u))

    analytic = gradient(total, u)
    for seed in range(5):
        direction = displacements(2, 1.0, seed=seed + 10)
        expected = finite_difference(total, u, direction)
        assert np.sum(analytic * direction) == pytest.approx(expected, rel=1e-6)


def test_gate_acts_sample_by_sample():
    u = stretched(1.06, 1.08, 0.94, 0.92)
    loss = volume_loss(POINTS, FACES, weight=1.0)(u, tf.constant(u)).numpy()
    np.testing.assert_allclose(loss, [0, (0.08 * ORIGIN) ** 2, 0, (0.08 * ORIGIN) ** 2])
    gradients = gradient(
        lambda u: keras.ops.sum(volume_loss(POINTS, FACES)(tf.stop_gradient(u), u)), u
    )
    assert np.any(gradients != 0, axis=(1, 2, 3, 4)).tolist() == [False, True, False, True]
    np.testing.assert_array_equal(gate_open(POINTS, FACES)(None, tf.constant(u)), [0, 1, 0, 1])
    np.testing.assert_allclose(
        volume_violation(POINTS, FACES)(None, tf.constant(u)), [0.06, 0.08, 0.06, 0.08]
    )


def test_direction_is_that_of_the_loaded_nodes():
    force, u = np.zeros((3, *GRID, 3)), displacements(3, 1.0)
    force[0, 1, 1, 2], u[0, 1, 1, 2] = [0, 0, -2], [0, 3, -3]  # 45 degrees
    force[0, 2, 1, 2], u[0, 2, 1, 2] = [0, 0, -1], [0, 0, 0.5]  # opposite
    force[1, 1, 1, 2], u[1, 1, 1, 2] = [1, 0, -1], [0.2, 0, -0.2]  # along
    expected = [((1 - 0.5**0.5) + 2) / 2, 0, 0]  # the third sample is not loaded
    np.testing.assert_allclose(direction_loss(force, tf.constant(u)), expected, atol=2e-5)


def test_direction_weight_reads_the_force_beside_the_displacement():
    force, truth, u = (
        displacements(2, 1.0),
        displacements(2, 0.1, seed=1),
        displacements(2, 0.1, seed=2),
    )
    both = np.concatenate([truth, force], axis=-1)
    plain = volume_loss(POINTS, FACES)(truth, tf.constant(u))
    loss = volume_loss(POINTS, FACES, direction_weight=0.5)(both, tf.constant(u))
    np.testing.assert_allclose(loss, plain + 0.5 * direction_loss(force, tf.constant(u)))


def test_direction_gradient_is_finite_where_nothing_moved():
    force = displacements(2, 1.0)
    force[0, :2] = 0
    slope = gradient(lambda u: keras.ops.mean(direction_loss(force, u)), np.zeros((2, *GRID, 3)))
    assert np.all(np.isfinite(slope))
    assert np.all(slope[0, :2] == 0)
    assert np.sum(slope * force) < 0  # moving with the force lowers the loss
    u = displacements(2, 0.01)
    direction = displacements(2, 1.0, seed=3)
    expected = finite_difference(
        lambda u: keras.ops.mean(direction_loss(force, u)), u, direction, step=1e-7
    )
    slope = gradient(lambda u: keras.ops.mean(direction_loss(force, u)), u)
    assert np.sum(slope * direction) == pytest.approx(expected, rel=1e-5)


def test_relative_error_does_not_depend_on_the_batches():
    truth, predicted = (
        displacements(6, 1.0) * np.arange(1, 7).reshape(-1, 1, 1, 1, 1),
        displacements(6, 1.0, seed=1),
    )
    expected = np.linalg.norm(predicted - truth) / np.linalg.norm(truth)
    for size in (1, 4, 6):
        metric = RelativeError()
        for start in range(0, 6, size):
            metric.update_state(truth[start : start + size], predicted[start : start + size])
        assert float(metric.result()) == pytest.approx(expected, rel=1e-6)
    metric.reset_state()
    assert float(metric.result()) == 0


def test_a_model_trains_on_the_loss_and_reports_the_metrics():
    keras.utils.set_random_seed(0)
    model = keras.Sequential([keras.Input((*GRID, 3)), keras.layers.Conv3D(3, 3, padding="same")])
    metrics = [gate_open(POINTS, FACES), volume_violation(POINTS, FACES), RelativeError()]
    loss = volume_loss(POINTS, FACES, direction_weight=0.01)
    model.compile(keras.optimizers.Adam(1e-2), loss, metrics=metrics)
    force = displacements(10, 1.0)
    target = np.concatenate([0.1 * force, force], axis=-1)
    history = model.fit(force, target, batch_size=4, epochs=20, verbose=0).history
    assert set(history) == {"loss", "gate_open", "volume_violation", "relative_error"}
    assert history["loss"][-1] < history["loss"][0]
    predicted = model.predict(force, verbose=0)
    results = model.evaluate(force, target, batch_size=4, verbose=0, return_dict=True)
    change = np.array([gauss_volume(sample) for sample in predicted]) / ORIGIN - 1
    assert results["gate_open"] == pytest.approx(np.mean(np.abs(change) > 0.07))
    assert results["volume_violation"] == pytest.approx(np.mean(np.abs(change)), rel=1e-4)
    error = np.linalg.norm(predicted - 0.1 * force) / np.linalg.norm(0.1 * force)
    assert results["relative_error"] == pytest.approx(error)


def test_faces_that_bound_no_volume_are_refused():
    with pytest.raises(InputError, match=r"faces bound -1\.58.* mm3"):
        volume_loss(POINTS, FACES[:, ::-1])
    with pytest.raises(InputError, match="0 to 35 of 35"):
        volume_loss(POINTS[:-1], FACES)


def of_the_tumour():
    """A dataset of the published mesh with nothing in it, as far as the volume needs one."""
    mesh = tumour()
    points = mesh.grid.to_grid(1e3 * mesh.points)
    surface = points.reshape(-1, 3), mesh.grid_index[mesh.boundary_faces]
    return SimpleNamespace(fem_mesh=mesh, surface=surface, path="made-up.h5", grid=points.shape[:3])


def test_the_volume_of_the_tumour_is_that_of_its_cells_alone():
    """The paper says both: 7 % of the whole are the 12.1 mm3 of its text."""
    dataset = of_the_tumour()
    cell = EDGE**3
    for of, count in (("all", 1314), ("tumour", 148)):
        surface = volume_surface(dataset, of)
        assert volume_at_rest(*surface) == pytest.approx(count * cell, rel=1e-6)
    assert 0.07 * volume_at_rest(*dataset.surface) == pytest.approx(12.1, abs=0.02)
    moved = np.zeros((1, *dataset.grid, 3))
    own = np.unravel_index(np.unique(volume_surface(dataset, "tumour")[1]), dataset.grid)
    moved[0][own] = 0.1 * dataset.surface[0].reshape(*dataset.grid, 3)[own]
    found = deformed_volume(moved, *volume_surface(dataset, "tumour"))
    assert float(found[0]) == pytest.approx(1.1**3 * 148 * cell, rel=1e-6)


def test_a_volume_of_cells_that_are_not_there_is_refused():
    dataset = of_the_tumour()
    bare = dataclasses.replace(dataset.fem_mesh, cell_sets={})
    for mesh, remedy in ((bare, "cell sets none; set it to 'all'"),):
        with pytest.raises(InputError, match=remedy):
            volume_surface(SimpleNamespace(fem_mesh=mesh, path="x.h5"), "tumour")


def test_the_scale_of_the_term_is_that_of_two_answers_losses():
    """Of one just beyond its gate, which is wrong in nothing else, over one that stays at rest."""
    truth = stretched(1.07 + 1e-9)
    loss = volume_loss(POINTS, FACES, weight=0.1, threshold=0.07)
    scale = volume_scale(POINTS, FACES, 0.1, 0.07, truth)
    beyond = float(loss(truth, truth)[0])
    at_rest = float(loss(truth, np.zeros_like(truth))[0])
    assert beyond / at_rest == pytest.approx(scale, rel=1e-4)
