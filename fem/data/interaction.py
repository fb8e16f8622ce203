"""One interaction of a scene, simulated, judged, and drawn again if it is unfit for training."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fem.contact.push import Contact, Load
from fem.contact.surface import Surface, surface_of
from fem.contact.table import contact_table
from fem.data.dataset import Dataset
from fem.data.draws import MAX_ATTEMPTS, drawn_contacts, redrawn_contacts
from fem.data.scene import Scene
from fem.errors import InputError, SolverStopped, Stop
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MM, MN
from fem.solver.energy import (
    EnergyLedger,
    FrameBalances,
    kinetic_share,
    worst_imbalance,
)
from fem.solver.explicit import Solver
from fem.solver.gate import Gate, Limits, Signs, doubts
from fem.solver.load_ramp import NodalLoad
from fem.solver.quasistatic import QuasiStatic
from fem.solver.record import Observer


class Frame(NamedTuple):
    """The tissue at one instant: force (N, 3) mN and displacement (N, 3) mm in float32, volume mm3;
    or at several, with a leading axis."""

    force: np.ndarray
    displacement: np.ndarray
    volume: np.ndarray


def stacked(frames: Iterable[Frame]) -> Frame:
    """Several frames as one: force and displacement (frames, N, 3), volume (frames,)."""
    return Frame(*(np.array(part) for part in zip(*frames, strict=True)))


def simulate_frames(
    solver: Solver | QuasiStatic,
    load: NodalLoad,
    times: np.ndarray,
    observers: Sequence[Observer] = (),
) -> Iterator[Frame]:
    """The Frame at each of `times` (s, ascending, from the solver's own time on), one by one, under
    `load(t)` (3, N) in N. Raises SolverStopped at the frame that the solver does not reach."""
    for time in times:
        if time != solver.time:
            solver.advance(time - solver.time, load, observers)
        yield Frame(
            (load(time).T * MN).astype(np.float32),
            (solver.u.T * MM).astype(np.float32),
            np.asarray(solver.mesh.volume(solver.u.T) * MM**3),
        )


def simulate(scene: Scene, mesh: HexMesh, contacts: list[Contact], surface: Surface) -> dict:
    """Frames of one interaction on `mesh`.

    Returns a dict: force (frames, N, 3) mN, displacement (frames, N, 3) mm, volume (frames,) mm3,
    energy (frames, 7) in the order of fem.solver.energy.COLUMNS after time, and the health figures:
    imbalance and kinetic_share, over the balances of the ledger and those at the frames, min_J, the
    fem.solver.gate.Signs, and steps. Raises SolverStopped if the run cannot go on.
    """
    solver, ledger, times = scene.build_solver(mesh), EnergyLedger(), scene.frames.times
    balances = FrameBalances(ledger, times, scene.material.prony)
    solver.gate = gate = Gate(warns=False)  # the data are judged by it
    load = Load(surface, contacts)
    frames = stacked(simulate_frames(solver, load, times, [ledger, balances]))
    return (
        frames._asdict()
        | {"energy": balances.at_frames()}
        | health_figures(ledger, balances, gate)
        | {"steps": solver.steps}
    )


def health_figures(ledger: EnergyLedger, balances: FrameBalances, gate: Gate) -> dict:
    """What `unfit` judges besides the frames themselves, of a run that these three have watched."""
    rows = ledger.rows + balances.rows
    return {
        "imbalance": worst_imbalance(rows),
        "min_J": ledger.smallest_J,
        "kinetic_share": kinetic_share(rows),
        **gate.signs._asdict(),
    }


def unfit(scene: Scene, result: dict) -> Stop | None:
    """Why a simulated interaction must not enter a dataset, or None."""
    if not all(np.isfinite(result[name]).all() for name in ("force", "displacement", "volume")):
        return Stop.NOT_FINITE
    if not result["imbalance"] <= scene.health.imbalance:
        return Stop.ENERGY_IMBALANCE
    if not result["min_J"] >= scene.health.min_J:
        return Stop.CRUSHED_CELL
    if not result["kinetic_share"] <= scene.health.kinetic_share:
        return Stop.KINETIC_ENERGY
    limits = Limits(*(getattr(scene.health, name) for name in Limits._fields))
    return next(iter(doubts(Signs(*(result[name] for name in Signs._fields)), limits)), None)


def contacts_of(dataset: Dataset, split: str, number: int) -> list[Contact]:
    """The contacts of an interaction of a fem.data.dataset.Dataset, drawn again from its forces;
    dataset.contacts has them from the file."""
    force = dataset.sequence(split, number).force
    return redrawn_contacts(dataset.scene, dataset.fem_mesh, force, split, number)


def healthy_interaction(scene: Scene, mesh: HexMesh, split: str, number: int) -> dict:
    """The first healthy draw of interaction `number` of `split`: the dict of `simulate`, with its
    `contacts` (rows of fem.contact.table.TABLE) and `rejected` {reason: count}.

    Raises InputError after 20 unfit draws.
    """
    surface, rejected = surface_of(mesh), Counter[str]()
    for attempt in range(MAX_ATTEMPTS):
        try:
            contacts = drawn_contacts(scene, surface, split, number, attempt)
            result = simulate(scene, mesh, contacts, surface)
            reason = unfit(scene, result)
        except SolverStopped as stop:
            reason = stop.reason
        if reason is None:
            return result | {"contacts": contact_table(contacts), "rejected": dict(rejected)}
        rejected[str(reason)] += 1
    counts = ", ".join(f"{reason} {count}" for reason, count in rejected.most_common())
    raise InputError(
        f"{split} interaction {number} was unfit in all {MAX_ATTEMPTS} draws ({counts});"
        " lower contact.force or widen contact.radius"
    )
