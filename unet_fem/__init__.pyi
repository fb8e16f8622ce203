from unet_fem.evaluate import evaluate as evaluate
from unet_fem.runtime.surrogate import Surrogate as Surrogate
from unet_fem.steppers import open_stepper as open_stepper
from unet_fem.train import train as train
from unet_fem.training.settings import Settings as Settings
from unet_fem.training.settings import load_settings as load_settings
