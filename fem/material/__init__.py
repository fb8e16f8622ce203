"""Constitutive laws of soft tissue."""

from fem.former import moved
from fem.lazy import exports

__getattr__, __dir__, __all__ = exports(
    __name__,
    {
        "fem.material.base": "Hyperelastic",
        "fem.material.neo_hooke": "NeoHooke",
        "fem.material.mooney_rivlin": "MooneyRivlin",
        "fem.material.ogden": "Ogden",
        "fem.material.kinds": "KINDS",
    },
)
__getattr__ = moved(__name__, __getattr__)
