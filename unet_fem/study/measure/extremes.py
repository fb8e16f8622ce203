"""Loads, tissues and frames far from all that was learned: does each answer stay right, and where
it does not, does it say so?

Every cell is a run from rest beside the FEM. It ends as one of OUTCOMES, by its worst frame.
"""

from dataclasses import replace

import numpy as np

from fem.contact.push import Load, Push
from fem.contact.surface import Surface
from fem.data.dataset import Dataset
from fem.errors import InputError, SolverStopped
from fem.material.base import Hyperelastic
from fem.material.neo_hooke import NeoHooke
from fem.online.grid import MN
from fem.online.indicator import ErrorIndicator
from fem.online.reduced import ReducedStepper
from fem.online.retissue import with_tissue
from fem.solver.load_ramp import NodalLoad
from fem.solver.quasistatic_loop import QuasiStaticLoop
from unet_fem.deployment.answers import muted
from unet_fem.metrics import relative_l2
from unet_fem.study.dataset import study_dataset
from unet_fem.study.measure.duties import dutiful
from unet_fem.study.measure.force_range import shown_competitors
from unet_fem.study.settings import Study
from unet_fem.training.extremes import FRAMES, RAMP, extreme_loads, fem_response

TOLERANCE = 0.05  # relative L2 of a frame
MOVING = 0.1  # of the largest motion: frames that move less are not judged
AT_REST = 1e-3  # mm, norm of a field
NOWHERE = 1e9  # mm, where an answer is not finite
OUTCOMES = ("accurate", "corrected", "flagged", "silently wrong", "stopped")
KNOWN = 8  # loads that the guard's features were chosen by: those of unet_fem.training.extremes
NU = (0.3, 0.45, 0.49, 0.499)
STIFF = (0.1, 10.0)  # times mu, and the force with it
LOCKS = 0.45  # nu above which the truth takes the element that does not lock
SOFT = 0.6  # times mu under the same force
LENGTHS = (1e-3, 1e-2, 0.25, 2.5, 25.0, 250.0)  # s of a frame
FINER = 10  # frames of the truth to one that is asked for
COARSER = 0.05  # s, of those where they are shorter


def run(study: Study) -> dict:
    """{"tolerance", "loads", "tissues", "frames": [{"name", "largest_mm", "stopped": why the FEM
    did, or None, "answers": {label: cell}}]}.

    cell: {"outcome": one of OUTCOMES, "error": relative L2 over the frames, "worst": of a frame
    that moves, "evaluations": most of a frame, None where nothing is iterated, "reason": why it was
    flagged or stopped, or None}. Corrected: right, where one evaluation a frame would not be. Wrong
    frames that are flagged, all of them, make a flagged cell.
    """
    dataset = study_dataset(study)
    made = {label: own.make for label, own in shown_competitors(study, dataset).items()}
    interval = dataset.scene.frames.interval
    rows: dict[str, list[dict]] = {"loads": [], "tissues": [], "frames": []}
    for name, load in loads(dataset).items():
        print(f"extremes: {name}", flush=True)
        try:
            force, truth, _ = fem_response(dataset, load)
        except SolverStopped as stop:
            rows["loads"].append(_stopped(name, stop))
            continue
        rows["loads"].append(_row(name, force, truth, interval, made, dataset))
    for name, tissue, factor in tissues(dataset):
        print(f"extremes: {name}", flush=True)
        own = {label: _with(make, tissue, dataset) for label, make in made.items()}
        if all(make() is None for make in own.values()):
            continue
        try:
            force, truth = _of_tissue(dataset, tissue, factor)
        except (SolverStopped, InputError) as stop:
            rows["tissues"].append(_stopped(name, stop))
            continue
        rows["tissues"].append(_row(name, force, truth, interval, own, dataset))
    for dt in LENGTHS:
        name = f"{dt:g} s"
        print(f"extremes: frames of {name}", flush=True)
        force, truth, kept = _of_frames(dataset, dt)
        rows["frames"].append(_row(name, force, truth, dt, _any_interval(made), dataset, kept))
    return {"tolerance": TOLERANCE} | rows


