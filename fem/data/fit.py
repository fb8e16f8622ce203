"""A run under any load, as far as it is fit for a dataset."""

import numpy as np

from fem.data.interaction import Frame, health_figures, simulate_frames, stacked, unfit
from fem.data.scene import Scene
from fem.errors import SolverStopped, Stop
from fem.mesh.hexmesh import HexMesh
from fem.solver.energy import EnergyLedger, FrameBalances
from fem.solver.gate import Gate
from fem.solver.load_ramp import NodalLoad


def fit_frames(
    scene: Scene, mesh: HexMesh, load: NodalLoad, times: np.ndarray
) -> tuple[Frame, Stop | None]:
    """The Frame at `times` (s, ascending from 0) of a run from rest under `load(t)` (3, N) in N, up
    to the last one until which the run is fit for a dataset of `scene`; and why it is not beyond,
    or None.

    The run until a frame is judged as a whole, as fem.data.interaction.unfit does: a sign that a
    faint first touch gives and the push that follows takes back ends nothing.
    """
    ledger, gate = EnergyLedger(), Gate(warns=False)
    balances = FrameBalances(ledger, times, scene.material.prony)
    solver = scene.build_solver(mesh)
    solver.gate = gate
    frames: list[Frame] = []
    fit, reason = 0, None
    try:
        for frame in simulate_frames(solver, load, times, [ledger, balances]):
            frames.append(frame)
            health = health_figures(ledger, balances, gate)
            reason = unfit(scene, frame._asdict() | health)
            fit = fit if reason else len(frames)
    except SolverStopped as stop:
        reason = stop.reason
    return stacked(frames[:fit]), reason
