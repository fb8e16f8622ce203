from fem.online.volume import VOLUME_BAND as VOLUME_BAND
from unet_fem.runtime.constitutive import ConstitutiveSurrogate as ConstitutiveSurrogate
from unet_fem.runtime.constitutive import open_surrogate as open_surrogate
from unet_fem.runtime.surrogate import Surrogate as Surrogate
from unet_fem.runtime.surrogate import force_size as force_size
from unet_fem.runtime.surrogate_file import read_surrogate as read_surrogate
from unet_fem.runtime.surrogate_file import write_surrogate as write_surrogate
