"""Quasi-static motion of a hexahedral mesh under nodal loads: equilibrium step by step, implicit in
time, without inertia."""

from collections.abc import Sequence

import numpy as np

from fem.errors import SolverStopped, Stop
from fem.material.base import Hyperelastic, shear_modulus
from fem.mesh.hexmesh import HexMesh
from fem.online.stepper import check_state
from fem.ranges import checked
from fem.solver.body import DeformableBody
from fem.solver.gate import Gate
from fem.solver.load_ramp import NodalLoad, checked_duration, first_load
from fem.solver.load_steps import LoadSteps
from fem.solver.record import Energies, Observer, Step
from fem.solver.search import EquilibriumSearch

TOLERANCE = 1e-3
FINEST = {"float32": 1e-5, "float64": 1e-9}  # tolerances that rounding leaves room for
# share of the largest load so far by which a residual is measured at least, for a load that goes
FADED = 0.03
FAINT = 1e-6  # the same of mu h^2 with the edge h of a cell, for a load that has yet to come
# times the tolerance is enough for a step within an `advance`: only what relaxes there is kept
WITHIN = 10.0


class QuasiStatic(DeformableBody):
    """One quasi-static simulation: the tissue is in equilibrium with its load at the end of every
    step, and over each its elastic stress runs as if it were linear tissue.

    mesh, material, element, precision, hourglass_stiffness, allow_locking: see
    fem.solver.body.DeformableBody
    tolerance: largest residual over load, as norms over the free nodes

    `u` is the displacement (3, N) in m at `time` (s), after `steps` steps. `gate` looks on as in
    fem.solver.explicit.Solver; `snapshot` and `restore` keep a run and go on from it. A run that
    cannot go on raises SolverStopped, whose `reason` is the fem.errors.Stop NOT_IN_EQUILIBRIUM or
    what the observers give; it then stands at the last equilibrium, and may go on from there under
    another load.

    Inertia is left out: docs/fem.md has the error of faster and faster pushes.
    """

    damping, mass_scaled = 0.0, False

    def __init__(
        self,
        mesh: HexMesh,
        material: Hyperelastic,
        element: str = "full",
        precision: str = "float64",
        hourglass_stiffness: float = 0.2,
        tolerance: float = TOLERANCE,
        allow_locking: bool = False,
    ) -> None:
        super().__init__(mesh, material, element, precision, hourglass_stiffness, allow_locking)
        checked("solver.tolerance", tolerance, FINEST[precision], 0.1)
        self.tolerance = float(tolerance)
        self.search = EquilibriumSearch(mesh, material, element, hourglass_stiffness)
        self.gate: Gate | None = Gate()
        self.u, self.load, self.internal = np.zeros((3, 3, mesh.n_nodes))
        self.load_steps = LoadSteps(material.prony, self.u.shape)
        self.time, self.steps = 0.0, 0
        self.largest_load, self.min_J = 0.0, 1.0  # N, norm over the free nodes; of the last state
        self.viscous_work = 0.0  # J, of the steps at which observers looked
        self._faint = FAINT * np.mean(shear_modulus(material))
        self._faint *= (mesh.volume() / mesh.n_cells) ** (2 / 3)
        self._velocity = np.zeros_like(self.u)  # m/s, over the last step
        # of the present state, where observers have asked for them
        self._energies: Energies | None = None
        self._viscous: np.ndarray | None = None

    def advance(self, duration: float, load: NodalLoad, observers: Sequence[Observer] = ()) -> None:
        """Go on for `duration` seconds under the nodal force `load(t)` (3, N) in N.

        It takes one step, or as many as it needs for the remembered load to run linearly over each,
        see fem.solver.load_steps. A load that jumps at the start comes in a step of no length to
        speak of.

        observers: each is called with the fem.solver.record.Step of the start of every step, and
        with one of no length at the end of the last.

        Raises InputError for a duration that is negative or not finite and for a load of another
        shape, before anything has changed, and SolverStopped where no equilibrium is found.
        """
        checked_duration(duration)
        first = first_load(load, self.time, self.u.shape)
        end = self.time + duration
        if not duration:
            return
        jumps = self._norm(first - self.load) > self.tolerance * self._scale(first)
        way = self.load, first if jumps else None
        begin, memory = self.time, self.load_steps.state()
        try:
            for step in self.load_steps.plan(load, begin, end, *way):
                self._step(step, observers, self.tolerance * (1 if step.time == end else WITHIN))
        except SolverStopped:
            self.load_steps.restore(memory)
            if self.time > begin:
                self.load_steps.plan(load, begin, self.time, *way)
            self.search.anderson.clear()
            raise
        looking: list[Observer] = [*observers, *([self.gate] if self.gate else [])]
        if looking:
            closing = self._record(0.0, np.zeros_like(self.u), True)
            for observer in looking:
                observer(closing)

    def _step(self, step, observers, tolerance):
        """Take a LoadStep."""
        time, load, *_ = step
        dt = time - self.time
        self.largest_load = max(self.largest_load, self._norm(load))
        u = self._equilibrium(step, tolerance)
        velocity = (u - self.u) / dt
        if observers:
            opening = self._record(dt, velocity, False)
            for observer in observers:
                observer(opening)
        before = self._viscous_force() if observers else None
        self.force.relax(dt)
        self.internal = self.force(u)
        self.min_J = self.force.min_J
        old, self.u, self.load = self.u, u, load
        self.time, self.steps, self._velocity = time, self.steps + 1, velocity
        self._energies = self._viscous = None
        if before is not None:
            mean = (before + self._viscous_force()) / 2
            self.viscous_work += float(np.vdot(mean, self.u - old))

    def _viscous_force(self):
        """The part of the internal force that relaxation makes, (3, N) N; None without it."""
        if self._viscous is None and self.material.prony:
            self._viscous = self.internal - self.elastic_force(self.u)
        return self._viscous

    def _equilibrium(self, step, tolerance):
        """The displacement (3, N) in equilibrium at the end of a LoadStep. Raises SolverStopped."""
        elapsed, scale, search = step.time - self.time, self._scale(step.load), self.search
        bends = [None if bend is None else search.linear_answer(bend) for bend in step.bends]
        left = self.force.expect(elapsed, bends)
        loads = self.load / left, step.load / left
        u, residual = search.find(
            self.force, self.u, step.change, loads, tolerance * scale / left, (elapsed, bends)
        )
        if not residual * left <= tolerance * scale:
            raise SolverStopped.because(
                Stop.NOT_IN_EQUILIBRIUM,
                f"the residual is {residual * left / scale:.2g} of the load at {step.time:.4g} s,"
                f" and {tolerance:g} was asked for",
            )
        return u

    def _norm(self, force):
        return float(np.linalg.norm(force[:, ~self.held]))

    def _scale(self, load):
        """What a residual is measured by, N."""
        return max(self._norm(load), FADED * self.largest_load, self._faint)

    def _record(self, dt, velocity, last):
        """The Step of dt seconds from the present state, at which `velocity` begins."""
        return Step(
            self.time,
            dt,
            self.steps,
            self.u,
            self._velocity,
            velocity,
            self.load,
            self.internal,
            self.min_J,
            last or not self.steps,
            last,
            self,
        )

    def kinetic_energy(self, velocity: np.ndarray) -> float:
        """None: there is no inertia."""
        return 0.0

    def energies(self, u: np.ndarray, velocity: np.ndarray) -> Energies:
        """The Energies of the present displacement."""
        if self._energies is None:
            strain, hourglass = self.elastic_force.energies(u)
            self._energies = Energies(0.0, strain, hourglass, self.viscous_work)
        return self._energies

    def snapshot(self) -> dict[str, np.ndarray]:
        """A copy of all that the run depends on from here, as arrays by name."""
        return (
            {name: np.array(getattr(self, name)) for name in _KEPT}
            | {f"force.{name}": array for name, array in self.force.state().items()}
            | {f"search.{name}": array for name, array in self.search.state().items()}
            | {f"load.{name}": array for name, array in self.load_steps.state().items()}
        )

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Go on from what `snapshot` gave. Raises InputError for that of another solver."""
        here = self.snapshot()
        check_state(snapshot, here, finite=False)
        for name in _KEPT:
            value = np.array(snapshot[name])
            setattr(self, name, value if value.ndim else value.item())
        self._energies = self._viscous = None
        for part, owner in (
            ("force.", self.force),
            ("search.", self.search),
            ("load.", self.load_steps),
        ):
            owner.restore(
                {
                    name.removeprefix(part): array
                    for name, array in snapshot.items()
                    if name.startswith(part)
                }
            )


_KEPT = (
    "u",
    "load",
    "internal",
    "time",
    "steps",
    "largest_load",
    "min_J",
    "viscous_work",
    "_velocity",
)
