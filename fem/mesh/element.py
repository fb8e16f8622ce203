"""The eight-node hexahedron: corners, shape functions, quadrature and hourglass vectors, in VTK
node order."""

import numpy as np

CORNERS = np.array(
    [
        [-1, -1, -1],
        [1, -1, -1],
        [1, 1, -1],
        [-1, 1, -1],
        [-1, -1, 1],
        [1, -1, 1],
        [1, 1, 1],
        [-1, 1, 1],
    ],
    float,
)  # (8, 3) reference coordinates of the nodes
FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)  # (6, 4) corners of each face, counter-clockwise seen from outside
GAUSS = CORNERS / np.sqrt(3.0)  # (8, 3) the 2 x 2 x 2 points, each of weight 1
CENTRE = np.zeros((1, 3))  # the one-point rule, of weight 8

_x, _y, _z = CORNERS.T
HOURGLASS = np.array(
    [_y * _z, _z * _x, _x * _y, _x * _y * _z]
)  # (4, 8) orthogonal to every linear field on a parallelepiped


def shape_gradients(points: np.ndarray) -> np.ndarray:
    """dN_a/dxi_r at reference `points` (Q, 3): (Q, 3, 8)."""
    t = 1.0 + points[:, None, :] * CORNERS  # (Q, 8, 3)
    products = np.stack(
        [t[..., 1] * t[..., 2], t[..., 2] * t[..., 0], t[..., 0] * t[..., 1]], axis=1
    )
    return CORNERS.T * products / 8.0


def quad_shape(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bilinear shape functions of a quadrilateral face at `points` (Q, 2) in [-1, 1]^2: (Q, 4), and
    gradients (Q, 2, 4)."""
    a, b = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    s, t = 1.0 + points[:, :1] * a, 1.0 + points[:, 1:] * b
    return s * t / 4.0, np.stack([a * t, b * s], axis=1) / 4.0


def corner_jacobians(x: np.ndarray) -> np.ndarray:
    """det dX_i/dxi_r at the corners of cells with nodes at x (3, 8, E): (8, E)."""
    x = x.reshape(3, 2, 4, -1)  # bottom and top, around: an edge along x or z stands at two corners
    a = (x[:, :, 1:3] - x[:, :, ::3])[:, :, :, None]  # (3, 2, 2, 1, E)
    b = (x[:, :, 3:1:-1] - x[:, :, :2])[:, :, [[0, 1], [1, 0]]]  # (3, 2, 2, 2, E)
    c = (x[:, 1] - x[:, 0]).reshape(3, 1, 2, 2, -1)
    volume = a[0] * (b[1] * c[2] - b[2] * c[1])  # twice as fast as by np.cross
    volume += a[1] * (b[2] * c[0] - b[0] * c[2])
    volume += a[2] * (b[0] * c[1] - b[1] * c[0])
    return volume.reshape(8, -1) / 8


def jacobians(points: np.ndarray, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
    """dX_i/dxi_r of cells (E, 8) with nodes at `points` (N, 3), at reference points `where` (Q, 3):
    (E, Q, 3, 3)."""
    return np.einsum("eai,qra->eqir", points[cells], shape_gradients(where))


def gauss_volumes(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """(E, 8) volumes of the Gauss points of hexahedra with corners at `points` (N, 3), in their
    unit cubed; their sum is exact for trilinear cells."""
    return np.linalg.det(jacobians(points, cells, GAUSS))
