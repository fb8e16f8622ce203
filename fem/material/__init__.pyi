from fem.material.base import Hyperelastic as Hyperelastic
from fem.material.kinds import KINDS as KINDS
from fem.material.mooney_rivlin import MooneyRivlin as MooneyRivlin
from fem.material.neo_hooke import NeoHooke as NeoHooke
from fem.material.ogden import Ogden as Ogden
