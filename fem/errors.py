"""Errors that a user can mend, and the way the command lines report them."""

import functools
import sys


class InputError(ValueError):
    """Bad input: the message is one line that names the value and the remedy."""


class SolverStopped(RuntimeError):
    """The solver stopped on purpose: `reason` is a short slug, the message says what to do."""

    def __init__(self, reason, message):
        super().__init__(message)
        self.reason = reason

    def __reduce__(self):  # so that it crosses from a worker process to its parent
        return type(self), (self.reason, *self.args)


def command_line(main):
    """Decorate a `main()` so that bad input ends in one line and exit code 2, not in a traceback."""

    @functools.wraps(main)
    def wrapped(*args, **kwargs):
        try:
            return main(*args, **kwargs)
        except InputError as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        except SolverStopped as error:
            print(f"stopped: {error}", file=sys.stderr)
            sys.exit(3)
        except KeyboardInterrupt:
            print("\ninterrupted: what was finished is kept; run the same command again to go on", file=sys.stderr)
            sys.exit(130)

    return wrapped
