"""The search for the equilibrium at the end of a step, by what is cheap first."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.online.stepper import State
from fem.solver.anderson import Anderson
from fem.solver.balance import Balance, by_chords, by_newton
from fem.solver.internal_force import InternalForce
from fem.solver.stiffness import Factors, Stiffness, at_rest

# residual over load, from which the last equilibrium is a better start than the best iterate
LOST = 0.1
SMALLEST_PART = 1 / 64  # of a load that is raised in parts


class EquilibriumSearch:
    """Finds displacements in equilibrium, one after another, and learns from each for the next.

    factors: of the stiffness that chords are taken with; stiffened_at: the free displacements in m
    that it is of, zeros for rest
    anderson: the differences that accelerate them
    evaluations: of the internal force so far
    """

    def __init__(
        self, mesh: HexMesh, material: Hyperelastic, element: str, hourglass_stiffness: float
    ) -> None:
        self._kind = mesh, material, element, hourglass_stiffness
        self.equations, self._rest = at_rest(mesh, material.elastic(), element, hourglass_stiffness)
        self.factors, self.stiffened_at = self._rest, np.zeros(self.equations.size)
        self.anderson = Anderson(self.equations.size)
        self.evaluations = 0

    @cached_property
    def stiffness(self) -> Stiffness:
        """The consistent tangent, built where it is needed."""
        return Stiffness(*self._kind, self.equations)

    def linear_answer(self, load: np.ndarray) -> np.ndarray:
        """The displacement (3, N) m of the elastic tissue under a small load (3, N) N."""
        return self.equations.field(self._rest.solve(self.equations.vector(load)))

    def find(
        self,
        force: InternalForce,
        u: np.ndarray,
        change: np.ndarray,
        loads: tuple[np.ndarray, np.ndarray],
        tolerance: float,
        step: tuple[float, Sequence[np.ndarray | None]],
    ) -> tuple[np.ndarray, float]:
        """(displacement (3, N) m, residual in N) of the best that was found; the residual is at
        most `tolerance` where it is in equilibrium.

        force: of the end of the step, see InternalForce.expect; u: the last equilibrium; change: of
        the remembered load since then; loads: the last and the new, in the units of `force`, as
        `tolerance` is; step: its length in s and its bends, as `force` expects them

        It starts from the answer to the remembered load of the tissue as it is now: what was not
        linear in the last equilibrium stays.
        """
        old = self.equations.vector(u)
        start = old + self._rest.solve(self.equations.vector(change))
        balance = Balance(force, self.equations, loads[1], tolerance)
        self.anderson.begin()
        x, error = by_chords(balance, start, self.factors, self.anderson)
        if error > 1:
            lost = error * tolerance > LOST * np.linalg.norm(loads[1])
            x = old if lost else x
            if self._stiffen(x):
                x, error = by_chords(balance, x, self.factors, self.anderson)
        if error > 1:
            self.anderson.clear()
            self.stiffness.follow(force, *step)
            x, error = by_newton(balance, x, self.stiffness)
        if error > 1:
            x, error = self._in_parts(balance, old, loads[0])
        self.evaluations += balance.evaluations
        return self.equations.field(x), error * tolerance

    def _stiffen(self, x):
        """Take the stiffness of the elastic tissue at the displacements x from here on; whether it
        is regular. Chords serve as well without what has relaxed, and a state needs no more than
        x."""
        self.stiffness.force.forget()
        try:
            self.factors = Factors(self.stiffness.matrix(self.equations.field(x)))
        except RuntimeError:
            return False
        self.stiffened_at = x.copy()
        self.anderson.clear()
        return True

    def _in_parts(self, balance, x, old):
        """(x, error) by Newton's method, while the load climbs from the `old`."""
        whole, error = balance.load, np.inf
        reached, part = 0.0, 0.5
        while part >= SMALLEST_PART and reached < 1:
            goal = min(1.0, reached + part)
            balance.load = old + goal * (whole - old)
            found, error = by_newton(balance, x, self.stiffness)
            if error > 1:
                part /= 2
            else:
                x, reached, part = found, goal, 2 * part
        return x, error

    def state(self) -> State:
        """All that it has learned."""
        return self.anderson.state() | {"stiffened_at": self.stiffened_at.copy()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave."""
        at = np.array(state["stiffened_at"])
        if not at.any():
            self.factors, self.stiffened_at = self._rest, at
        elif not np.array_equal(at, self.stiffened_at):
            self._stiffen(at)
        self.anderson.restore(state)
