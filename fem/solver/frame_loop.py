"""The FEM as a real-time loop: a force array comes every frame, a fixed number of time steps
answers it."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.sparse
import scipy.spatial

from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.mesh import element
from fem.mesh.embedding import Embedding
from fem.mesh.hexmesh import HexMesh
from fem.mesh.shapes import from_voxels
from fem.online.grid import MM, MN
from fem.online.stepper import State, as_field, check_interval, check_nodal
from fem.ranges import number
from fem.settings import normalised
from fem.solver.explicit import Solver
from fem.solver.leapfrog import Leapfrog
from fem.solver.leapfrog import State as SolverState
from fem.solver.step_control import Pace, StepControl

# share of the critical step at rest: that falls by up to 6 % under the hardest pushes of the
# tumour's data, and by 10 % under four times their largest usual force
SAFETY = 0.75
UPDATE = 11  # steps of a loop between updates of the viscous stress, or more where they are short


@dataclass(frozen=True)
class LoopSettings:
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
    frame: float = number(1e-6, 1e5, "s")
    steps: int = number(1, 1_000_000)
    hourglass_stiffness: float = number(0, 100, default=0.2)
    damping: float = number(0, 1e3, default=0.1)
    rise: float = number(0, 1, default=1.0)

    def __post_init__(self) -> None:
        normalised(self)


class LoopControl(StepControl):
    """A step control that estimates the stable step at rest alone: in a loop there is no time for
    it, and SAFETY leaves room for what a load changes.

    A step that is too long after all ends in SolverStopped, as DIVERGED or CRUSHED_CELL. The
    viscous stress, which a few steps hardly change, is brought up to date once in UPDATE of the
    `steps` of a frame at most, for that costs as much as three steps.
    """

    def __init__(self, leapfrog: Leapfrog, safety: float, steps: int) -> None:
        super().__init__(leapfrog, safety)
        self.frame_steps = steps

    def stride(self, dt: float) -> int:
        """Steps of dt seconds for which the viscous stress may stand still."""
        return max(super().stride(dt), min(UPDATE, self.frame_steps))

    def refresh(self, pace: Pace, state: SolverState) -> None:
        """Leave the critical step as it is, and compare with the present state from now on."""
        force = self.leapfrog.force
        if self.is_stale(pace):
            pace.estimated_J, pace.estimated_stiffening = force.min_J, force.stiffening


class FrameLoop:
    """The FEM as a fem.online.stepper.Stepper, warm-started from frame to frame.

    mesh: a HexMesh in m; without a node grid it takes forces (N, 3) alone, and no coarse mesh
    interval: s, the frame of the settings

    The frame's steps are of equal length. Where that is beyond the stable step the mass is scaled
    up, just enough. Attributes: solver, mass_scaling, and damping_rate in 1/s. `step` raises
    SolverStopped where the FEM cannot go on.
    """

    def __init__(self, mesh: HexMesh, material: Hyperelastic, settings: LoopSettings) -> None:
        self.mesh, self.settings, self.interval = mesh, settings, settings.frame
        self.grid = mesh.grid
        simulated, self.transfer = loop_mesh(mesh, settings)
        material = loop_material(mesh, simulated, material)
        longest = SAFETY * _solver(simulated, material, settings).critical_step
        self.mass_scaling = max(1.0, (settings.frame / settings.steps / longest) ** 2)
        self.damping_rate = settings.damping / (longest * np.sqrt(self.mass_scaling))
        self.solver = _solver(
            simulated,
            material,
            settings,
            damping=self.damping_rate,
            mass_scaling=self.mass_scaling,
            control=partial(LoopControl, steps=settings.steps),
        )
        self.load = np.zeros((3, simulated.n_nodes))  # N, the last force
        self._rest = self.state()

    def reset(self) -> None:
        """Back to rest."""
        self.restore(self._rest)

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, one frame after the call before, under `force` in mN; both
        (N, 3) or on the node grid (nx, ny, nz, 3).

        Raises InputError for another shape or dt and values that are not finite, SolverStopped
        where the FEM stops.
        """
        check_interval(self.interval, dt)
        force, grid = as_field(force), self.grid
        if grid is None or grid.is_nodal(force):
            return self._step(check_nodal(force, self.mesh.n_nodes))
        return grid.to_grid(self._step(grid.from_grid(force)))

    def _step(self, force):
        """Displacement (N, 3) mm under the force (N, 3) mN."""
        old, new = self.load, self._to_mesh(force)
        change, start = new - old, self.solver.time
        rise = self.settings.rise * self.settings.frame
        self.load = new
        self.solver.advance(
            self.settings.frame,
            lambda t: old + min(1.0, (t - start) / rise) * change if rise else new,
            steps=self.settings.steps,
        )
        return self._from_mesh(self.solver.u)

    def state(self) -> State:
        """A copy of all that the next answer depends on besides the next force."""
        return self.solver.snapshot() | {"load": self.load.copy()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another loop."""
        if (
            not isinstance(state, dict)
            or "load" not in state
            or np.shape(state["load"]) != self.load.shape
        ):
            raise InputError(
                "the state is not of this loop; restore one of the same mesh and settings"
            )
        self.solver.restore({name: array for name, array in state.items() if name != "load"})
        self.load = np.array(state["load"])

    def _to_mesh(self, force):
        nodal = force.T * (1 / MN)  # (3, N) N
        return nodal if self.transfer is None else (self.transfer.T @ nodal.T).T

    def _from_mesh(self, u):
        if self.transfer is not None:
            u = np.where(self.mesh.fixed, 0.0, (self.transfer @ u.T).T)
        return (u.T * MM).astype(np.float32)


def longest_step(mesh: HexMesh, material: Hyperelastic, settings: LoopSettings) -> float:
    """The longest step in s that this element takes at rest with the true mass."""
    simulated, _ = loop_mesh(mesh, settings)
    material = loop_material(mesh, simulated, material)
    return SAFETY * _solver(simulated, material, settings).critical_step


def _solver(mesh, material, settings, **options):
    return Solver(
        mesh,
        material,
        settings.element,
        "float32",
        settings.hourglass_stiffness,
        **options,
    )


def loop_mesh(
    mesh: HexMesh, settings: LoopSettings
) -> tuple[HexMesh, scipy.sparse.csr_matrix | None]:
    """(HexMesh, A or None) that a loop simulates, see `coarse_mesh`."""
    return coarse_mesh(mesh) if settings.coarse else (mesh, None)


def loop_material(mesh: HexMesh, simulated: HexMesh, material: Hyperelastic) -> Hyperelastic:
    """The law of the mesh that a loop simulates, from that of `mesh`: where it is a coarse mesh, a
    parameter with one value a cell is the mean over the volume of `mesh` in the coarse cell."""
    if simulated is mesh:
        return material
    low, size = mesh.points.min(axis=0), np.ptp(mesh.points, axis=0)
    planes = [np.unique(((simulated.points - low) / size)[:, i].round(9)) for i in range(3)]

    def places(points):  # (3, ...) which of the planes lie below the points (..., 3)
        x = np.moveaxis((points - low) / size, -1, 0)
        return tuple(np.searchsorted(plane, xi) for plane, xi in zip(planes, x, strict=True))

    number = np.full([len(plane) + 1 for plane in planes], -1)
    number[places(simulated.points[simulated.cells].mean(axis=1))] = np.arange(simulated.n_cells)
    corners = mesh.points[mesh.cells]
    owner = number[places((corners + corners.mean(axis=1, keepdims=True)) / 2)]  # (E, 8) of eighths
    fine, eighth = np.nonzero(owner >= 0)
    volume = element.gauss_volumes(mesh.points, mesh.cells)[fine, eighth]
    inside = scipy.sparse.csr_matrix(
        (volume, (owner[fine, eighth], fine)), (simulated.n_cells, mesh.n_cells)
    )
    share = scipy.sparse.diags(1 / np.ravel(inside.sum(axis=1)))
    return material.averaged((share @ inside).tocsr())


def coarse_mesh(mesh: HexMesh) -> tuple[HexMesh, scipy.sparse.csr_matrix]:
    """(HexMesh, A): a tumour or box with half as many cells along each axis, and displacement from
    its nodes to those of `mesh`, (N, n) sparse.

    An odd number of cells rounds to even, the cells then are no cubes; along the third axis the
    layers between two levels of the surface are halved by themselves, so that every level stays
    where it is: the tumour's five full layers become two, and its bump of one layer stays one, so
    that the stable step grows by a third only. Of the coarse grid those cells are kept that are at
    least half full; a node is held if the node of `mesh` next to it is, and a cell is in a set if
    more than half of what fills it is. A is trilinear interpolation, and its transpose takes forces
    the other way; beside the coarse mesh, where a step has been rounded off, displacement is that
    of the coarse nodes near by. Raises InputError for a mesh that lies on no node grid, or too
    little of which would be left.
    """
    if mesh.grid is None:
        raise InputError(
            "a coarse mesh is made on the node grid, and this mesh does not lie on one;"
            " set coarse = False or take mesh.kind = 'tumour' or 'box'"
        )
    low, size = mesh.points.min(axis=0), np.ptp(mesh.points, axis=0)
    halves, planes, heights = _halved(mesh)
    shape = (*halves, planes[-1])
    even = planes / planes[-1] * size[2] + low[2]  # heights of a grid of equal layers
    points = np.column_stack([mesh.points[:, :2], np.interp(mesh.points[:, 2], heights, even)])
    embedding = Embedding(replace(mesh, points=points), tuple(n + 1 for n in shape))
    filled = embedding.filled()
    keep = filled >= 0.5 - 1e-9
    cubes = from_voxels(keep.reshape(shape), 1.0, "none")
    places = low + cubes.points * size / shape  # in the grid of equal layers
    _, nearest = scipy.spatial.cKDTree(points).query(places)
    coarse = replace(
        cubes,
        points=np.column_stack([places[:, :2], np.interp(places[:, 2], even, heights)]),
        fixed=mesh.fixed[nearest],
        cell_sets={
            name: (embedding.filled(chosen) > (0.5 + 1e-9) * filled)[keep]
            for name, chosen in mesh.cell_sets.items()
        },
    )
    kept = np.searchsorted(_index(embedding.grid_mesh), _index(coarse))
    A = embedding.to_mesh_matrix[:, kept].tocsr()
    weight = np.asarray(A.sum(axis=1)).ravel()
    if not weight.all():
        raise InputError(
            f"node {int(weight.argmin())} of the mesh lies beside what is left of it on half as"
            " many cells; set coarse = False"
        )
    return coarse, scipy.sparse.diags(1 / weight) @ A


def _index(mesh):
    """Places of the nodes in the mesh's own node grid."""
    return mesh.grid.index


def _halved(mesh):
    """(numbers of coarse cells along x and y, coarse layers below each level of the surface, their
    heights in m); bottom and top are levels too."""
    places = np.stack(np.unravel_index(mesh.grid.index, mesh.grid.shape), axis=1)
    layer = places[:, 2]
    faces = layer[mesh.contact_faces]
    flat = faces[np.ptp(faces, axis=1) == 0]
    levels = np.unique([layer.min(), *flat.ravel(), layer.max()])
    planes = np.cumsum([0, *(_half(n) for n in np.diff(levels))])
    heights = [mesh.points[layer == level, 2].min() for level in levels]
    return tuple(_half(n) for n in np.ptp(places[:, :2], axis=0)), planes, np.array(heights)


def _half(n):
    return max(1, round(int(n) / 2))
