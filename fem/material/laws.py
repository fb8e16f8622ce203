"""The laws of this package by the names that files have for them."""

from typing import Any

from fem.material.mooney_rivlin import MooneyRivlin
from fem.material.neo_hooke import NeoHooke
from fem.material.ogden import Ogden

KINDS: dict[str, Any] = {"neo_hooke": NeoHooke, "mooney_rivlin": MooneyRivlin, "ogden": Ogden}
