"""The competitors of a study as steppers (see fem.online.stepper): each is judged, timed and drawn
by the same code, frame by frame, whatever it is."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from fem.data.dataset import Dataset
from fem.online.input_field import InputField
from fem.online.regression import RegressionStepper
from fem.online.stepper import Stepper
from unet_fem.deployment.answers import muted
from unet_fem.deployment.exported import files_there
from unet_fem.deployment.forms import CALL, graph_stepper
from unet_fem.networks import ridge
from unet_fem.networks.files import load_model
from unet_fem.networks.pod import linear, reduced, truncated
from unet_fem.networks.registry import Linear, Pod, network
from unet_fem.networks.stepper import KerasStepper
from unet_fem.runtime.surrogate import Surrogate
from unet_fem.steppers import open_stepper
from unet_fem.steppers import stepper as build_stepper
from unet_fem.study.runs import KERAS
from unet_fem.study.settings import LINEAR, Answer, Study
from unet_fem.training.inputs import input_field
from unet_fem.training.regressions import fit_regression
from unet_fem.training.samples import load_samples, training_samples
from unet_fem.training.settings import InputChoice, Settings

REMEMBERED = ", remembered force"
FACTS = (  # of a competitor, for results
    *("kind", "family", "run", "parent", "form", "frames"),
    *("interactions", "hard_in_training", "tries", "frame", "options", "made"),
)


@dataclass(frozen=True)
class Competitor:
    """One that answers forces frame by frame.

    kind: "network", "regression", "answer" or "FEM"; family: joined in figures; run: of a
    network, parent: the run that it was pruned from; form: as it is deployed; frames: forces that
    it sees at once; make: gives its Stepper, for forces on the node grid; parameters: of a
    regression
    interactions: that it has learned from, 0 for none; hard_in_training: whether hard forces were
    among them; tries: settings that were tried on validation interactions
    frame: s between its forces, None where its answer is the same whatever that is; file: that it
    is opened from; options: keywords that it is opened with; made: what a
    user gives to have it, commands or a line of Python; empty for networks, whose runs tell.
    """

    kind: str
    family: str
    make: Callable[[], Stepper]
    run: str | None = None
    parent: str | None = None
    form: str = "float32"
    frames: int = 1
    parameters: int | None = None
    interactions: int = 0
    hard_in_training: bool = False
    tries: int = 1
    frame: float | None = None
    file: str | None = None
    options: dict = field(default_factory=dict)
    made: tuple[str, ...] = ()

    def facts(self) -> dict:
        """What results say about it, plain values."""
        own = {name: getattr(self, name) for name in FACTS}
        return own | ({"parameters": self.parameters} if self.parameters else {})


def networks(
    settings: Settings,
    parent: str | None,
    dataset: Dataset,
    threads: int | None = None,
    tries: int = 1,
) -> dict[str, Competitor]:
    """{"<run>: <form>": Competitor}: a trained run called plainly, as a tf.function, and by each of
    its .tflite files.

    threads: of LiteRT, None for all; TensorFlow's are the process's. tries: see Competitor.
    """
    threads, path = threads or os.cpu_count() or 1, settings.folder / "best.keras"
    interval = dataset.scene.frames.interval
    forms: dict[str, Callable[[], Stepper]] = {
        KERAS: lambda: graph_stepper(load_model(path), interval, InputField.beside(path)),
        CALL: lambda: KerasStepper.open(path, interval),
    }
    for form, file in files_there(settings).items():
        forms[form] = partial(Surrogate, file, threads)
    return {
        f"{settings.name}: {form}": Competitor(
            "network",
            network(settings.model.kind).label,
            make,
            run=settings.name,
            parent=parent,
            form=form,
            frames=settings.model.window or 1,
            interactions=trained_on(dataset),
            tries=tries,
            file=str(files_there(settings).get(form, path)),
        )
        for form, make in forms.items()
    }


def trained_on(dataset: Dataset) -> int:
    """Interactions of the split that networks and regressions learn from."""
    return int(np.sum(dataset.split == "train"))


def answering(
    study: Study, dataset: Dataset, threads: int = 1, shown: bool = False
) -> dict[str, Competitor]:
    """{name: Competitor} of study.answers whose files are there; of those that are `shown` alone.
    One that takes any interval is a competitor of its own for each length of frame, for it answers
    each with another error."""
    found = {}
    for own in study.answers:
        if own.file and not Path(own.file).is_file() or shown and not own.shown:
            continue
        kind = "FEM" if own.stepper else "answer"  # what is made from mesh and material
        make = partial(_open_answer, own, dataset, threads)
        competitor = Competitor(
            kind,
            own.family,
            make,
            interactions=own.interactions,
            hard_in_training=own.hard,
            tries=own.tries,
            file=own.file or None,
            options=own.options,
            made=own.made or (built(own.stepper),) * bool(own.stepper),
        )
        if make().interval is not None:
            found[own.label] = competitor
            continue
        for frame in study.fem.frames:
            found[f"{own.label} / {1e3 * frame:g} ms"] = replace(competitor, frame=frame)
    return found


def built(kind: str, *settings: object) -> str:
    """The line of Python that makes a stepper of `kind`."""
    given = ", ".join(["mesh", "material", *map(repr, settings)])
    return f'unet_fem.steppers.stepper("{kind}", {given})'


def _open_answer(own: Answer, dataset: Dataset, threads: int) -> Stepper:
    if own.stepper:
        return build_stepper(own.stepper, dataset.fem_mesh, dataset.material, **own.options)
    options = {"threads": threads} if own.file.endswith(".tflite") else {}
    return open_stepper(own.file, **own.options, **options)


def followed(stepper: Stepper, forces: np.ndarray, interval: float) -> np.ndarray:
    """What `stepper` says on forces (F, ...) mN that come every `interval` s, from rest: (F, ...)
    mm. Its warnings are held back."""
    dt = interval if stepper.interval is None else None
    stepper.reset()
    with muted():
        return np.stack([stepper.step(force, dt) for force in forces])


def linear_name(frames: int | None) -> str:
    """Of the linear regression on a window of so many frames; None for one."""
    return f"{LINEAR}, {frames or 1} frame{'s' * ((frames or 1) > 1)}"


def linear_regressions(dataset: Dataset, windows: Iterable[int | None]) -> dict[str, Competitor]:
    """{name: Competitor} of the linear regression on each window of frames."""
    return {
        linear_name(frames): _regression(_fitted(dataset, frames)[0], frames, trained_on(dataset))
        for frames in sorted({frames or 1 for frames in windows})
    }


def regressions(study: Study, dataset: Dataset) -> dict[str, Competitor]:
    """{name: Competitor}: linear for every window of the study's networks, POD on the one best in
    validation, and both on the force as creeping tissue remembers it."""
    found, least = {}, np.inf
    config = next(own.config for own in study.networks if own.name == study.main[0].run)
    for frames in sorted({own.settings.model.window or 1 for own in study.networks}):
        full, train, validation = _fitted(dataset, frames)
        wrong = full.predict(validation.force) - validation.displacement
        error = np.sum(wrong**2, dtype=float)
        if error < least:
            least, best = error, (frames, full, train, validation)
        found[linear_name(frames)] = _regression(full, frames, trained_on(dataset), config)
    frames, full, train, validation = best
    for model in reduced(full, train, validation, max(study.pod_modes)):
        for modes in study.pod_modes:
            if model.modes is not None and modes <= len(model.modes):
                name = f"{model.family}, {modes} modes"
                own = truncated(model, modes)
                found[name] = _regression(own, frames, trained_on(dataset), config)
    return found | remembering(study, dataset, config)


def remembering(study: Study, dataset: Dataset, config: str = "") -> dict[str, Competitor]:
    """{name: Competitor} of regressions on remembered forces; none where nothing creeps. config:
    file of the run that they stand beside."""
    field = input_field(InputChoice("creep"), dataset)
    if field is None:
        return {}
    samples = training_samples(dataset, None, field)
    full, pod = (
        fit_regression(dataset, options, samples, field)
        for options in (Linear(), Pod(modes=max(study.pod_modes)))
    )
    models = {f"{LINEAR}{REMEMBERED}": full}
    for modes in study.pod_modes:
        if pod.modes is not None and modes <= len(pod.modes):
            models[f"{pod.family}, {modes} modes{REMEMBERED}"] = truncated(pod, modes)
    return {
        name: replace(
            _regression(model, 1, trained_on(dataset), config, "input.memory=creep"),
            family=f"{model.family}{REMEMBERED}",
        )
        for name, model in models.items()
    }


def _fitted(dataset, frames):
    train, validation = (load_samples(dataset, split, frames) for split in ("train", "validation"))
    return linear(train, validation, dataset.free), train, validation


def _regression(model, frames, interactions, config="", *changes):
    if model.modes is None:
        kind = ["model.kind=linear"]
    else:
        squares = str("quadratic" in model.family).lower()
        kind = ["model.kind=pod", f"model.modes={len(model.modes)}", f"model.quadratic={squares}"]
    words = " ".join([config, *kind, f"model.steps={frames}", *changes])
    return Competitor(
        "regression",
        model.family,
        partial(RegressionStepper, model),
        frames=frames,
        parameters=model.parameters,
        interactions=interactions,
        tries=len(ridge.RIDGES),
        made=(f"python -m unet_fem.train {words}",),
    )
