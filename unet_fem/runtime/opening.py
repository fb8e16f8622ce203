"""The stepper of a .tflite file, whichever it is."""

from pathlib import Path
from typing import Any

from fem.files import load_arrays
from fem.online.stepper import Stepper
from fem.ranges import takes
from unet_fem.runtime.constitutive import FORMAT as CONSTITUTIVE
from unet_fem.runtime.constitutive import ConstitutiveSurrogate
from unet_fem.runtime.fallback import Fallback
from unet_fem.runtime.modal import FORMAT as MODAL
from unet_fem.runtime.modal import ModalSurrogate
from unet_fem.runtime.surrogate import Surrogate


def open_surrogate(path: str | Path, fallback: Stepper | None = None, **options: Any) -> Stepper:
    """The stepper of a .tflite file, a ConstitutiveSurrogate, ModalSurrogate or Surrogate; options
    go to it. fallback: a solver for the frames that a constitutive network flags, see Fallback."""
    form = str(load_arrays(path, "format").get("format"))
    kinds = {CONSTITUTIVE[:-1]: ConstitutiveSurrogate, MODAL[:-1]: ModalSurrogate}
    kind = next((own for start, own in kinds.items() if form.startswith(start)), Surrogate)
    takes(kind, options, f"the stepper of {path}")
    surrogate: Any = kind(path, **options)
    if kind is ConstitutiveSurrogate and fallback is not None:
        return Fallback(surrogate, fallback)
    return surrogate
