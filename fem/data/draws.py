"""The contacts of an interaction: drawn by its scene's seed, and drawn again from its forces."""

import itertools

import numpy as np

from fem.contact.draw import draw_contacts
from fem.contact.push import Contact, Load
from fem.contact.surface import Surface, surface_of
from fem.data.scene import SPLITS, Scene
from fem.errors import InputError
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MN

MAX_ATTEMPTS = 20  # draws of an interaction, until one is fit


def drawn_contacts(
    scene: Scene, surface: Surface, split: str, number: int, attempt: int
) -> list[Contact]:
    """The contacts of one draw: it depends on the scene's seed, the split, the number and the
    attempt, on nothing else."""
    rng = np.random.default_rng([scene.interactions.seed, SPLITS.index(split), number, attempt])
    factor = scene.interactions.hard_force if scene.interactions.is_hard(split, number) else None
    return draw_contacts(surface, scene.contact, scene.frames.duration, rng, factor)


def redrawn_contacts(
    scene: Scene, mesh: HexMesh, force: np.ndarray, split: str, number: int
) -> list[Contact]:
    """The contacts of an interaction whose file does not hold them: of the attempt whose load gives
    its frames of `force` (frames, N, 3) mN on `mesh`. Such files hold forces on held nodes too.

    Raises InputError if no attempt gives them: the forces are another scene's.
    """
    rounding = 1e-5 * max(np.abs(force).max(), 1e-300)
    surfaces = Surface(mesh, on_held=True), surface_of(mesh)
    for attempt, surface in itertools.product(range(MAX_ATTEMPTS), surfaces):
        contacts = drawn_contacts(scene, surface, split, number, attempt)
        load = Load(surface, contacts)
        if all(
            np.abs(load(t).T * MN - frame).max() <= rounding
            for t, frame in zip(scene.frames.times, force, strict=True)
        ):
            return contacts
    raise InputError(
        f"no draw of the scene gives the forces of {split} interaction {number}; generate the"
        " dataset again"
    )
