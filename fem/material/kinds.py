"""The laws that a scene can name."""

import dataclasses
import difflib
from typing import Any

import numpy as np

from fem import settings
from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.material.laws import KINDS

DEFAULT = "neo_hooke"  # not written, so that a scene from before there were others stays the same


def from_table(table: dict[str, Any], where: str = "material") -> Hyperelastic:
    """The law of a scene's [material]: `kind` ("neo_hooke" if left out) and its parameters.

    Raises InputError for an unknown kind, and for a parameter that the law does not have.
    """
    if not isinstance(table, dict):
        raise InputError(f"'{where}' must be a table, not {table!r}")
    kind = table.get("kind", DEFAULT)
    if not isinstance(kind, str) or kind not in KINDS:
        near = difflib.get_close_matches(str(kind), KINDS, n=1, cutoff=0.0)[0]
        raise InputError(
            f"{where}.kind = {kind!r} is not one of {', '.join(map(repr, KINDS))}; the nearest is"
            f" '{near}'"
        )
    parameters = {name: value for name, value in table.items() if name != "kind"}
    return settings.build(KINDS[kind], parameters, where)


def to_table(material: Hyperelastic) -> dict[str, Any]:
    """The [material] of which `from_table` makes this law; raises InputError for one that a file
    cannot hold."""
    kind = {law: name for name, law in KINDS.items()}.get(type(material))
    if kind is None:
        raise InputError(
            f"a scene file cannot hold a material {type(material).__name__}; use one of"
            f" {', '.join(law.__name__ for law in KINDS.values())}"
        )
    fields = [field.name for field in dataclasses.fields(KINDS[kind])]
    parameters = {name: getattr(material, name) for name in fields}
    for name, value in parameters.items():
        if any(isinstance(item, np.ndarray) for item in _leaves(value)):
            raise InputError(
                f"a scene file cannot hold material.{name} with one value a cell; give one value"
            )
    return parameters if kind == DEFAULT else {"kind": kind, **parameters}


def _leaves(value):
    if not isinstance(value, tuple):
        return [value]
    return [leaf for item in value for leaf in _leaves(item)]
