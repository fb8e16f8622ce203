"""Lumped mass, thickness of cells, and the largest stable step of the leapfrog."""

import numpy as np
import scipy.sparse.linalg

from fem.errors import InputError, SolverStopped, Stop
from fem.mesh import element
from fem.mesh.hexmesh import HexMesh
from fem.solver.internal_force import InternalForce


def lumped_mass(mesh: HexMesh, density: float | np.ndarray) -> np.ndarray:
    """Row-sum lumped nodal mass (N,) in kg; density in kg/m3 is one number or one a cell (E,)."""
    detJ = np.linalg.det(element.jacobians(mesh.points, mesh.cells, element.GAUSS))  # (E, Q)
    shape = np.prod(1 + element.GAUSS[:, None] * element.CORNERS, axis=2) / 8  # (Q, 8)
    return np.bincount(
        mesh.cells.ravel(), (np.reshape(density, (-1, 1)) * detJ @ shape).ravel(), mesh.n_nodes
    )


def thickness(mesh: HexMesh) -> np.ndarray:
    """Smallest distance (E,) in m between opposite faces of each cell."""
    jacobian = element.jacobians(mesh.points, mesh.cells, element.CENTRE)[:, 0]  # (E, 3, 3)
    inverse = np.linalg.inv(jacobian)  # dxi_r/dX_i in columns
    return 2 / np.linalg.norm(inverse, axis=1).max(axis=1)


def critical_time_step(
    force: InternalForce,
    mass: np.ndarray,
    fixed: np.ndarray,
    u: np.ndarray | None = None,
    tolerance: float = 1e-3,
) -> float:
    """2 / omega_max of the tangent stiffness at displacement u (3, N), in s, for a linear undamped
    leapfrog.

    The largest eigenvalue of M^-1 K comes from Lanczos iteration (power iteration that keeps its
    past vectors), with K v by central differences of `force`, an InternalForce in float64 without
    Prony terms. Lanczos approaches the eigenvalue from below, so the step is too large by at most
    about `tolerance`.
    """
    u = np.zeros((3, len(mass))) if u is None else u
    free = np.flatnonzero(~np.tile(fixed, 3))
    if not free.size:
        raise InputError("every node of the mesh is fixed: nothing can move; free a surface")
    root = 1 / np.sqrt(np.tile(mass, 3)[free])
    scale = 1e-6 * thickness(force.mesh).min()
    v = np.zeros(u.size)

    def matvec(x):
        v[free] = root * x.ravel()
        size = scale / max(np.abs(v).max(), 1e-300)
        step = (size * v).reshape(u.shape)
        product = (force(u + step) - force(u - step)).ravel()[free] * root / (2 * size)
        if not np.isfinite(product).all():
            raise SolverStopped.because(
                Stop.NO_STABLE_STEP,
                "the stiffness is no longer finite, the state is beyond saving",
            )
        return product

    start = np.random.default_rng(0).normal(size=free.size)
    with np.errstate(all="ignore"):
        if free.size < 3:
            largest = np.linalg.norm(matvec(start)) / np.linalg.norm(start)
        else:
            operator = scipy.sparse.linalg.LinearOperator((free.size, free.size), matvec)
            try:
                largest = scipy.sparse.linalg.eigsh(
                    operator, 1, which="LA", v0=start, tol=tolerance, return_eigenvectors=False
                )[0]
            except scipy.sparse.linalg.ArpackError as error:
                raise SolverStopped.because(
                    Stop.NO_STABLE_STEP,
                    f"the stable step cannot be estimated ({error}), the state is beyond saving",
                ) from None
    if not (np.isfinite(largest) and largest > 0):
        raise SolverStopped.because(
            Stop.NO_STABLE_STEP,
            f"the stiffness has no positive frequency (largest eigenvalue {largest:.3g})",
        )
    return 2 / np.sqrt(largest)
