"""The dataset of a study and its interactions: their loads, their forces frame by frame, and their
simulation under other settings."""

from dataclasses import replace

import numpy as np

from fem.contact.push import Load
from fem.contact.surface import surface_of
from fem.data.dataset import Dataset, open_dataset
from fem.data.interaction import simulate
from fem.data.scene import Scene
from fem.errors import InputError
from fem.mesh.hexmesh import HexMesh
from fem.online.grid import MN
from unet_fem.study.settings import Study


def study_dataset(study: Study) -> Dataset:
    """The dataset of the study: that of its first main network."""
    return open_dataset(study.data).for_learning()


def hard_numbers(dataset: Dataset) -> list[int]:
    """Numbers of the test interactions that push harder than any in training."""
    return dataset.number[dataset.hard & (dataset.split == "test")].tolist()


def judged_numbers(study: Study, dataset: Dataset) -> list[int]:
    """Numbers of the test interactions that competitors are judged on: those of study.fem and the
    hard ones."""
    have = set(dataset.number[dataset.split == "test"].tolist())
    for number in study.fem.interactions:
        if number not in have:
            dataset.sequence("test", number)  # an InputError that says which there are
    return sorted({*study.fem.interactions, *hard_numbers(dataset)})


def load_of(dataset: Dataset, split: str, number: int, factor: float = 1.0) -> Load:
    """The load of an interaction on the dataset's mesh, continuous in time, times `factor`."""
    own = dataset.contacts(split, number)
    found = [replace(contact, peak=factor * contact.peak) for contact in own]
    return Load(surface_of(dataset.fem_mesh), found)


def simulated(
    dataset: Dataset,
    split: str,
    number: int,
    scene: Scene | None = None,
    mesh: HexMesh | None = None,
) -> dict:
    """What fem.data.interaction.simulate gives for the contacts of an interaction in another scene
    and on another mesh than the dataset's. Raises SolverStopped."""
    mesh = dataset.fem_mesh if mesh is None else mesh
    contacts = dataset.contacts(split, number)
    return simulate(scene or dataset.scene, mesh, contacts, surface_of(mesh))


def frame_forces(dataset: Dataset, split: str, number: int, frame: float) -> np.ndarray:
    """(frames, nx, ny, nz, 3) float32 mN: the forces of an interaction every `frame` seconds, the
    first at `frame`; on the grid.

    Raises InputError if the dataset's frames do not lie among them.
    """
    scene, load = dataset.scene, load_of(dataset, split, number)
    times = frame * np.arange(1, frames_between(scene, frame) * (scene.frames.count - 1) + 1)
    return dataset.force_on_grid(np.stack([(load(t).T * MN).astype(np.float32) for t in times]))


def frames_between(scene: Scene, frame: float) -> int:
    """Number of frames of `frame` seconds to one of the dataset."""
    ratio = scene.frames.interval / frame
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
        raise InputError(
            f"fem.frames has {frame} s, which does not divide the {scene.frames.interval} s between"
            " the dataset's frames; give a whole share of it"
        )
    return round(ratio)
