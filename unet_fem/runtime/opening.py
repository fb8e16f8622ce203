"""The stepper of a .tflite file, whichever it is."""

from pathlib import Path
from typing import Any

from fem.files import load_arrays
from fem.online.stepper import Stepper
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
    if form.startswith(CONSTITUTIVE[:-1]):
        surrogate = ConstitutiveSurrogate(path, **options)
        return surrogate if fallback is None else Fallback(surrogate, fallback)
    if form.startswith(MODAL[:-1]):
        return ModalSurrogate(path, **options)
    return Surrogate(path, **options)
