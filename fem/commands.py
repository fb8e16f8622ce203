"""How the command lines report errors that a user can mend."""

import functools
import sys

from fem.errors import InputError, SolverStopped


def command_line(main):
    """Decorate a `main()` so that bad input ends in one line and exit code 2, not in a
    traceback."""

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
            print(
                "\ninterrupted: what was finished is kept; run the same command again to go on",
                file=sys.stderr,
            )
            sys.exit(130)

    return wrapped
