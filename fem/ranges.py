"""The numbers that a setting may take, said once beside its field; the messages come from there.

    mass_scaling: float = number(1e-3, 1e8, default=1.0)
    radius: tuple[float, float] = number(1e-6, 1.0, "m", ascending=True)
    prony: tuple[tuple[float, float], ...] = numbers(Range(1e-9, 1), Range(1e-9, 1e9, "s"))

A number without a range of its own must be finite and below 1e15.
"""

import dataclasses
import difflib
import inspect
import reprlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from fem.errors import InputError


@dataclass(frozen=True)
class Range:
    """From `low` to `high`, both included; a range of infinite ends takes infinity, none takes NaN.

    ascending: of several numbers none may be below the one before.
    """

    low: float
    high: float
    unit: str = ""
    ascending: bool = False

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.high == np.inf:
            return f"at least {_text(self.low)}{unit}"
        return f"from {_text(self.low)} to {_text(self.high)}{unit}"


ANY = Range(-1e15, 1e15)
KEY = "range"  # in the metadata of a field
_SHORT = reprlib.Repr()
_SHORT.maxlist = _SHORT.maxtuple = 6
_SHORT.maxother = 60


def number(
    low: float, high: float, unit: str = "", *, ascending: bool = False, **options: Any
) -> Any:
    """A dataclass field whose numbers, one or several, lie from `low` to `high`; options: of
    dataclasses.field."""
    return dataclasses.field(metadata={KEY: Range(low, high, unit, ascending)}, **options)


def numbers(*columns: Range, **options: Any) -> Any:
    """A dataclass field of rows of numbers, each column with a Range of its own."""
    return dataclasses.field(metadata={KEY: columns}, **options)


def check_fields(settings: Any, where: str = "") -> None:
    """Raises InputError for a number of the dataclass `settings` outside the range of its field.

    where: name of its table, for messages.
    """
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name, None)
        if isinstance(value, (int, float, tuple, list, np.ndarray, np.generic)):
            name = f"{where}.{field.name}" if where else field.name
            check(name, value, field.metadata.get(KEY, ANY))


def check(name: str, value: Any, allowed: Range | tuple[Range, ...]) -> None:
    """Raises InputError unless the number `value`, or each of a list or array of them, is allowed;
    texts and flags are left to others."""
    if isinstance(allowed, tuple):
        for i, row in enumerate(value):
            for column, (item, own) in enumerate(zip(row, allowed, strict=True), 1):
                if not _holds(item, own):
                    raise InputError(
                        f"{name}[{i}] = {shown(row)} must have number {column} {own};"
                        " leave the row out to switch it off"
                    )
    elif not _holds(value, allowed):
        if isinstance(value, np.ndarray) or np.ndim(value) and len(value) > 3:
            wrong = next(i for i, item in enumerate(value) if not _holds(item, allowed))
            name, value = f"{name}[{wrong}]", value[wrong]
        several = "numbers " if np.ndim(value) else ""
        raise InputError(f"{name} = {shown(value)} must be {several}{allowed}")
    elif allowed.ascending and (np.diff(value) < 0).any():
        raise InputError(f"{name} = {shown(value)} must be numbers from low to high")


def checked(
    name: str, value: Any, low: float, high: float, unit: str = "", whole: bool = False
) -> Any:
    """`value`, if it is one real number from `low` to `high`, and a whole one if asked for. Raises
    InputError otherwise; for what a function is given, which has no table."""
    if not isinstance(value, Integral if whole else Real) or isinstance(value, bool):
        what = "a whole number" if whole else "a number"
        raise InputError(f"{name} = {shown(value)} must be {what} {Range(low, high, unit)}")
    check(name, value, Range(low, high, unit))
    return value


def checked_array(
    name: str,
    value: Any,
    shape: tuple[int | None, ...],
    low: float = -1e300,
    high: float = 1e300,
    whole: bool = False,
) -> np.ndarray:
    """`value` as an array, if it is one of real numbers from `low` to `high`, whole ones if asked
    for, and of this shape, with None for any length. Raises InputError otherwise."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        array = np.asarray(None)
    fits = array.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype.kind not in ("iu" if whole else "fiu"):
        sizes = ", ".join("any" if n is None else str(n) for n in shape)
        what = "whole" if whole else "real"
        raise InputError(
            f"{name} = {shown(value)} must be {what} numbers of shape"
            f" ({sizes}{',' * (len(shape) == 1)})"
        )
    if not ((array >= low) & (array <= high)).all():
        raise InputError(f"{name} = {shown(value)} must be finite numbers {Range(low, high)}")
    return array


def check_distinct(name: str, values: Iterable) -> None:
    """Raises InputError for a value that is there twice."""
    seen = set()
    for value in values:
        if value in seen:
            raise InputError(f"{name} has {shown(value)} twice; give each once")
        seen.add(value)


def takes(function: Callable, given: Mapping[str, Any], what: str, before: int = 1) -> None:
    """Raises InputError for a keyword among `given` that `function` does not take, with the nearest
    that it does, and where one is missing; what: has these keywords, for the message; before: how
    many other arguments it gets."""
    own = inspect.signature(function).parameters
    if any(one.kind in (one.VAR_KEYWORD, one.VAR_POSITIONAL) for one in own.values()):
        return
    for name in given:
        if name not in own:
            near = difflib.get_close_matches(name, own, n=1, cutoff=0.0)
            nearest = f"; the nearest it has is '{near[0]}'" if near else ""
            raise InputError(f"{what} has no setting '{name}'{nearest}")
    for name, one in list(own.items())[before:]:
        if one.default is one.empty and name not in given:
            raise InputError(f"{what} needs '{name}'; give it")


def shown(value: Any) -> str:
    """`value` on one short line, for messages."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, tuple):
        value = [item.tolist() if isinstance(item, np.ndarray) else item for item in value]
    return " ".join(_SHORT.repr(value).split())


def _holds(value, allowed):
    if isinstance(value, (str, bool, np.bool_)) or value is None:
        return True
    if isinstance(value, (tuple, list)):
        return all(_holds(item, allowed) for item in value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind not in "fiu" or bool(
            np.all((value >= allowed.low) & (value <= allowed.high))
        )
    if isinstance(value, (int, float, np.number)):
        return bool(allowed.low <= value <= allowed.high)
    return True


def _text(end):
    return str(end) if isinstance(end, int) else f"{end:g}"
