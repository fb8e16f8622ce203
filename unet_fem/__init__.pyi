from unet_fem.runtime.surrogate import Surrogate as Surrogate
from unet_fem.training.fit import train as train
from unet_fem.training.judge import evaluate as evaluate
from unet_fem.training.settings import Settings as Settings
from unet_fem.training.settings import load_settings as load_settings
