"""The quasi-static solver as a loop: a force comes now and then, equilibrium with it answers."""

import numpy as np

from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh, checked_mesh
from fem.online.grid import MM, MN
from fem.online.stepper import State, as_field, check_interval, check_nodal, check_state
from fem.solver.quasistatic import TOLERANCE, QuasiStatic


class QuasiStaticLoop:
    """The quasi-static FEM as a fem.online.stepper.Stepper, for calls at any intervals.

    mesh: a HexMesh in m; without a node grid it takes forces (N, 3) alone
    element, precision, hourglass_stiffness, tolerance: see fem.solver.quasistatic.QuasiStatic

    The force runs linearly from the last call to this one. `step` raises SolverStopped where there
    is no equilibrium; the loop then stands where it was, and takes another force.
    """

    interval = None

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        element: str = "full",
        precision: str = "float32",
        hourglass_stiffness: float = 0.2,
        tolerance: float = TOLERANCE,
    ) -> None:
        self.mesh, self.grid = mesh, checked_mesh(mesh).grid
        self.solver = QuasiStatic(
            mesh, material, element, precision, hourglass_stiffness, tolerance
        )
        self.solver.gate = None
        self.load = np.zeros_like(self.solver.u)  # N, the last force
        self._rest = self.state()

    def reset(self) -> None:
        """Back to rest."""
        self.restore(self._rest)

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, under `force` in mN that has come dt seconds after the call
        before; both (N, 3) or on the node grid (nx, ny, nz, 3).

        Raises InputError for another shape, values that are not finite and a dt that is not
        positive, SolverStopped where no equilibrium is found.
        """
        check_interval(self.interval, dt)
        force, grid = as_field(force), self.grid
        if grid is None or grid.is_nodal(force):
            return self._step(check_nodal(force, self.mesh.n_nodes), dt)
        return grid.to_grid(self._step(grid.from_grid(force), dt))

    def _step(self, force, dt):
        """Displacement (N, 3) mm under the force (N, 3) mN."""
        old, new, start = self.load, force.T * (1 / MN), self.solver.time
        self.solver.advance(dt, lambda t: old + (t - start) / dt * (new - old))
        self.load = new
        return (self.solver.u.T * MM).astype(np.float32)

    def state(self) -> State:
        """A copy of all that the next answer depends on besides the next force."""
        return self.solver.snapshot() | {"last": self.load.copy()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another loop."""
        check_state(state, self.state(), finite=False)
        self.solver.restore({name: array for name, array in state.items() if name != "last"})
        self.load = np.array(state["last"])
