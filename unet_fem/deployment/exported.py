"""What deployment finds in a run's folder: the trained model, and the surrogates that it was
exported to, lite/<variant>.tflite. Looked for before anything heavy is imported."""

from pathlib import Path

from fem.errors import InputError
from unet_fem.networks.registry import network
from unet_fem.training.run import model_file as trained_file
from unet_fem.training.settings import Settings


def model_file(settings: Settings) -> Path:
    """The trained Keras model. Raises InputError if there is none."""
    if settings.stepped:
        file = trained_file(settings)
        raise InputError(
            f"{settings.folder} holds a {network(settings.model.kind).label}, no Keras model: it is"
            f" exported already, as {file} and float16.tflite beside it; time it beside another run"
            f" with python tools/benchmark.py runs/<other> --beside {file}"
        )
    path = settings.folder / "best.keras"
    if not path.is_file():
        raise InputError(f"no model {path}; train one with python -m unet_fem.train")
    return path


def lite_file(settings: Settings, variant: str) -> Path:
    """Where the surrogate of this variant belongs."""
    return settings.folder / "lite" / f"{variant}.tflite"


def files_there(settings: Settings) -> dict[str, Path]:
    """{variant: path} of the surrogates that are there, maybe none."""
    return {path.stem: path for path in sorted((settings.folder / "lite").glob("*.tflite"))}


def lite_files(settings: Settings) -> dict[str, Path]:
    """The same. Raises InputError if there are none."""
    files = files_there(settings)
    if not files:
        raise InputError(
            f"{settings.folder / 'lite'} holds no .tflite files;"
            f" make them with python tools/quantize.py {settings.folder}"
        )
    return files
