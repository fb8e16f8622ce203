"""One interaction of a scene, simulated, judged, and drawn again if it is unfit for training."""

from collections import Counter

import numpy as np

from fem.contact.push import Load
from fem.contact.surface import surface_of
from fem.contact.table import contact_table
from fem.data.draws import MAX_ATTEMPTS, drawn_contacts, redrawn_contacts
from fem.errors import InputError, SolverStopped
from fem.solver.energy import EnergyLedger, hourglass_share, kinetic_share, worst_imbalance
from fem.solver.explicit import STANDSTILL


def simulate(scene, mesh, contacts, surface):
    """Frames of one interaction on `mesh`.

    Returns a dict: force (frames, N, 3) mN, displacement (frames, N, 3) mm, volume (frames,) mm3,
    energy (frames, 7) in the order of fem.solver.energy.COLUMNS after time, and the health figures
    imbalance, min_J, kinetic_share, hourglass_share and steps. Raises SolverStopped if the run
    cannot go on.
    """
    solver, ledger, load = scene.build_solver(mesh), EnergyLedger(), Load(surface, contacts)
    times = scene.frames.times
    balances = FrameBalances(ledger, times, scene.material)
    force = np.zeros((len(times), mesh.n_nodes, 3), np.float32)
    displacement = np.zeros_like(force)
    volume = np.full(len(times), mesh.volume() * 1e9)
    force[0] = load(0.0).T * 1e3
    for frame in range(1, len(times)):
        solver.advance(times[frame] - solver.time, load, [ledger, balances])
        force[frame] = load(times[frame]).T * 1e3
        displacement[frame] = solver.u.T * 1e3
        volume[frame] = mesh.volume(solver.u.T) * 1e9
    judged = ledger.rows + list(balances.rows.values())
    return {
        "force": force,
        "displacement": displacement,
        "volume": volume,
        "energy": balances.at_frames(),
        "imbalance": worst_imbalance(judged),
        "min_J": ledger.smallest_J,
        "kinetic_share": kinetic_share(judged),
        "hourglass_share": hourglass_share(judged),
        "steps": solver.steps,
    }


class FrameBalances:
    """Observer that comes after an EnergyLedger: a balance for each of the frames at `times` (s).

    A balance is taken at the last step before each frame in which the viscous stress is brought up
    to date, since its work is known best there.
    """

    def __init__(self, ledger, times, material):
        self.ledger, self.times = ledger, times
        self.standstill = STANDSTILL * min((tau for _, tau in material.prony), default=0.0)
        self.rows = {}

    def __call__(self, solver):
        frame = int(np.searchsorted(self.times, solver.time))
        early = self.times[frame] - solver.time if frame < len(self.times) else np.inf
        near = solver.viscous_current and early <= 1.01 * max(solver.dt, self.standstill)
        # a frame shorter than the standstill has no such step: better its last than none
        if not solver.steps or near or solver.last_step and frame not in self.rows:
            self.rows[frame] = self.ledger.balance(solver)

    def at_frames(self):
        """(frames, 7), the columns of fem.solver.energy.COLUMNS after time, interpolated to the
        frames."""
        rows = np.array([self.rows[frame] for frame in sorted(self.rows)])
        return np.stack(
            [np.interp(self.times, rows[:, 0], column) for column in rows[:, 1:].T], axis=1
        )


def unfit(scene, result):
    """Why a simulated interaction must not enter a dataset: a short reason, or None."""
    if not all(np.isfinite(result[name]).all() for name in ("force", "displacement", "volume")):
        return "not finite"
    if not result["imbalance"] <= scene.health.imbalance:
        return "energy imbalance"
    if not result["min_J"] >= scene.health.min_J:
        return "crushed cell"
    if not result["kinetic_share"] <= scene.health.kinetic_share:
        return "kinetic energy"
    return None


def contacts_of(dataset, split, number):
    """The contacts of an interaction of a fem.data.dataset.Dataset, drawn again from its forces;
    dataset.contacts has them from the file."""
    force = dataset.sequence(split, number).force
    return redrawn_contacts(dataset.scene, dataset.fem_mesh, force, split, number)


def healthy_interaction(scene, mesh, split, number):
    """The first healthy draw of interaction `number` of `split`: the dict of `simulate`, with its
    `contacts` (rows of fem.contact.table.TABLE) and `rejected` {reason: count}.

    Raises InputError after 20 unfit draws.
    """
    surface, rejected = surface_of(mesh), Counter()
    for attempt in range(MAX_ATTEMPTS):
        try:
            contacts = drawn_contacts(scene, surface, split, number, attempt)
            result = simulate(scene, mesh, contacts, surface)
            reason = unfit(scene, result)
        except SolverStopped as stop:
            reason = stop.reason
        if reason is None:
            return result | {"contacts": contact_table(contacts), "rejected": dict(rejected)}
        rejected[reason] += 1
    counts = ", ".join(f"{reason} {count}" for reason, count in rejected.most_common())
    raise InputError(
        f"{split} interaction {number} was unfit in all {MAX_ATTEMPTS} draws ({counts}); lower contact.force or widen contact.radius"
    )
