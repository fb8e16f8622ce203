"""Errors that a user can mend, and the way the command lines report them."""


class InputError(ValueError):
    """Bad input: the message is one line that names the value and the remedy."""


class SolverStopped(RuntimeError):
    """The solver stopped on purpose: `reason` is a short slug, the message says what to do."""

    def __init__(self, reason, message):
        super().__init__(message)
        self.reason = reason

    def __reduce__(self):  # so that it crosses from a worker process to its parent
        return type(self), (self.reason, *self.args)
