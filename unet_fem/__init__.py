"""Networks that learn the displacement of soft tissue from the forces on it.

The public names are imported from their modules when they are first asked for.
"""

from fem.former import remember
from fem.lazy import exports
from unet_fem.former import FORMER, GONE

__getattr__, __dir__, __all__ = exports(
    __name__,
    {
        "unet_fem.evaluate": "evaluate",
        "unet_fem.runtime.surrogate": "Surrogate",
        "unet_fem.steppers": "open_stepper",
        "unet_fem.train": "train",
        "unet_fem.training.settings": "Settings load_settings",
    },
)
remember(FORMER, GONE)
