"""One simulation without a scene: a mesh, a material and a load are enough."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fem.contact.push import Load, Push
from fem.contact.surface import surface_of
from fem.data.interaction import Frame, simulate_frames, stacked
from fem.data.scene import SOLVERS
from fem.errors import InputError
from fem.material.base import Hyperelastic
from fem.mesh.hexmesh import HexMesh
from fem.ranges import shown, takes
from fem.solver.energy import EnergyLedger
from fem.solver.load_ramp import NodalLoad


def simulate(
    mesh: HexMesh,
    material: Hyperelastic,
    push: Push | NodalLoad,
    times: Sequence[float] | np.ndarray,
    kind: str = "explicit",
    **settings: Any,
) -> Frame:
    """The tissue at `times` (s, ascending from 0 on) under a push, from rest: a Frame with the
    force (times, N, 3) mN, the displacement (times, N, 3) mm and the volume (times,) mm3.

    push: a fem.contact.push.Push, or any nodal force: called with t in s it gives (3, N) in N;
    kind: "explicit" or "quasistatic"; settings: see fem.solver.explicit.Solver or
    fem.solver.quasistatic.QuasiStatic

        push = Push(at="top", force=1e-3, radius=2e-3)
        frames = simulate(tumour(), NeoHooke(400.0, 0.42, 1000.0), push, [0.0, 0.5, 1.0])

    Raises InputError for times that do not ascend, SolverStopped where the solver cannot go on or
    its energy is out of balance.
    """
    try:
        times = np.asarray(times, float)
    except (TypeError, ValueError):
        raise InputError(f"times = {shown(times)} must be numbers of seconds") from None
    if np.ndim(times) == 1 and (np.diff(times) < 1e-9).any() and (np.diff(times) > 0).all():
        raise InputError(f"times = {shown(times)} s must lie 1e-9 s apart at least")
    if times.ndim != 1 or not times.size or times[0] < 0 or not (np.diff(times) > 0).all():
        raise InputError(f"times = {times} s must ascend, from 0 or later on")
    load = Load(surface_of(mesh), [push]) if isinstance(push, Push) else push
    if not callable(load):
        raise InputError(f"the push is {shown(push)}; give a Push, or a function of the time in s")
    if kind not in SOLVERS:
        raise InputError(f"kind '{kind}' is not one of {', '.join(SOLVERS)}")
    takes(SOLVERS[kind], settings, f"the {kind} solver", 2)
    solver = SOLVERS[kind](mesh, material, **settings)
    return stacked(simulate_frames(solver, load, times, [EnergyLedger()]))
