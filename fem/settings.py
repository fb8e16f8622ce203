"""TOML into frozen dataclasses, strictly: an unknown key or a wrong type is an error that names it.

Every check sits in the dataclass's `__post_init__`; here only names and types are judged.
"""

import dataclasses
import difflib
import tomllib
import types
import typing
from pathlib import Path

from fem.errors import InputError


def read_toml(path):
    """The TOML file at `path` as nested dicts. Raises InputError if missing or malformed."""
    path = Path(path)
    if not path.is_file():
        near = sorted(path.parent.glob("*.toml")) if path.parent.is_dir() else []
        hint = f"; beside it are {', '.join(p.name for p in near)}" if near else ""
        raise InputError(f"no configuration file {path}{hint}")
    try:
        return tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not valid TOML: {error}") from None


def parse_overrides(words):
    """['train.epochs=3', 'name=a'] as nested dicts; values are TOML, bare words are strings."""
    tree = {}
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


def merge(base, changes):
    """`base` with `changes` laid over it, table by table."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        merged[key] = (
            merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
        )
    return merged


def build(cls, tree, where=""):
    """Dataclass `cls` from nested dicts. Raises InputError naming an unknown, missing or mistyped
    key."""
    if not isinstance(tree, dict):
        raise InputError(f"'{where}' must be a table, not {tree!r}")
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    hints = typing.get_type_hints(cls)
    for key in tree:
        if key not in fields:
            near = difflib.get_close_matches(key, fields, n=1, cutoff=0.0)
            raise InputError(
                f"unknown key '{_join(where, key)}'; the nearest valid one is '{_join(where, near[0])}'"
            )
    values = {}
    for name, field in fields.items():
        if name in tree:
            values[name] = _convert(tree[name], hints[name], _join(where, name))
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise InputError(f"'{_join(where, name)}' is missing")
    return cls(**values)


def to_dict(config):
    """A dataclass as nested dicts and lists, without the entries that are None (TOML has no
    null)."""
    return {key: value for key, value in dataclasses.asdict(config).items() if value is not None}


def dump_toml(tree):
    """Nested dicts of plain values as TOML text (the standard library only reads TOML)."""
    lines = [
        f"{key} = {_toml(value)}" for key, value in tree.items() if not isinstance(value, dict)
    ]
    for key, value in tree.items():
        if isinstance(value, dict):
            body = dump_toml({k: v for k, v in value.items() if v is not None})
            lines += ["", f"[{key}]", body.rstrip("\n")]
    return "\n".join(lines).strip("\n") + "\n"


def _toml(value):
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    return repr(value)


def _join(where, key):
    return f"{where}.{key}" if where else key


def _convert(value, hint, where):
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if dataclasses.is_dataclass(hint):
        return build(hint, value, where)
    if origin in (typing.Union, types.UnionType):
        return _convert(value, next(arg for arg in args if arg is not type(None)), where)
    if origin is typing.Literal:
        if value not in args:
            raise InputError(f"{where} = {value!r} is not one of {', '.join(map(repr, args))}")
        return value
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            raise InputError(f"{where} = {value!r} must be a list")
        inner = [args[0]] * len(value) if args[-1] is Ellipsis else args
        if len(inner) != len(value):
            raise InputError(
                f"{where} = {value!r} must have {len(inner)} entries, not {len(value)}"
            )
        return tuple(
            _convert(item, kind, f"{where}[{i}]")
            for i, (item, kind) in enumerate(zip(value, inner))
        )
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise InputError(
            f"{where} = {value!r} must be {_NAMES.get(hint, hint)}, not {type(value).__name__}"
        )
    return value


_NAMES = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
