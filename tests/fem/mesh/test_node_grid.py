"""Between meshes and node grids: finding the grid of a shuffled mesh, embedding one that has none,
and curved loaded surfaces."""

import dataclasses
from pathlib import Path

import meshio
import numpy as np
import pytest

from fem.contact.draw import ContactRange, draw_contacts
from fem.contact.surface import Surface
from fem.data.scene import load_scene
from fem.errors import InputError
from fem.mesh.embedding import Embedding
from fem.mesh.node_grid import node_grid
from fem.mesh.read import read_mesh
from fem.mesh.shapes import box, tumour
from fem.online.grid import NodeGrid

CONFIGS = Path(__file__).parents[3] / "configs"
TURNS = (
    [0, 1, 2, 3, 4, 5, 6, 7],
    [1, 2, 3, 0, 5, 6, 7, 4],
    [4, 0, 3, 7, 5, 1, 2, 6],
    [1, 5, 6, 2, 0, 4, 7, 3],
)  # of a cell's corners


def bend(points):
    """A curved, sheared image of points (N, 3), without mirrors."""
    x, y, z = points.T
    return np.stack([x + 0.3 * np.sin(y), y + 0.2 * z, z + 0.1 * x**2 / 6], axis=1)


def shuffled(mesh, seed=0):
    """(points, cells, number) of the mesh with nodes, cells and corners in random order; number[old
    node] is the new one."""
    rng = np.random.default_rng(seed)
    node = rng.permutation(mesh.n_nodes)
    number = np.argsort(node)
    cells = number[mesh.cells][rng.permutation(mesh.n_cells)]
    return mesh.points[node], np.array([cell[TURNS[rng.integers(4)]] for cell in cells]), number


@pytest.mark.parametrize("make", [tumour, lambda: box((7, 4, 3), 1e-3)])
@pytest.mark.parametrize("seed", range(3))
def test_the_grid_of_a_shuffled_curved_mesh_is_found(make, seed):
    """With nodes, cells and corners in random order and the mesh bent, every node goes back to its
    place, also around the tumour's steps."""
    mesh = make()
    edge = np.ptp(mesh.points[mesh.cells[0]], axis=0).max()
    points, cells, number = shuffled(
        dataclasses.replace(mesh, points=bend(mesh.points / edge) * edge), seed
    )
    old = np.argsort(number)
    mixed = dataclasses.replace(
        mesh, points=points, cells=cells, fixed=mesh.fixed[old], grid=None, node_sets={}
    )
    i, j, k = np.unravel_index(mesh.grid.index[old], mesh.grid.shape)
    shape = (*mesh.grid.shape[:2], int(np.ptp(k)) + 1)  # without the tumour's void layer
    assert node_grid(mixed) == NodeGrid(shape, np.ravel_multi_index((i, j, k - k.min()), shape))


@pytest.mark.parametrize(
    "axis, shape",
    [("z max", (7, 6, 5)), ("x max", (5, 6, 7)), ("y min", (7, 5, 6)), ("z min", (7, 6, 5))],
)
def test_the_loaded_side_is_the_last_layer_of_the_grid(tmp_path, axis, shape):
    """Whichever side is loaded becomes the last layer along the third axis, in a right-handed
    grid."""
    mesh, path = box((6, 5, 4), 1.0, "none"), tmp_path / "block.vtu"
    meshio.Mesh(mesh.points, [("hexahedron", mesh.cells)]).write(path)
    mesh = read_mesh(path, 1.0, f"all but {axis}", axis)
    found = node_grid(mesh)
    grid = found.to_grid(mesh.points)
    assert found.shape == shape and found.to_grid(mesh.loaded[:, None])[..., -1, 0].all()
    assert (
        np.linalg.det(
            [
                grid[1, 0, 0] - grid[0, 0, 0],
                grid[0, 1, 0] - grid[0, 0, 0],
                grid[0, 0, 1] - grid[0, 0, 0],
            ]
        )
        > 0
    )


