"""A sample of a dataset's interactions simulated again at the true mass, to confirm what mass
scaling costs."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fem.contact.push import Contact
from fem.contact.surface import surface_of
from fem.data.interaction import simulate
from fem.data.scene import Scene
from fem.errors import InputError, SolverStopped
from fem.mesh.hexmesh import HexMesh


class Confirmation(NamedTuple):
    """error: relative L2 distance of an interaction's displacement, all frames, from that at the
    true mass."""

    split: str
    number: int
    error: float


def sampled(scene: Scene) -> list[tuple[str, int]]:
    """The (split, number) of the interactions to confirm: drawn by the scene's seed from the hard
    ones, the others of the test and the other splits in turn; none where the mass is the true."""
    interactions, health = scene.interactions, scene.health
    if scene.solver.true_mass:
        return []
    rng = np.random.default_rng([interactions.seed, len("confirm")])
    groups: dict[str, list[tuple[str, int]]] = {
        group: [] for group in ("hard", "train", "validation", "test")
    }
    for which in interactions.all():
        groups["hard" if interactions.is_hard(*which) else which[0]].append(which)
    shuffled = [[group[i] for i in rng.permutation(len(group))] for group in groups.values()]
    longest = max(map(len, shuffled))
    in_turn = [group[i] for i in range(longest) for group in shuffled if i < len(group)]
    return in_turn[: health.confirm]


def _true_mass(scene):
    """The scene with the explicit solver and the true mass, which nothing confirms."""
    others = dict.fromkeys(("tolerance", "model", "sha256"))
    solver = replace(scene.solver, kind="explicit", mass_scaling=1.0, **others)
    return scene.with_solver(solver)


def confirmed(
    scene: Scene,
    mesh: HexMesh,
    split: str,
    number: int,
    contacts: list[Contact],
    displacement: np.ndarray,
) -> Confirmation:
    """The Confirmation of an interaction by its contacts and its displacement (frames, N, 3) mm;
    with an infinite error where the solver stops at the true mass."""
    try:
        result = simulate(_true_mass(scene), mesh, contacts, surface_of(mesh))
    except SolverStopped:
        return Confirmation(split, number, np.inf)
    exact = result["displacement"].astype(float)
    distance, size = (float(np.linalg.norm(field)) for field in (displacement - exact, exact))
    return Confirmation(split, number, distance / max(size, 1e-300))


def check_confirmed(scene: Scene, found: list[Confirmation]) -> None:
    """Raises InputError where one of the errors is above `health.mass_error`."""
    worst = max(found, key=lambda one: np.nan_to_num(one.error, nan=np.inf), default=None)
    if not worst or worst.error <= scene.health.mass_error:
        return
    name, scaling = f"{worst.split} interaction {worst.number}", scene.solver.mass_scaling
    quasistatic = scene.solver.kind != "explicit"
    if np.isinf(worst.error):
        how = "without inertia" if quasistatic else f"at solver.mass_scaling = {scaling:g}"
        remedy = "let the load rise more slowly" if quasistatic else "lower it"
        raise InputError(
            f"{name} comes to an end {how} alone and stops at the true mass; {remedy}, lower"
            " contact.force or raise health.corner_J"
        )
    remedy = f"lower solver.mass_scaling = {scaling:g}"
    if quasistatic:
        remedy = "take solver.kind = 'explicit', or let the load rise more slowly"
    raise InputError(
        f"{name} is {worst.error:.2%} away from the same at the true mass (health.mass_error ="
        f" {scene.health.mass_error:.2%} is allowed); {remedy}"
    )
