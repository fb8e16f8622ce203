"""How much memory a step will need, said before it is taken."""

import psutil

from fem.errors import InputError


def require_memory(size: float, what: str, remedy: str = "lower it") -> None:
    """Raises InputError where `what` needs more than the free memory, with both in GB; size: bytes,
    an estimate from below."""
    free = psutil.virtual_memory().available
    if size > free:
        raise InputError(
            f"{what} needs about {_text(size)} of memory, and {_text(free)} are free; {remedy}"
        )


def _text(size):
    return f"{size / 1e9:.3g} GB"
