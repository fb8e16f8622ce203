"""Everything that answers forces call by call (see fem.online.stepper), by its kind or from its
file.

    body = open_stepper("runs/quick/lite/int8.tflite")
    displacement = body.step(force)

Nothing heavy is imported before a stepper is asked for. A new kind is one row.
"""

import importlib
import operator
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fem.errors import InputError
from fem.files import load_arrays
from fem.online.stepper import Stepper
from fem.ranges import shown, takes


@dataclass(frozen=True)
class Kind:
    """label: for people. make: "module:name" of what builds the stepper from objects. suffix: of
    the files that it is opened from by `opener`, "module:name" too; format: what an .npz of it
    says it is, but for the number."""

    label: str
    make: str
    suffix: str | None = None
    opener: str | None = None
    format: str = ""


STEPPERS = {
    "keras": Kind(
        "Keras",
        "unet_fem.networks.stepper:KerasStepper",
        ".keras",
        "unet_fem.networks.stepper:KerasStepper.open",
    ),
    "litert": Kind(
        "LiteRT", "unet_fem.runtime:Surrogate", ".tflite", "unet_fem.runtime:open_surrogate"
    ),
    "regression": Kind(
        "regression",
        "fem.online.regression:RegressionStepper",
        ".npz",
        "fem.online.regression:RegressionStepper.open",
        "unet-fem regression",
    ),
    "reduced": Kind(
        "reduced solver",
        "fem.online.reduced:ReducedStepper",
        ".npz",
        "fem.online.reduced:ReducedStepper.open",
        "unet-fem reduced",
    ),
    "elastic": Kind("linear elastic answer", "fem.solver.elastic:elastic_stepper"),
    "fem": Kind("FEM", "fem.solver.frame_loop:FrameLoop"),
    "quasistatic": Kind("quasi-static FEM", "fem.solver.quasistatic_loop:QuasiStaticLoop"),
}


def stepper(kind: str, *arguments: object, **options: object) -> Stepper:
    """The stepper of `kind` from the arguments of its constructor. Raises InputError for an unknown
    kind."""
    make = maker(kind)
    takes(make, options, f"stepper '{kind}'", len(arguments))
    return make(*arguments, **options)


def maker(kind: str) -> Callable[..., Stepper]:
    """What builds a stepper of `kind`. Raises InputError for an unknown one."""
    if kind not in STEPPERS:
        raise InputError(f"stepper '{kind}' is not one of {', '.join(STEPPERS)}")
    return _named(STEPPERS[kind].make)


def open_stepper(path: Path | str, **options: object) -> Stepper:
    """The stepper in the file at `path`; options go to its opener. Raises InputError for a file of
    no kind."""
    if not isinstance(path, (str, Path)):
        raise InputError(f"{shown(path)} is no path of a stepper's file")
    suffix = Path(path).suffix
    kinds = [kind for kind in STEPPERS.values() if kind.opener and kind.suffix == suffix]
    if suffix == ".npz" and Path(path).is_file():
        form = str(load_arrays(path, "format").get("format"))
        kinds = [kind for kind in kinds if kind.format and form.startswith(kind.format)]
        if not kinds:
            raise InputError(f"{path} is damaged or no file of a stepper (format: {form})")
    for kind in kinds:
        opener = _named(str(kind.opener))
        takes(opener, options, f"the stepper of {path}")
        return opener(path, **options)
    known = ", ".join(f"{kind.suffix} ({kind.label})" for kind in STEPPERS.values() if kind.suffix)
    raise InputError(f"{path} is no file of a stepper; give one of {known}")


def _named(reference: str) -> Callable:
    module, _, name = reference.partition(":")
    return operator.attrgetter(name)(importlib.import_module(module))
