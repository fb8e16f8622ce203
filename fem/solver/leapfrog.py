"""One step of the leapfrog (explicit central differences) of a hexahedral mesh under nodal
loads."""

from dataclasses import dataclass

import numpy as np

from fem.errors import InputError, Stop
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.ranges import checked, checked_array
from fem.solver.body import SMALLEST_J, DeformableBody, check_parts
from fem.solver.critical_step import lumped_mass
from fem.solver.record import Energies

NEGLIGIBLE = 1e-30  # m and m/s: subnormal numbers would slow a step sixteen-fold


@dataclass(slots=True)
class State:
    """What a step starts from, besides the stress history that the InternalForce keeps.

    u: displacement at `time`, (3, N) m; v: velocity half a step before, (3, N) m/s, or at `time`
    itself at the start
    load: nodal force at `time`, (3, N) N
    time: s; dt: length in s of the step before, zero at the start; steps: taken so far
    standing: steps for which the viscous stress still stands still; relaxed_at: s, when it was
    brought up to date
    """

    u: np.ndarray
    v: np.ndarray
    load: np.ndarray
    time: float = 0.0
    dt: float = 0.0
    steps: int = 0
    standing: int = 0
    relaxed_at: float = 0.0


class Leapfrog(DeformableBody):
    """Mesh, material and masses, and the step that they take: see fem.solver.explicit.Solver for
    the settings.

    mass, inverse_mass: of the nodes, (N,) kg and 1/kg; the inverse is zero where a node is held
    internal: internal force (3, N) N of the last step
    """

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        element: str = "full",
        precision: str = "float64",
        hourglass_stiffness: float = 0.2,
        damping: float = 0.0,
        mass_scaling: float | np.ndarray = 1.0,
        allow_locking: bool = False,
    ) -> None:
        check_parts(mesh, material)
        _check(mesh, damping, mass_scaling)
        super().__init__(mesh, material, element, precision, hourglass_stiffness, allow_locking)
        self.damping = float(damping)
        self.mass = lumped_mass(mesh, material.density * np.asarray(mass_scaling, float))
        self.mass_scaled = bool(np.max(mass_scaling) > 1)
        self.inverse_mass = np.where(mesh.fixed, 0.0, 1.0 / self.mass)
        self.internal = np.zeros((3, mesh.n_nodes))
        # a step writes to the buffer that its state does not hold
        self._u, self._v = ([np.zeros((3, mesh.n_nodes)) for _ in range(2)] for _ in "uv")

    def rest(self) -> State:
        """The undeformed state without load."""
        zero = np.zeros_like(self.internal)
        return State(zero, zero.copy(), zero.copy())

    def step(
        self, state: State, dt: float, stride: int = 1, check: bool = False
    ) -> tuple[State, Stop | None]:
        """The state dt seconds on, and why the run must stop, or None.

        The load of the new state is the array of the old: the caller changes it. The arrays u and v
        of the new state are overwritten by the step after the next.

        stride: steps for which the viscous stress may stand still when it is brought up to date
        check: whether `force.stiffening` is to be known
        """
        standing, relaxed_at = state.standing, state.relaxed_at
        if self.material.prony and standing == 0:
            standing = stride
            self.force.relax(state.time - relaxed_at, (standing - 1) * dt)
            relaxed_at = state.time
        self.force(state.u, out=self.internal, check=check)
        v = self._kick(state, dt)
        u = np.multiply(v, dt, out=self._u[state.u is self._u[0]])
        u += state.u
        new = State(
            u,
            v,
            state.load,
            state.time + dt,
            dt,
            state.steps + 1,
            max(0, standing - 1),
            relaxed_at,
        )
        J = self.force.min_J
        if J > SMALLEST_J:
            return new, None
        return new, Stop.CRUSHED_CELL if J <= SMALLEST_J else Stop.DIVERGED  # a NaN diverges

    def _kick(self, state, dt):
        """v at the next half step; the first kick is half a step long, and a change of step takes
        the mean of both."""
        kick = (state.dt + dt) / 2
        v = np.subtract(state.load, self.internal, out=self._v[state.v is self._v[0]])
        v *= self.inverse_mass
        if self.damping:
            v *= kick / (1 + self.damping * kick / 2)
            v += (1 - self.damping * kick / 2) / (1 + self.damping * kick / 2) * state.v
        else:
            v *= kick
            v += state.v
        return v

    def settle(self, state: State) -> Stop | None:
        """Flush what is too small to matter; DIVERGED where the state is not finite."""
        if not (
            np.isfinite(state.u).all()
            and np.isfinite(state.v).all()
            and np.isfinite(self.force.min_J)
        ):
            return Stop.DIVERGED
        for field in (state.u, state.v):
            field[np.abs(field) < NEGLIGIBLE] = 0.0
        return None

    def kinetic_energy(self, velocity: np.ndarray) -> float:
        """J, of the nodal velocity (3, N) in m/s."""
        return kinetic_energy(self.mass, velocity)

    def energies(self, u: np.ndarray, velocity: np.ndarray) -> Energies:
        """The Energies of displacement u (3, N) m and velocity (3, N) m/s, with the present stress
        history."""
        strain, hourglass = self.elastic_force.energies(u)
        return Energies(
            self.kinetic_energy(velocity), strain, hourglass, self.force.viscous_energy(u)
        )


def kinetic_energy(mass: np.ndarray, v: np.ndarray) -> float:
    """J, of nodal masses (N,) kg at the velocities v (3, N) m/s."""
    return 0.5 * float(np.einsum("n,cn,cn->", mass, v, v))


def _check(mesh, damping, mass_scaling):
    checked("solver.damping", damping, 0, 1e6, "1/s")
    checked_array("solver.mass_scaling", np.ravel(mass_scaling), (None,))
    if np.shape(mass_scaling) not in ((), (mesh.n_cells,)):
        raise InputError(
            f"solver.mass_scaling has shape {np.shape(mass_scaling)};"
            f" give one factor, or one for each of the {mesh.n_cells} cells"
        )
    if not (np.min(mass_scaling) >= 1 and np.max(mass_scaling) <= 1e12):
        raise InputError(
            f"solver.mass_scaling = {np.min(mass_scaling)} must be at least 1 (1 is the true mass)"
        )
