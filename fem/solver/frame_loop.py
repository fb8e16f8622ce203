"""The FEM as a real-time loop: a force array comes every frame, a fixed number of time steps
answers it."""

from dataclasses import dataclass, replace

import numpy as np

from fem.errors import InputError
from fem.mesh.embedding import Embedding
from fem.mesh.shapes import from_voxels
from fem.solver.explicit import Solver

# share of the critical step at rest: under the hardest pushes of the tumour's data it falls by 23 %
SAFETY = 0.75
UPDATE = 11  # steps of a loop between updates of the viscous stress, or more where they are short


@dataclass(frozen=True)
class Competitor:
    """Settings of one loop.

    element, hourglass_stiffness: see fem.solver.internal_force.InternalForce; coarse: on half as
    many cells along each axis
    frame: s between two forces; steps: time steps that a frame may take
    damping: mass-proportional damping times the longest safe step: the share of its velocity that
    the tissue loses in such a step
    rise: share of the frame over which the load goes from the last force to this one; the rest of
    the frame settles
    """

    element: str
    coarse: bool
    frame: float
    steps: int
    hourglass_stiffness: float = 0.2
    damping: float = 0.1
    rise: float = 1.0

    @property
    def name(self):
        return f"FEM {self.element}{', coarse' if self.coarse else ''}, {self.steps} steps / {1e3 * self.frame:g} ms"


class LoopSolver(Solver):
    """A Solver whose stable step is estimated at rest alone: in a loop there is no time for it, and
    SAFETY leaves room for what a load changes.

    A step that is too long after all ends in SolverStopped, as "diverged" or "crushed cell". The
    viscous stress, which a few steps hardly change, is brought up to date once in UPDATE steps at
    most, for that costs as much as three steps.
    """

    def __init__(self, *arguments, steps, **options):
        self.frame_steps = steps
        super().__init__(*arguments, **options)

    def _viscous_stride(self, dt):
        return max(super()._viscous_stride(dt), min(UPDATE, self.frame_steps))

    def estimate_step(self):
        if self.steps == 0:
            super().estimate_step()
        self._state_at_estimate = self.force.min_J, self.force.stiffening


class FrameLoop:
    """One competitor, warm-started from frame to frame: loop(force (nx, ny, nz, 3) mN) is the
    displacement (nx, ny, nz, 3) mm.

    The frame's steps are of equal length. Where that is beyond the stable step the mass is scaled
    up, just enough. Attributes: solver, mass_scaling, and damping_rate in 1/s. Raises SolverStopped
    where the FEM cannot go on.
    """

    def __init__(self, dataset, competitor):
        self.competitor = competitor
        own = dataset.fem_mesh
        self.index, self.grid, self.fixed = own.grid_index, own.grid_shape, own.fixed
        mesh, self.transfer = loop_mesh(dataset, competitor)
        longest = longest_step(dataset, competitor)
        self.mass_scaling = max(1.0, (competitor.frame / competitor.steps / longest) ** 2)
        self.damping_rate = competitor.damping / (longest * np.sqrt(self.mass_scaling))
        options = {
            "damping": self.damping_rate,
            "mass_scaling": self.mass_scaling,
            "steps": competitor.steps,
        }
        self.solver = _solver(LoopSolver, mesh, dataset, competitor, **options)
        self.load = np.zeros((3, mesh.n_nodes))

    def __call__(self, force):
        old, new = self.load, self._to_mesh(force)
        change, start, rise = (
            new - old,
            self.solver.time,
            self.competitor.rise * self.competitor.frame,
        )
        self.load = new
        self.solver.advance(
            self.competitor.frame,
            lambda t: old + min(1.0, (t - start) / rise) * change if rise else new,
            steps=self.competitor.steps,
        )
        return self._to_grid(self.solver.u)

    def _to_mesh(self, force):
        nodal = force.reshape(-1, 3)[self.index].T * 1e-3  # (3, N) N
        return nodal if self.transfer is None else (self.transfer.T @ nodal.T).T

    def _to_grid(self, u):
        if self.transfer is not None:
            u = np.where(self.fixed, 0.0, (self.transfer @ u.T).T)
        out = np.zeros((int(np.prod(self.grid)), 3), np.float32)
        out[self.index] = u.T * 1e3
        return out.reshape(*self.grid, 3)


def longest_step(dataset, competitor):
    """The longest step in s that this element takes at rest with the true mass."""
    return (
        SAFETY
        * _solver(Solver, loop_mesh(dataset, competitor)[0], dataset, competitor).critical_step
    )


def _solver(make, mesh, dataset, competitor, **options):
    choice = {
        "element": competitor.element,
        "hourglass_stiffness": competitor.hourglass_stiffness,
        "precision": "float32",
    }
    return make(mesh, dataset.scene.material, **choice, **options)


def loop_mesh(dataset, competitor):
    """(HexMesh, A or None) that a competitor simulates, see `coarse_mesh`. Raises InputError if the
    scene's mesh has no node grid."""
    mesh = dataset.fem_mesh
    if mesh.grid_shape is None:
        raise InputError(
            "the FEM loop takes forces on the node grid, and this scene's mesh does not lie on it; use mesh.kind = 'tumour' or 'box'"
        )
    return coarse_mesh(mesh) if competitor.coarse else (mesh, None)


def coarse_mesh(mesh):
    """(HexMesh, A): a tumour or box with half as many cells along each axis, and displacement from
    its nodes to those of `mesh`, (N, n) sparse.

    An odd number of cells rounds to even, the cells then are no cubes. Of the coarse grid those
    cells are kept that are fullest and together have the volume of `mesh`; A is trilinear
    interpolation, so that forces go the other way by its transpose (see fem.embedding).
    """
    shape = tuple(max(1, round((n - 1) / 2)) + 1 for n in mesh.grid_shape)
    embedding = Embedding(mesh, shape)
    around = embedding.grid_mesh
    keep = np.zeros(np.array(shape) - 1, bool)
    keep[np.unravel_index(around.grid_index[around.cells[:, 0]], shape)] = True
    cubes = from_voxels(keep, 1.0, "all but top")
    coarse = replace(
        cubes,
        points=mesh.points.min(axis=0)
        + cubes.points * np.ptp(mesh.points, axis=0) / (np.array(shape) - 1),
    )
    return coarse, embedding.to_mesh_matrix[
        :, np.searchsorted(around.grid_index, coarse.grid_index)
    ].tocsr()
