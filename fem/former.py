"""The import paths of version 0.1: for one release they lead to the new ones, with a warning.

A row of a table for each old module: {old module: {new module: "name other former:new"}}, where
`former:new` is a name that changed too. GONE: {old path of a name that is no more: what to use}.
"""

import importlib
import importlib.machinery
import sys
import types
import warnings
from collections.abc import Callable

LAST = "0.3"  # the release that drops the old paths
Table = dict[str, dict[str, str]]

FEM: Table = {
    "fem.config": {
        "fem.settings": "build to_dict dump_toml",
    },
    "fem.contact": {
        "fem.contact.draw": "ContactRange draw_contacts tilt",
        "fem.contact.push": "Contact Load",
        "fem.contact.surface": "Surface",
        "fem.online.contact_surface": "bump",
    },
    "fem.dataset": {
        "fem.data.dataset": "FORMAT Dataset Sequence open_dataset",
        "fem.data.write": "write_dataset",
        "fem.measure.machine": "versions",
    },
    "fem.element": {
        "fem.mesh.element": "CORNERS shape_gradients quad_shape corner_jacobians jacobians",
    },
    "fem.embedding": {
        "fem.mesh.embedding": "Embedding",
    },
    "fem.energy": {
        "fem.solver.energy": "EnergyLedger",
        "fem.solver.leapfrog": "kinetic_energy",
    },
    "fem.export": {
        "fem.data.paraview": "write_sequence cell_volumes",
    },
    "fem.interaction": {
        "fem.data.draws": "drawn_contacts",
        "fem.data.interaction": "simulate unfit healthy_interaction",
    },
    "fem.kernel": {
        "fem.solver.internal_force": "InternalForce",
        "fem.solver.relaxation": "history_coefficients",
    },
    "fem.material": {
        "fem.material.neo_hooke": "Material:NeoHooke",
    },
    "fem.mesh": {
        "fem.mesh.shapes": "TUMOUR_EDGE from_voxels box tumour",
        "fem.mesh.hexmesh": "HexMesh",
    },
    "fem.meshfile": {
        "fem.mesh.read": "read_mesh",
    },
    "fem.selection": {
        "fem.mesh.select": "select",
    },
    "fem.structure": {
        "fem.mesh.node_grid": "node_grid turn",
    },
    "fem.scene": {
        "fem.data.mesh_choice": "MeshChoice",
        "fem.data.scene": "SPLITS SolverChoice Frames Interactions Health Scene load_scene",
    },
    "fem.solver": {
        "fem.solver.explicit": "Solver",
        "fem.solver.rest": "Equilibrium equilibrium",
        "fem.solver.critical_step": "lumped_mass thickness critical_time_step",
    },
    "fem.timing": {
        "fem.measure.timing": "alternate quantiles paired_ratio",
        "fem.measure.machine": "processor",
    },
}
GONE = {
    "fem.dataset.on_grid": (
        "use force_on_grid and displacement_on_grid of fem.data.grid, one field each"
    ),
}

_homes: dict[str, dict[str, tuple[str, str]]] = {}  # old module: {name: (new module, new name)}
_gone: dict[str, str] = {}


def remember(table: Table, gone: dict[str, str]) -> None:
    """Let the old paths of `table` be imported, and those of `gone` say what to use."""
    for old, homes in table.items():
        _homes[old] = {
            name: (new, now or name)
            for new, names in homes.items()
            for name, _, now in (word.partition(":") for word in names.split())
        }
    _gone.update(gone)
    if _Finder not in sys.meta_path:
        sys.meta_path.append(_Finder)  # last, so that it is asked for nothing that exists


def moved(old: str, present: Callable[[str], object] | None = None) -> Callable[[str], object]:
    """A __getattr__ for what the old module `old` held: a DeprecationWarning names its new path.

    What is no more raises ImportError, which says what to use; other names are asked of `present`,
    the __getattr__ of the package that has taken the place of the module.
    """

    def __getattr__(name: str) -> object:
        if f"{old}.{name}" in _gone:
            raise ImportError(f"{old}.{name} is no more; {_gone[f'{old}.{name}']}", name=old)
        if name not in _homes.get(old, ()):
            if present:
                return present(name)
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        module, now = _homes[old][name]
        warnings.warn(
            f"{old}.{name} is {module}.{now} now; the old path goes in version {LAST}",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(importlib.import_module(module), now)

    return __getattr__


class _Finder:
    """Makes modules of the names that `remember` was given, and of no others."""

    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return importlib.machinery.ModuleSpec(name, cls) if name in _homes else None

    @staticmethod
    def create_module(spec):
        module = types.ModuleType(spec.name)
        module.__getattr__ = moved(spec.name)
        module.__all__ = sorted(_homes[spec.name])
        return module

    @staticmethod
    def exec_module(module):
        pass