def test_the_grid_points_the_way_most_of_a_surface_on_several_sides_faces(tmp_path):
    """A block held at its bottom alone can be pushed on from above: its walls face each other. One
    that can be pushed on from all sides alike has no last layer, and says so."""
    mesh, path = box((3, 3, 3), 1.0, "none"), tmp_path / "block.vtu"
    meshio.Mesh(mesh.points, [("hexahedron", mesh.cells)]).write(path)
    block = read_mesh(path, 1.0, "z min")
    assert node_grid(block) == mesh.grid
    assert (block.points[block.contact_faces, 2] == 3.0).all() and len(block.contact_faces) == 9
    with pytest.raises(InputError, match="faces all sides alike.* mesh.loaded, such as 'z max'"):
        node_grid(dataclasses.replace(block, fixed=np.zeros(block.n_nodes, bool)))


def test_the_walls_of_steps_take_no_contact_and_their_edges_are_no_rim(distort):
    """Contacts push on the tumour's upward faces on both levels, also where it is distorted, and
    also without a grid; its rim is at the walls alone."""
    for mesh in (tumour(1.0), dataclasses.replace(distort(tumour(1.0)), grid=None)):
        x, y, z = tumour(1.0).points.T
        faces = mesh.contact_faces
        assert len(faces) == 16 * 16 and (np.ptp(z[faces], axis=1) == 0).all()
        assert np.unique(z[faces]).tolist() == [5, 6] and (z[faces] == 6).all(axis=1).sum() == 34
        assert np.array_equal(mesh.contact_rim, np.flatnonzero(mesh.fixed & (z == 5)))


def test_a_curved_surface_is_pushed_on_whole():
    """The lobe's normals turn by 50 degrees from z: contacts push on every face of its top."""
    lobe = load_scene(CONFIGS / "lobe.toml").mesh.build()
    assert np.array_equal(lobe.contact_faces, lobe.free_faces)
    assert np.abs(Surface(lobe).normal[:, 2]).min() < np.cos(np.radians(45))


def ring(n=12):
    """A ring of n x 2 x 2 cells, closed, so that no regular grid can hold it; its bottom is fixed,
    its top loaded."""
    strip = box((n, 2, 2), 1.0, "none")
    i, j, k = np.round(strip.points).astype(int).T
    radius, angle = 3.0 + j, 2 * np.pi * (i % n) / n
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), k], axis=1)
    same = ((i % n) * 3 + j) * 3 + k
    kept, first, place = np.unique(same, return_index=True, return_inverse=True)
    mesh = dataclasses.replace(
        strip,
        points=points[first],
        cells=place[strip.cells][:, [3, 2, 1, 0, 7, 6, 5, 4]],
        fixed=k[first] == 0,
        grid=None,
        node_sets={},
    )
    return dataclasses.replace(mesh, loaded=k[first] == 2)


def wave(points):
    """A smooth displacement field that vanishes on z = 0."""
    x, y, z = points.T
    return z[:, None] * np.stack([np.sin(x), np.cos(x + y), -np.exp(-(x**2) / 8)], axis=1)


def test_a_ring_has_no_grid_and_is_embedded_in_one():
    """The walk round a closed ring meets itself one turn off: no grid. Its embedding carries about
    its volume."""
    mesh = ring()
    assert node_grid(mesh) is None
    for shape, off in (((9, 9, 4), 0.01), (None, 0.02)):
        embedding = Embedding(mesh, shape)
        assert embedding.grid_mesh.volume() == pytest.approx(mesh.volume(), rel=off)
        assert embedding.grid_mesh.n_nodes < np.prod(embedding.shape)  # the hole is no material
    assert embedding.shape[2] >= 3 and embedding.grid_mesh.grid.shape == embedding.shape


