"""Errors that a user can mend, and the reasons for which a solver stops."""

from enum import StrEnum


class InputError(ValueError):
    """Bad input: the message is one line that names the value and the remedy."""

    def __str__(self) -> str:
        return super().__str__().replace("\n", " ")  # of a value that has line breaks


class Stop(StrEnum):
    """Why a simulation ended early, or was not fit to learn from; `remedy` says what helps."""

    DIVERGED = "diverged"
    CRUSHED_CELL = "crushed cell"
    INVERTED_CELL = "inverted cell"
    NO_STABLE_STEP = "no stable step"
    STEP_TOO_LARGE = "step too large"
    TOO_MANY_STEPS = "too many steps"
    ENERGY_IMBALANCE = "energy imbalance"
    KINETIC_ENERGY = "kinetic energy"
    CRUSHED_CORNER = "crushed corner"
    DISEQUILIBRIUM = "disequilibrium"
    HOURGLASS_MOTION = "hourglass motion"
    HOURGLASS_ENERGY = "hourglass energy"
    NOT_IN_EQUILIBRIUM = "not in equilibrium"
    NOT_AT_REST = "not at rest"
    NOT_FINITE = "not finite"

    @property
    def remedy(self) -> str:
        """What a user can do about it."""
        return _REMEDIES[self]


_REMEDIES = {
    Stop.DIVERGED: "lower the load or let it rise more slowly",
    Stop.CRUSHED_CELL: "lower the force or widen its footprint",
    Stop.INVERTED_CELL: "lower the force or widen its footprint",
    Stop.NO_STABLE_STEP: "lower the load",
    Stop.STEP_TOO_LARGE: "take more steps, lower solver.safety or raise solver.mass_scaling",
    Stop.TOO_MANY_STEPS: "repair the thinnest cell or raise solver.mass_scaling",
    Stop.ENERGY_IMBALANCE: "lower solver.safety or the load",
    Stop.KINETIC_ENERGY: "lower solver.mass_scaling or let the load rise more slowly",
    Stop.CRUSHED_CORNER: "lower the force or widen its footprint",
    Stop.DISEQUILIBRIUM: "lower solver.mass_scaling or damping, or let the load rise more slowly",
    Stop.HOURGLASS_MOTION: "refine the mesh, raise solver.hourglass_stiffness or take"
    " solver.element = 'full' or 'mean_dilatation'",
    Stop.HOURGLASS_ENERGY: "refine the mesh, lower solver.hourglass_stiffness or take"
    " solver.element = 'full' or 'mean_dilatation'",
    Stop.NOT_IN_EQUILIBRIUM: "lower the load, let it rise more slowly or raise solver.tolerance",
    Stop.NOT_AT_REST: "fix the mesh, lower the load or raise max_steps",
    Stop.NOT_FINITE: "lower the load",
}


class SolverStopped(RuntimeError):
    """The solver stopped on purpose: `reason` is a Stop, the message says what to do."""

    def __init__(self, reason: Stop | str, message: str) -> None:
        super().__init__(message)
        self.reason = Stop(reason)

    @classmethod
    def because(cls, reason: Stop, what: str) -> "SolverStopped":
        """A stop for `reason`, whose message is `what` and the remedy of the reason."""
        return cls(reason, f"{what}; {reason.remedy}")

    def __reduce__(self):  # so that it crosses from a worker process to its parent
        return type(self), (self.reason, *self.args)
