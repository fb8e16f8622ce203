"""Loads that no training set holds: the networks beside the FEM far from what they have learned."""

from collections.abc import Iterable

import numpy as np

from fem.contact.draw import ContactRange
from fem.contact.push import Load, Push
from fem.contact.surface import Surface
from fem.data.dataset import Dataset
from fem.data.fit import fit_frames
from fem.errors import SolverStopped
from fem.mesh.hexmesh import HexMesh
from fem.online.input_field import InputField
from fem.solver.load_ramp import NodalLoad
from unet_fem.metrics import relative_l2
from unet_fem.networks.registry import Model
from unet_fem.training.losses import deformed_volume
from unet_fem.training.samples import windows

FRAMES, RAMP = 5, 0.5  # frames of the scene's interval, and seconds over which the load rises


def extreme_loads(mesh: HexMesh, contact: ContactRange) -> dict[str, NodalLoad]:
    """{name: load(t)} for a mesh in m and the ContactRange of its scene; each load (3, N) N rises
    and is then held.

    Forces are multiples of the largest training force of one contact, at the middle of the surface
    or at its rim.
    """
    surface, radius = Surface(mesh), float(np.mean(contact.radius))

    def push(factor, at):
        return Load(surface, [Push(at, factor * contact.force[1], radius, ramp=RAMP)])

    top = np.unique(mesh.contact_faces)
    top = top[~mesh.fixed[top]]
    place: tuple[np.ndarray, ...] = (top,)  # by node number, or by place in the grid
    if mesh.grid_shape is not None and mesh.grid_index is not None:
        place = np.unravel_index(mesh.grid_index[top], mesh.grid_shape)
    signs = np.where(np.sum(place, axis=0) % 2, 1.0, -1.0)
    board = np.zeros((3, mesh.n_nodes))
    board[2, top] = signs * contact.force[1] / len(top)
    return {
        "zero force": push(0.0, "middle"),
        "largest training force": push(1.0, "middle"),
        "1.6 x": push(1.6, "middle"),
        "2.5 x": push(2.5, "middle"),
        "4 x": push(4.0, "middle"),
        "sign flipped (pull)": push(-1.0, "middle"),
        "at the rim": push(1.0, "rim"),
        "checkerboard": lambda t: min(t / RAMP, 1.0) * board,
    }


def fem_response(dataset: Dataset, load: NodalLoad) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(force mN, displacement mm, volume mm3) at FRAMES frames, fields on the grid (FRAMES, nx, ny,
    nz, 3).

    Raises SolverStopped where the FEM stops, or its answer is not fit for the data of the scene.
    """
    times = np.arange(FRAMES) * dataset.scene.frames.interval
    frames, reason = fit_frames(dataset.scene, dataset.fem_mesh, load, times)
    if reason:
        reached = times[len(frames.volume) - 1]
        raise SolverStopped.because(reason, f"no answer after {reached:.4g} s can be believed")
    return *dataset.on_grid(frames.force, frames.displacement), frames.volume


def judge_extremes(
    models: dict[str, Model],
    dataset: Dataset,
    steps: int | None,
    field: InputField | None = None,
) -> dict:
    """{case: {model: figures}} for {name: Keras model or Regression}; the FEM's entry says why it
    stopped where it did.

    relative_l2 is over the frames under load (None without motion), worst_mm the largest nodal
    error, and volume_violation_max the largest relative change of volume. steps: of the models'
    window, or None; field: what they see in place of the forces.
    """
    mesh = dataset.fem_mesh
    rest = dataset.rest_volume
    result: dict[str, dict[str, dict]] = {}
    for case, load in extreme_loads(mesh, dataset.scene.contact).items():
        try:
            force, truth, volume = fem_response(dataset, load)
        except SolverStopped as stop:
            result[case] = {"FEM": {"stopped": str(stop.reason)}}
            continue
        result[case] = {
            "FEM": {
                "largest_mm": _largest(truth),
                "volume_violation_max": float(np.abs(volume / volume[0] - 1).max()),
            }
        }
        seen = force[None]
        if field:
            seen = field.sequences(seen, dataset.scene.frames.interval)
        for name, model in models.items():
            prediction = np.asarray(model(windows(seen, steps)))
            moved = np.asarray(deformed_volume(prediction, *dataset.surface), float)
            result[case][name] = {
                "relative_l2": relative_l2(prediction, truth),
                "worst_mm": _largest(prediction - truth),
                "volume_violation_max": float(np.abs(moved / rest - 1).max()),
            }
    return result


def _largest(field):
    return float(np.linalg.norm(field, axis=-1).max())


def extremes_table(result: dict, models: Iterable[str]) -> str:
    """The result of `judge_extremes` as text."""
    lines = [
        "",
        "extremes".ljust(24)
        + "FEM max mm  vol %"
        + "".join(f"  {name:>18}: L2 %  worst mm  vol %" for name in models),
    ]
    for case, figures in result.items():
        fem = figures["FEM"]
        if "stopped" in fem:
            lines.append(case.ljust(24) + f"FEM stopped: {fem['stopped']}")
            continue
        row = (
            case.ljust(24) + f"{fem['largest_mm']:10.2f}  {100 * fem['volume_violation_max']:5.1f}"
        )
        for name in models:
            f = figures[name]
            error = "-" if f["relative_l2"] is None else f"{100 * f['relative_l2']:.0f}"
            row += (
                " " * 21
                + f"{error:>5}  {f['worst_mm']:8.2f}  {100 * f['volume_violation_max']:5.1f}"
            )
        lines.append(row)
    return "\n".join(lines)
