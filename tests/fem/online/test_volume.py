"""The volume within quads: exact for known bodies, and no more work than the moving faces need."""

import numpy as np
import pytest

from fem.mesh.shapes import box
from fem.online.volume import QuadVolume


@pytest.fixture
def mesh(distort):
    return distort(box((4, 3, 2), 1.0))


def test_of_a_distorted_mesh_is_that_of_its_cells(mesh):
    volume = QuadVolume(mesh.points, mesh.boundary_faces, ~mesh.fixed)
    rng = np.random.default_rng(0)
    displacement = 0.1 * rng.normal(size=mesh.points.shape) * ~mesh.fixed[:, None]
    for u in (np.zeros_like(displacement), displacement):
        # a trilinear cell's face and the quad of the same corners enclose the same volume
        assert volume(u.astype("float32")) == pytest.approx(mesh.volume(u), rel=1e-5)


def test_does_not_depend_on_where_the_origin_is(mesh):
    near, far = (
        QuadVolume(mesh.points + shift, mesh.boundary_faces, ~mesh.fixed) for shift in (0.0, 1e4)
    )
    still = np.zeros(mesh.points.shape, "float32")
    assert far(still) == pytest.approx(near(still), rel=1e-5)