def loads(dataset: Dataset) -> dict[str, NodalLoad]:
    """{name: load(t)}: those of unet_fem.training.extremes, and some that nothing was chosen by."""
    mesh, contact = dataset.fem_mesh, dataset.scene.contact
    surface, radius = Surface(mesh), float(np.mean(contact.radius))
    peak = contact.force[1]

    def push(factor, at="middle", size=1.0, **more):
        return Push(at, factor * peak, size * radius, ramp=RAMP, **more)

    one = Load(surface, [push(1.0)])
    top = np.unique(mesh.contact_faces)
    top = top[~mesh.fixed[top]]
    sideways, single, noise = np.zeros((3, 3, mesh.n_nodes))
    sideways[0] = -one(2 * RAMP)[2]
    single[2, top[np.argmax(mesh.points[top, 2])]] = -0.25 * peak
    noise[:, top] = np.random.default_rng(1).normal(size=(3, len(top)))
    noise *= peak / np.abs(noise).sum(axis=1).max()

    def rising(field):
        return lambda t: min(t / RAMP, 1.0) * field

    flips = dataset.scene.frames.interval * np.arange(FRAMES), [0, *(1, -1) * (FRAMES // 2)]
    return extreme_loads(mesh, contact) | {
        "pull, 1.6 x": Load(surface, [push(-1.6)]),
        "pull at the rim": Load(surface, [push(-1.0, "rim")]),
        "push and pull side by side": Load(surface, [push(1.0), push(-1.0, "rim")]),
        "sign flips every frame": lambda t: np.interp(t, *flips) * one(2 * RAMP),
        "sideways": rising(sideways),
        "half the radius": Load(surface, [push(1.0, size=0.5)]),
        "twice the radius": Load(surface, [push(1.0, size=2.0)]),
        "one node": rising(single),
        "noise on every node": rising(noise),
    }


def tissues(dataset: Dataset) -> list[tuple[str, Hyperelastic, float]]:
    """[(name, material, factor on the force)]; none where the law is no uniform neo-Hookean one."""
    own = dataset.material
    if not isinstance(own, NeoHooke) or np.ndim(own.mu) or np.ndim(own.nu):
        return []
    found: list[tuple[str, Hyperelastic, float]]
    found = [(f"mu x {f:g}, force too", replace(own, mu=f * own.mu), f) for f in STIFF]
    found.append((f"mu x {SOFT:g}", replace(own, mu=SOFT * own.mu), 1.0))
    found += [(f"nu {nu:g}", replace(own, nu=nu), 1.0) for nu in NU]
    return found + [("elastic", own.elastic(), 1.0)]


def _row(name, force, truth, dt, made, dataset, kept=slice(None)):
    """force (F, nx, ny, nz, 3) mN at frames of dt s after rest, truth mm at those of them that are
    `kept`."""
    cells = {label: _cell(make, force, truth, dt, dataset, kept) for label, make in made.items()}
    return {
        "name": name,
        "largest_mm": float(np.linalg.norm(truth, axis=-1).max()),
        "stopped": None,
        "answers": {label: cell for label, cell in cells.items() if cell},
    }


def _stopped(name, stop):
    reason = str(getattr(stop, "reason", stop))
    return {"name": name, "largest_mm": None, "stopped": reason, "answers": {}}


def _cell(make, force, truth, dt, dataset, kept):
    """None where there is no such answer."""
    stepper = make()
    if stepper is None:
        return None
    cell = dict.fromkeys(("outcome", "error", "worst", "evaluations", "reason"))
    try:
        answer, flags, evaluations = _followed(stepper, force, dt, dataset)
    except SolverStopped as stop:
        return cell | {"outcome": "stopped", "reason": str(stop.reason)}
    error, worst, bad = judge(answer[kept], truth)
    cell |= {"error": error, "worst": worst, "evaluations": evaluations}
    said = np.array(flags)[kept][bad]
    if len(said):
        outcome = "flagged" if all(said) else "silently wrong"
        return cell | {"outcome": outcome, "reason": str(said[0]) if all(said) else None}
    if getattr(stepper, "most", 1) == 1:
        return cell | {"outcome": "accurate"}
    stepper.most = 1  # had one evaluation done?
    hasty, _, _ = _followed(stepper, force, dt, dataset)
    return cell | {"outcome": "corrected" if judge(hasty[kept], truth)[2].any() else "accurate"}


def judge(answer: np.ndarray, truth: np.ndarray) -> tuple[float | None, float | None, np.ndarray]:
    """(relative L2 over all frames, that of the worst that moves, None where none does, which are
    wrong) of fields (F, ...) mm. Where nothing moves an answer must be at rest to AT_REST mm."""
    size, wrong = (
        np.linalg.norm(field.reshape(len(truth), -1).astype(float), axis=1)
        for field in (truth, answer - truth)
    )
    if not size.any():
        return None, None, wrong > AT_REST
    judged = size >= MOVING * size.max()
    share = np.where(judged, wrong / np.where(judged, size, 1), 0)
    return relative_l2(answer, truth), float(share.max()), share > TOLERANCE


def _followed(stepper, force, dt, dataset):
    """(answers (F, ...) mm, [what each frame is flagged for, "" where it is not], most evaluations
    of a frame)."""
    indicator = ErrorIndicator(stepper.model) if isinstance(stepper, ReducedStepper) else None
    own = stepper if hasattr(stepper, "flagged") else dutiful(stepper, dataset)
    given = dt if stepper.interval is None else None
    answers, flags, evaluations = [], [], []
    own.reset()
    with muted(), np.errstate(all="ignore"):
        for one in force:
            answers.append(own.step(one, given))
            evaluations.append(getattr(stepper, "evaluations", None))
            flags.append(_flag(stepper, own, indicator, one, answers[-1], dt))
    known = [count for count in evaluations if count is not None]
    return np.nan_to_num(np.array(answers), nan=NOWHERE), flags, max(known, default=None)


def _flag(stepper, own, indicator, force, answer, dt):
    if hasattr(stepper, "flagged"):
        guard = getattr(stepper, "guard", None)
        return (guard.reason if guard else "its guard") if stepper.flagged else ""
    if indicator:
        return "its error indicator" if _beyond(indicator, force, answer, dt) else ""
    if own.outside_training_range:
        return "force beyond the training range"
    return "volume beyond the band" if own.volume_alarm else ""


def _beyond(indicator, force, answer, dt):
    size = float(np.linalg.norm(answer))
    return not indicator(force, answer, dt) <= TOLERANCE * size if size else False


def _of_tissue(dataset, tissue, factor):
    """(force, truth) of a push on another tissue; the element that does not lock where nu asks for
    it."""
    solver = dataset.scene.solver
    if tissue.nu > LOCKS:
        solver = replace(solver, element="mean_dilatation")
    scene = replace(dataset.scene.with_solver(solver), material=tissue)
    contact, surface = scene.contact, Surface(dataset.fem_mesh)
    push = Push("middle", factor * contact.force[1], float(np.mean(contact.radius)), ramp=RAMP)
    other = replace(dataset, scene=scene)
    force, truth, _ = fem_response(other, Load(surface, [push]))
    return force, truth


def _with(make, tissue, dataset):
    """A maker of the same answer for another tissue; of nothing where it cannot be told so."""

    def other():
        own = make()
        mu, bulk = float(tissue.mu), float(tissue.K)
        if isinstance(own, QuasiStaticLoop):
            own_element = dataset.scene.solver.element
            element = "mean_dilatation" if tissue.nu > LOCKS else own_element
            return QuasiStaticLoop(own.mesh, tissue, element)
        if hasattr(own, "set_material"):
            own.set_material(mu, bulk, tissue.prony)
            return own
        if isinstance(own, ReducedStepper):
            try:
                model, _ = with_tissue(own.model, {}, mu, bulk, tissue.prony)
            except (InputError, KeyError):
                return None
            return ReducedStepper(model)
        return None

    return other


def _any_interval(made):
    """Those that take frames of any length."""
    return {label: make for label, make in made.items() if make().interval is None}


def _of_frames(dataset, dt):
    """(force, truth, kept): at frames of dt s a push that rises within a second or a frame, and is
    held as long again. Forces run linearly between the frames; the truth is the quasi-static FEM in
    finer frames, or where they are short in coarser ones, and has the frames `kept` alone."""
    scene, mesh = dataset.scene, dataset.fem_mesh
    rise = max(1.0, dt)
    push = Push("middle", scene.contact.force[1], float(np.mean(scene.contact.radius)), ramp=rise)
    load, times = Load(Surface(mesh), [push]), dt * np.arange(1, 2 * round(rise / dt) + 1)
    fields = np.stack([(load(t).T * MN).astype(np.float32) for t in times])
    each, finer = max(1, round(COARSER / dt)), FINER if dt > COARSER else 1
    kept = np.arange(each - 1, len(times), each)
    truth = QuasiStaticLoop(mesh, dataset.material, scene.solver.element, "float64")
    last, shown = np.zeros_like(fields[0]), []
    for force in fields[kept]:
        for part in range(1, finer + 1):
            field = truth.step(last + part / finer * (force - last), each * dt / finer)
        last = force
        shown.append(field)
    forces, answer = dataset.on_grid(fields, np.array(shown))
    return forces, answer, kept
