"""TOML into frozen dataclasses, strictly: an unknown key, a wrong type or a number out of range is
an error that names it.

Ranges stand beside the fields, see fem.ranges; what depends on several fields is judged in the
dataclass's `__post_init__`.
"""

import dataclasses
import difflib
import os
import tomllib
import types
import typing
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fem.errors import InputError
from fem.files import checked_path
from fem.ranges import ANY, KEY, check, check_fields, shown


def read_toml(path: str | Path) -> dict[str, Any]:
    """The TOML file at `path` as nested dicts. Raises InputError if missing or malformed."""
    path = checked_path(path)
    if not path.is_file():
        near = sorted(path.parent.glob("*.toml")) if path.parent.is_dir() else []
        hint = f"; beside it are {', '.join(p.name for p in near)}" if near else ""
        raise InputError(f"no configuration file {path}{hint}")
    try:
        return tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path} is not valid TOML: {error}") from None


def parse_overrides(words: Iterable[str]) -> dict[str, Any]:
    """['train.epochs=3', 'name=a'] as nested dicts; values are TOML, bare words are strings."""
    tree: dict[str, Any] = {}
    for word in words:
        key, sign, text = word.partition("=")
        if not sign or not key:
            raise InputError(f"'{word}' is not of the form key=value, as in train.epochs=10")
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            value = text
        node = tree
        *parents, leaf = key.split(".")
        for parent in parents:
            node = node.setdefault(parent, {})
            if not isinstance(node, dict):
                raise InputError(
                    f"'{word}' goes below '{parent}', which was given a value of its own"
                )
        node[leaf] = value
    return tree


def merge(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`base` with `changes` laid over it, table by table."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        merged[key] = (
            merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
        )
    return merged


def build(cls: type, tree: dict[str, Any], where: str = "") -> Any:
    """Dataclass `cls` from nested dicts. Raises InputError naming an unknown, missing or mistyped
    key."""
    if not isinstance(tree, dict):
        raise InputError(f"'{where}' must be a table, not {tree!r}")
    if hasattr(cls, "arranged"):  # its file is laid out otherwise than its fields
        tree = cls.arranged(tree)
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    hints = typing.get_type_hints(cls)
    for key in tree:
        if key not in fields:
            near = difflib.get_close_matches(key, fields, n=1, cutoff=0.0)
            raise InputError(
                f"unknown key '{_join(where, key)}'; the nearest valid one is"
                f" '{_join(where, near[0])}'"
            )
    values = {}
    for name, field in fields.items():
        if name in tree and "build" in field.metadata:  # a field that knows its kinds by itself
            values[name] = field.metadata["build"](tree[name], _join(where, name))
        elif name in tree:
            values[name] = _convert(tree[name], hints[name], _join(where, name))
            check(_join(where, name), values[name], field.metadata.get(KEY, ANY))
            if values[name] == () != field.default:
                raise InputError(f"{_join(where, name)} = [] is empty; give at least one")
    for name, field in fields.items():
        bare = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if bare and name not in values:
            raise InputError(f"'{_join(where, name)}' is missing")
    return cls(**values)


def normalised(settings: Any, where: str = "") -> None:
    """Turn each field of a frozen dataclass into the type that its annotation names, within the
    range that its field names; where: of its table, for messages.

    Call it first in `__post_init__`: `normalised(self)`. An int becomes a float, a list or an array
    a tuple, a NumPy scalar a plain value, so that equal settings are equal however they were built.
    """
    hints = typing.get_type_hints(type(settings))
    for field in dataclasses.fields(settings):
        if field.init:
            name = _join(where, field.name)
            value = _convert(getattr(settings, field.name), hints[field.name], name)
            object.__setattr__(settings, field.name, value)
    check_fields(settings, where)


def refuse_unused(settings: Any, names: Iterable[str], where: str, reason: str) -> None:
    """Raises InputError for one of the fields `names` that is not at its default, because it means
    nothing there: what is dropped without a word would still tell equal settings apart.

    where: name of the table; reason: what it means nothing for, such as "mesh.kind = 'box'".
    """
    for name, usual in defaults(type(settings), names).items():
        if (value := getattr(settings, name)) != usual:
            raise InputError(
                f"{_join(where, name)} = {shown(value)} has no meaning for {reason}; leave it out"
            )


def defaults(cls: type, names: Iterable[str]) -> dict[str, Any]:
    """{name: default} of the fields `names` of a dataclass, such as those that have no use."""
    return {field.name: field.default for field in dataclasses.fields(cls) if field.name in names}


def to_dict(config: Any) -> dict[str, Any]:
    """A dataclass as nested dicts and lists of plain values, without the entries that are None
    (TOML has no null)."""
    return _plain(config)


def dump_toml(tree: dict[str, Any]) -> str:
    """Nested dicts as TOML text; entries that are None are left out."""
    return tomli_w.dumps(_plain(tree))


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def _join(where: str, key: str) -> str:
    return f"{where}.{key}" if where else key


def _convert(value: Any, hint: Any, where: str) -> Any:
    """`value` as the annotation `hint` wants it; `where` is its name in errors."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _one_of(value, args, where)
    if hint is Any or isinstance(hint, type) and isinstance(value, hint) and hint not in _NAMES:
        return value
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return build(hint, value, where)
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if origin is typing.Literal:
        if value not in args:
            raise InputError(f"{where} = {value!r} is not one of {', '.join(map(repr, args))}")
        return args[args.index(value)]
    if origin is tuple:
        return _tuple(value, args, where)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint is str and isinstance(value, os.PathLike):
        return os.fspath(value)
    if not isinstance(value, origin or hint) or (isinstance(value, bool) and hint is not bool):
        raise InputError(
            f"{where} = {value!r} must be {_NAMES.get(hint, hint)}, not {type(value).__name__}"
        )
    return value


def _one_of(value: Any, hints: tuple, where: str) -> Any:
    """`value` as the first of the alternatives that takes it; None where it is among them."""
    if value is None and type(None) in hints:
        return None
    *others, last = [hint for hint in hints if hint is not type(None)]
    for hint in others:
        try:
            return _convert(value, hint, where)
        except InputError:
            continue
    return _convert(value, last, where)


def _tuple(value: Any, hints: tuple, where: str) -> tuple:
    if not isinstance(value, (list, tuple)):
        raise InputError(f"{where} = {value!r} must be a list")
    inner = [hints[0]] * len(value) if hints[-1] is Ellipsis else hints
    if len(inner) != len(value):
        raise InputError(f"{where} = {value!r} must have {len(inner)} entries, not {len(value)}")
    return tuple(
        _convert(item, hint, f"{where}[{i}]")
        for i, (item, hint) in enumerate(zip(value, inner, strict=True))
    )


_NAMES = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
