"""Equilibrium at the end of a step: its equation, and two ways to solve it."""

import numpy as np

from fem.solver.anderson import Anderson
from fem.solver.body import SMALLEST_J
from fem.solver.internal_force import InternalForce
from fem.solver.stiffness import Equations, Factors, Stiffness

MOST_CHORDS = 16  # iterations with one stiffness: as many as a new one costs
MOST_NEWTONS = 15
GROWTH = 3.0  # of the residual, beyond which an iterate is not followed
BACK = 0.3  # share of a step that is tried after one that went wrong
SHORTEST = 0.02  # share of a step below which it is given up


class Balance:
    """load = internal force(u), on the free nodes.

    force: of the end of the step, see InternalForce.expect; load: (3, N) in the same units
    tolerance: norm of a residual that is small enough, in the same units
    evaluations: of the force, so far
    """

    def __init__(
        self, force: InternalForce, equations: Equations, load: np.ndarray, tolerance: float
    ) -> None:
        self.force, self.equations, self.load = force, equations, load
        self.tolerance = tolerance
        self.evaluations = 0
        self._internal = np.empty_like(load)

    def residual(self, x: np.ndarray) -> tuple[np.ndarray, float]:
        """(load - internal force, its norm over the tolerance) at the free displacements x; an
        infinite norm where a cell is crushed or a number is not finite."""
        self.evaluations += 1
        with np.errstate(all="ignore"):
            self.force(self.equations.field(x), out=self._internal)
            np.subtract(self.load, self._internal, out=self._internal)
            r = self.equations.vector(self._internal)
            error = float(np.linalg.norm(r)) / self.tolerance
        sound = np.isfinite(error) and self.force.min_J > SMALLEST_J
        return r, error if sound else np.inf


def by_chords(
    balance: Balance, x: np.ndarray, factors: Factors, anderson: Anderson
) -> tuple[np.ndarray, float]:
    """(x, error): the free displacements in equilibrium, by steps with the stiffness of `factors`,
    accelerated; error: see Balance.residual, at most 1 where it came to an end.

    After a step that went wrong it goes on from the best iterate, without what it has learned.
    """
    best, least, way, share = x, np.inf, np.zeros_like(x), 1.0
    for _ in range(MOST_CHORDS):
        r, error = balance.residual(x)
        if error <= 1:
            return x, error
        if not error < GROWTH * least or not np.isfinite(error):
            if share < SHORTEST:
                break
            share *= BACK
            anderson.clear()
            x = best + share * way
            continue
        step = factors.solve(r)
        if error < least:
            best, least, way = x, error, step
        x = anderson(x, step)
    return best, least


def by_newton(balance: Balance, x: np.ndarray, stiffness: Stiffness) -> tuple[np.ndarray, float]:
    """(x, error) as `by_chords`, by Newton's method with the consistent tangent; a step is cut
    until the residual falls."""
    r, error = balance.residual(x)
    for _ in range(MOST_NEWTONS):
        if error <= 1:
            break
        try:
            matrix = stiffness.matrix(balance.equations.field(x))
            step = Factors(matrix, "float64").solve(r)
        except RuntimeError:  # singular: the tissue buckles here
            break
        share = 1.0
        while True:
            new, found = balance.residual(x + share * step)
            if found < error:
                break
            share *= BACK
            if share < SHORTEST:
                return x, error
        x, r, error = x + share * step, new, found
    return x, error