def test_embedding_error_falls_with_the_grid():
    """From the mesh to the grid and back a smooth field loses ever less: under 1 % on a grid as
    fine as the mesh."""
    mesh = ring(24)
    u, errors = wave(mesh.points), []
    for n in (7, 13, 25):
        embedding = Embedding(mesh, (n, n, (n + 1) // 2))
        back = embedding.to_mesh(embedding.displacement_to_grid(u))
        errors.append(np.linalg.norm(back - u) / np.linalg.norm(u))
    assert errors[0] > errors[1] > errors[2] and errors[0] < 0.15 and errors[2] < 1e-3


def test_embedding_keeps_force_virtual_work_and_linear_fields():
    """The forces on the grid add up to the mesh's and do the same work in every grid field;
    stretching is exact."""
    mesh = ring()
    embedding, rng = Embedding(mesh, (7, 8, 5)), np.random.default_rng(0)
    force = rng.normal(size=(2, mesh.n_nodes, 3))
    on_grid = embedding.force_to_grid(force)
    assert np.allclose(on_grid.sum(axis=1), force.sum(axis=1), rtol=1e-12)
    motion = rng.normal(size=on_grid.shape)
    assert np.vdot(on_grid, motion) == pytest.approx(
        np.vdot(force, embedding.to_mesh(motion)), rel=1e-12
    )
    stretch = rng.normal(size=(3, 3)) * [[0], [0], [1]]  # by z, zero where the ring is held
    assert np.allclose(
        embedding.displacement_to_grid(mesh.points @ stretch),
        embedding.grid_mesh.points @ stretch,
        atol=1e-5,
    )
    fixed = embedding.grid_mesh.fixed
    assert np.array_equal(fixed, embedding.grid_mesh.points[:, 2] == 0)
    assert not embedding.displacement_to_grid(force)[:, fixed].any()


def test_embedding_turns_the_loaded_surface_up():
    """For a surface that faces -x the grid's third axis runs along -x, and points stay where they
    are."""
    mesh = ring()
    turned = dataclasses.replace(
        mesh, points=mesh.points @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    )
    embedding = Embedding(turned, (7, 7, 4))
    grid = embedding.grid_mesh.grid.to_grid(embedding.grid_mesh.points)
    mask = embedding.grid_mesh.grid.mask
    layers = [grid[..., k, 0][mask[..., k]] for k in range(4)]
    assert all(np.allclose(layer, -2 * k / 3) for k, layer in enumerate(layers))


@pytest.fixture(scope="module")
def shell():
    """Half a thin tube (radius 10 to 10.4, length 12), held at its two straight edges, free inside
    and outside."""
    strip = box((24, 12, 2), 1.0, "none")
    a, y, c = strip.points.T / [[24], [1], [2]]
    angle, radius = np.pi * (0.5 - a), 10 + 0.4 * c
    points = np.stack([radius * np.sin(-angle), y, radius * np.cos(angle)], axis=1)
    return dataclasses.replace(strip, points=points, fixed=(a == 0) | (a == 1), grid=None)


def test_a_footprint_follows_the_curve_and_stays_on_its_side_of_a_thin_wall(shell):
    """A centre below the crown of a tube, as on a straight path, pushes on the outside alone, with
    its whole radius."""
    surface, outside = Surface(shell), np.linalg.norm(shell.points[:, [0, 2]], axis=1) > 10.3
    crown = np.array([0.0, 6.0, 10.4])
    on_top, below = surface.footprint(crown, 3.0), surface.footprint(crown - [0, 0, 0.15], 3.0)
    assert on_top.sum() == pytest.approx(1, abs=1e-14) and below.sum() == pytest.approx(
        1, abs=1e-14
    )
    assert not on_top[~outside].any() and not below[~outside].any()
    assert np.abs(on_top - below).max() < 0.02 * on_top.max()


def test_paths_on_a_loaded_surface_keep_off_its_edge_and_on_its_side(shell):
    """Draws on a chosen part of a surface start and end a radius away from its edge, and never
    cross to the other side."""
    outside = np.linalg.norm(shell.points[:, [0, 2]], axis=1) > 10.3
    ranges = ContactRange(count=1, radius=(1.5, 2.0), force=(1.0, 2.0), travel=(0.0, 12.0))
    for mesh, edge in (
        (dataclasses.replace(shell, loaded=outside & (shell.points[:, 1] < 9)), 9.0),
        (shell, 12.0),
    ):
        surface = Surface(mesh)
        for seed in range(40):
            (contact,) = draw_contacts(surface, ranges, 1.0, np.random.default_rng(seed))
            sides = [
                np.linalg.norm(centre[[0, 2]]) > 10.2 for centre in (contact.start, contact.end)
            ]
            assert sides[0] == sides[1] and (sides[0] or mesh is shell)
            if mesh is not shell:
                assert all(
                    0.9 * 1.5 < centre[1] < edge - 0.9 * 1.5
                    for centre in (contact.start, contact.end)
                )
