"""Groups of a mesh's cells that take parameters of their own in place of the material's."""

import dataclasses
from typing import Any

import numpy as np

from fem import settings
from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.material.kinds import KINDS
from fem.mesh.hexmesh import HexMesh

Groups = dict[str, dict[str, Any]]  # {name of a cell set: {parameter: value}}


def split_table(table: dict[str, Any]) -> tuple[dict[str, Any], Groups]:
    """A scene's [material] as the table of its law and {group: table} of the tables in it."""
    parameters = {field.name for law in KINDS.values() for field in dataclasses.fields(law)}
    groups = {
        name: value
        for name, value in table.items()
        if isinstance(value, dict) and name not in parameters | {"kind"}
    }
    return {name: value for name, value in table.items() if name not in groups}, groups


def check_groups(material: Hyperelastic, groups: Groups) -> Groups:
    """`groups` by name, with values of the types that the law keeps.

    Raises InputError for a parameter that the law does not have or that all cells share, and for a
    value that no tissue has.
    """
    found = {}
    for group in sorted(groups):
        changes, where = groups[group], f"material.{group}"
        rest = _parameters(material)
        if group in rest or group == "kind":
            raise InputError(f"the cell group '{group}' has the name of a parameter; rename it")
        if not isinstance(changes, dict):
            raise InputError(f"'{where}' must be a table, not {changes!r}")
        for shared in sorted({"kind", "prony"} & changes.keys()):
            raise InputError(
                f"{where}.{shared} has no meaning, for all cells share it; leave it out"
            )
        try:
            law = settings.build(type(material), rest | changes, where)
        except InputError as error:
            named = where in str(error)
            raise InputError(f"{error}" if named else f"cell group '{group}': {error}") from None
        found[group] = {name: getattr(law, name) for name in rest if name in changes}
        for name, value in found[group].items():
            if isinstance(value, tuple) and len(value) != len(rest[name]):
                raise InputError(
                    f"{where}.{name} has {len(value)} entries; give {len(rest[name])}, as the rest"
                    " of the material has"
                )
    return found


def by_cells(material: Hyperelastic, mesh: HexMesh, groups: Groups) -> Hyperelastic:
    """The law of `mesh` in which the cells of each group take its parameters: one value a cell,
    (E,), of those that differ, and `material` itself where none does.

    Raises InputError for a group that is no cell set of the mesh, and for groups that share cells.
    """
    law: Any = material
    parameters: dict[str, Any] = {}
    taken = np.zeros(mesh.n_cells, bool)
    for group, changes in groups.items():
        cells = _cells(mesh, group)
        if (both := taken & cells).any():
            raise InputError(
                f"cell {both.argmax()} is in '{group}' and in another group of [material]; take"
                " sets that share no cell"
            )
        taken |= cells
        for name, value in changes.items():
            before = parameters.get(name, getattr(law, name))
            parameters[name] = _joined(before, value, cells)
    return dataclasses.replace(law, **parameters) if parameters else law


def _parameters(material):
    """{name: value} of a law."""
    if not dataclasses.is_dataclass(material):
        raise InputError(
            f"cell groups need a law that is a dataclass, and {type(material).__name__} is none"
        )
    return {field.name: getattr(material, field.name) for field in dataclasses.fields(material)}


def _cells(mesh, group):
    if group not in mesh.cell_sets:
        have = ", ".join(mesh.cell_sets) or "none"
        raise InputError(
            f"[material.{group}] is for the cell set '{group}', and the mesh has no such set; it"
            f" has {have}"
        )
    return mesh.cell_sets[group]


def _joined(rest, own, cells):
    """`own` in `cells` and `rest` elsewhere: one value where all are equal, else one a cell."""
    if isinstance(rest, tuple):
        return tuple(_joined(*pair, cells) for pair in zip(rest, own, strict=True))
    values = np.where(cells, own, rest)
    return float(values[0]) if (values == values[0]).all() else values
