"""Explicit finite elements for viscoelastic soft tissue, in NumPy and SciPy.

    import fem
    mesh = fem.tumour()

The public names are imported from their modules when they are first asked for.
"""

from fem.former import FEM, GONE, remember
from fem.lazy import exports

__getattr__, __dir__, __all__ = exports(
    __name__,
    {
        "fem.contact.push": "Contact Load Push",
        "fem.contact.surface": "Surface",
        "fem.data.dataset": "open_dataset",
        "fem.data.scene": "Scene load_scene",
        "fem.data.simulate": "simulate",
        "fem.errors": "InputError SolverStopped Stop",
        "fem.generate": "generate",
        "fem.material.base": "Hyperelastic",
        "fem.material.mooney_rivlin": "MooneyRivlin",
        "fem.material.neo_hooke": "NeoHooke",
        "fem.material.ogden": "Ogden",
        "fem.mesh.embedding": "Embedding",
        "fem.mesh.hexmesh": "HexMesh",
        "fem.mesh.read": "read_mesh",
        "fem.mesh.shapes": "box tumour",
        "fem.online.grid": "NodeGrid",
        "fem.online.stepper": "Stepper",
        "fem.solver.energy": "EnergyLedger",
        "fem.solver.explicit": "Solver",
        "fem.solver.frame_loop": "FrameLoop LoopSettings",
        "fem.solver.quasistatic": "QuasiStatic",
        "fem.solver.quasistatic_loop": "QuasiStaticLoop",
        "fem.solver.rest": "equilibrium",
    },
)
remember(FEM, GONE)
