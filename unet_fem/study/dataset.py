"""The dataset of a study and its interactions: which of them competitors are judged on, their
loads, their forces frame by frame, and their simulation under other settings."""

from collections.abc import Iterable
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

Case = tuple[str, int]  # (split, number) of an interaction
SUBSETS = ("usual", "hard")


def study_dataset(study: Study) -> Dataset:
    """The dataset of the study: that of its first main network."""
    return open_dataset(study.data).for_learning()


def unseen(dataset: Dataset) -> dict[str, list[Case]]:
    """{"usual", "hard"}: every interaction that no competitor may learn from or be tuned on, each
    in one of the two. Hard are those that push harder than any in training: of the split "test"
    those marked so, and all of the split "hard"."""
    judged = np.isin(dataset.split, ("test", "hard"))
    hard = dataset.hard | (dataset.split == "hard")
    return {
        "usual": _cases(dataset, judged & ~hard),
        "hard": _cases(dataset, judged & hard),
    }


def headline(study: Study, dataset: Dataset) -> dict[str, list[Case]]:
    """The same of the interactions that have a converged reference: the usual ones of study.fem,
    and the first study.fem.hard of the hard. Raises InputError where study.fem names a hard one."""
    own = unseen(dataset)
    chosen = [("test", number) for number in study.fem.interactions]
    for case in chosen:
        if case in own["hard"]:
            raise InputError(
                f"fem.interactions has {case[1]}, a hard one; usual and hard are judged apart,"
                " and all hard ones are judged anyway: leave it out"
            )
        if case not in own["usual"]:
            dataset.sequence(*case)  # an InputError that says which there are
    return {"usual": chosen, "hard": own["hard"][: study.fem.hard]}


def name_of(case: Case) -> str:
    """A case in results, such as "test 80"."""
    return f"{case[0]} {case[1]}"


def named(subsets: dict[str, list[Case]]) -> dict[str, list[str]]:
    """{"usual", "hard"} with the names of the cases."""
    return {name: [name_of(case) for case in cases] for name, cases in subsets.items()}


def everything(subsets: dict[str, list[Case]]) -> list[Case]:
    """The cases of both subsets, the usual ones first."""
    return [case for name in SUBSETS for case in subsets[name]]


def in_order(dataset: Dataset, split: str, cases: Iterable[Case]) -> list[int]:
    """The numbers of the cases of `split`, in the order of the file."""
    have = {number for own, number in cases if own == split}
    return [n for n in dataset.number[dataset.split == split].tolist() if n in have]


def _cases(dataset, rows):
    pairs = zip(dataset.split[rows].tolist(), dataset.number[rows].tolist(), strict=True)
    return sorted(pairs, key=lambda case: (case[0] != "test", case[1]))


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
