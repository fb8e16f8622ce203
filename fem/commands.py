"""How the command lines report errors that a user can mend."""

import errno
import functools
import os
import sys
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from fem.errors import InputError, SolverStopped

# what a user can mend about a file that a library reads or writes
_WORDS = "ENOSPC EDQUOT EFBIG EACCES EPERM EROFS ENAMETOOLONG ENOTDIR EISDIR EEXIST"
_MENDABLE = {getattr(errno, word) for word in _WORDS.split() if hasattr(errno, word)}
P = ParamSpec("P")
R = TypeVar("R")


def command_line(main: Callable[P, R]) -> Callable[P, R]:
    """Decorate a `main()` so that bad input ends in one line and exit code 2, not in a traceback.

    A run that the solver stopped ends with code 3, Ctrl-C with code 130. Whoever keeps what was
    finished raises KeyboardInterrupt("how to go on") anew; else the same command starts afresh.
    """

    @functools.wraps(main)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return main(*args, **kwargs)
        except InputError as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        except SolverStopped as error:
            print(f"stopped: {error}", file=sys.stderr)
            sys.exit(3)
        except MemoryError as error:
            print(f"error: out of memory ({error}); lower what it is for", file=sys.stderr)
            sys.exit(2)
        except BrokenPipeError:
            # whoever read the output has gone; nothing more is written, also not at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(1)
        except OSError as error:
            if error.errno not in _MENDABLE:
                raise
            where = f"{error.filename}: " if error.filename else ""
            print(
                f"error: {where}{error.strerror}; make room or give another path", file=sys.stderr
            )
            sys.exit(2)
        except KeyboardInterrupt as interrupt:
            go_on = str(interrupt) or "run the same command again"
            print(f"\ninterrupted; {go_on}", file=sys.stderr)
            sys.exit(130)

    return wrapped
