"""What the model of a run sees in place of the forces, made from its settings or read from its
folder."""

from fem.data.dataset import Dataset
from fem.data.elastic import elastic_answer
from fem.online.creep import Creep
from fem.online.input_field import FILE, InputField
from unet_fem.training.settings import InputChoice, Settings


def input_field(choice: InputChoice, dataset: Dataset) -> InputField | None:
    """The InputField of `choice` on the mesh and material of `dataset`; None where it is the
    force itself, as remembered forces of elastic tissue are too.

    Raises InputError for an elastic answer on a mesh that is embedded in the grid.
    """
    creep = Creep.of(dataset.scene.material.prony if choice.memory == "creep" else ())
    elastic = elastic_answer(dataset) if choice.physics == "elastic" else None
    return InputField(dataset.grid, creep, elastic) if creep.terms or elastic else None


def run_input(settings: Settings, dataset: Dataset) -> InputField | None:
    """That of the run of `settings`, from its folder where it is kept."""
    if settings.input == InputChoice():
        return None
    path = settings.folder / FILE
    return InputField.load(path) if path.is_file() else input_field(settings.input, dataset)


def keep_input(settings: Settings, dataset: Dataset, field: InputField | None) -> None:
    """Write the InputField of a network to its run's folder; a regression's file holds its own."""
    path = settings.folder / FILE
    if field and not settings.fitted and not path.is_file():
        field.save(path, dataset.free)
