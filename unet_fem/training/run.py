"""The folder of a training run: vetted, made, opened, and matched with its dataset."""

import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fem import settings as config
from fem.data.dataset import Dataset, open_dataset
from fem.data.scene import Scene, load_scene
from fem.errors import InputError
from fem.files import checked_path, read_json, vet_output, write_text
from fem.locks import lock
from fem.material import NeoHooke
from fem.memory import require_memory
from fem.reduced.points import check_element
from unet_fem.networks.registry import CnnLstm, network
from unet_fem.training.settings import Settings, foreign, from_tree, unused, without

# of the one table for all kinds that runs made before 0.2 hold in full
OLD_DEFAULTS = {"units": 512, "steps": 2, "filters": 64}


def read_settings(folder: Path | str) -> Settings:
    """The settings that the run in `folder` was started with. Raises InputError if it is no run."""
    written = checked_path(folder) / "config.toml"
    if not written.is_file():
        raise InputError(
            f"{folder} is not a training run (it has no config.toml);"
            " make one with python -m unet_fem.train"
        )
    tree = config.read_toml(written)
    model = tree.get("model", {})
    if not isinstance(model, dict):
        return from_tree(tree)  # refuses it
    kind = model.get("kind", CnnLstm.kind)
    # migration: runs made before 0.2 hold the options of every kind, those of others at their
    # defaults, and those of later hold what a regression has no use for
    for name in foreign(model, network(kind).options):
        if model[name] == OLD_DEFAULTS.get(name):
            del model[name]
    return from_tree(without(tree, unused(kind)))


# files of a run's folder: the digest of the mesh that it was trained on, the scene of its data
MESH, SCENE = "mesh.sha256", "scene.toml"
COMPARISON = "comparison.json"  # with the runs beside it


def check_dataset(folder: Path | str, dataset: Dataset) -> None:
    """Raises InputError unless the run in `folder` was trained on the mesh and the scene of
    `dataset`: on its numbers, which follow from the two. Runs made before scenes were kept are
    judged by the mesh alone."""
    record = Path(folder, MESH)
    if not record.is_file():
        raise InputError(
            f"{folder} does not say on which mesh it was trained ({MESH} is missing: it is from"
            " before version 0.2); train it again under another name="
        )
    another = None
    if record.read_bytes().strip() != dataset.mesh_digest.encode():
        another = "mesh"
    elif Path(folder, SCENE).is_file() and _scene_of(folder) != dataset.scene:
        another = "scene"
    if another:
        raise InputError(
            f"{folder} was trained on another {another} than {dataset.path} holds; train it again"
            " under another name=, or give its dataset back"
        )


def _scene_of(folder):
    path = Path(folder, SCENE)
    try:
        return config.build(Scene, tomllib.loads(path.read_bytes().decode()))
    except ValueError as error:  # InputError among them
        raise InputError(f"{path} is damaged ({error}); delete {folder} and train again") from None


def open_run(folder: Path | str) -> tuple[Settings, Dataset]:
    """(settings, dataset) of the run in `folder`. Raises InputError if it is no run or does not fit
    its dataset."""
    settings = read_settings(folder)
    if settings.folder.resolve() != Path(folder).resolve():
        raise InputError(
            f"{folder} was made as {settings.folder};"
            f" run from the folder that holds {settings.folder}"
        )
    dataset = open_dataset(settings.data).for_learning()
    check_dataset(folder, dataset)
    return settings, dataset


@contextmanager
def locked_run(folder: Path | str) -> Iterator[tuple[Settings, Dataset]]:
    """What `open_run` gives, while no other command may write to the run. Raises InputError where
    one does."""
    settings, _ = open_run(folder)  # no lock lies beside what is no run
    with lock(settings.folder):
        yield open_run(folder)


def model_file(settings: Settings) -> Path:
    """Where the run keeps what it has made: its best network, its regression, or the file of its
    stepper."""
    if settings.stepped:
        return settings.folder / "lite" / "float32.tflite"
    return settings.folder / ("regression.npz" if settings.fitted else "best.keras")


def vet(settings: Settings, resume: bool = False) -> None:
    """Raises InputError for all that can be wrong with `settings` before anything is made: the
    folder, the scene, the dataset if there is one, and the network on its grid; of the runs beside
    it too."""
    if not isinstance(settings, Settings):
        raise InputError(f"{str(settings)[:60]} are no Settings; take unet_fem's load_settings")
    vet_folder(settings, resume)
    vet_output(settings.folder, folder=True)
    scene = load_scene(settings.scene)
    _vet_scene(settings, scene)
    grid: tuple[int, ...] | None
    if Path(settings.data).is_file():
        dataset = matching_dataset(settings, scene)
        if (settings.folder / "config.toml").is_file():
            check_dataset(settings.folder, dataset)
        grid = dataset.grid
    else:
        vet_output(settings.data)
        grid = scene.mesh.grid or scene.mesh.build().grid_shape
    if grid:  # without one the dataset cannot be made, and making it tells why
        nx, ny, nz = grid
        settings.model.check((nx, ny, nz))
        _vet_size(settings, scene, (nx, ny, nz))
    for other in settings.others:
        vet(other, begun(other))


def begun(settings: Settings) -> bool:
    """Whether there is a folder of the run."""
    return (settings.folder / "config.toml").is_file()


def _vet_scene(settings, scene):
    """Raises InputError where the scene does not have what the run asks for."""
    have = scene.interactions.hard_set
    if settings.samples.hard > have:
        raise InputError(
            f"samples.hard = {settings.samples.hard}, and {settings.scene} has {have} hard"
            " interactions (interactions.hard_set)"
        )
    if settings.stepped:
        check_element(scene.solver.element)
        if scene.mesh.grid:
            raise InputError(
                f"the mesh of {settings.scene} has no node grid of its own, on which a run is"
                " judged; from Python unet_fem.deployment.constitutive.make_network serves it"
            )
        if type(scene.material) is not NeoHooke:
            raise InputError(
                f"a constitutive network contains the neo-Hookean law alone, and {settings.scene}"
                f" has {type(scene.material).__name__}; train another model.kind"
            )


def _vet_size(settings, scene, grid):
    """Raises InputError where the windows, or the weights with what Adam keeps, exceed memory."""
    frames, (nx, ny, nz) = scene.frames.count, grid
    count = scene.interactions.train + settings.samples.hard
    windows = count * frames * ((settings.model.window or 1) + 1)
    if not settings.stepped:  # which reads one interaction at a time
        require_memory(
            12 * windows * nx * ny * nz,
            f"the windows of {count} interactions",
            f"lower model.steps = {settings.model.window} or take fewer interactions",
        )
    weights = settings.model.weights(grid)
    own = ", ".join(f"model.{name} = {value}" for name, value in settings.model.own().items())
    require_memory(16 * weights, f"a network of {weights:.3g} weights ({own})", "lower them")


def vet_folder(settings: Settings, resume: bool = False) -> None:
    """Raises InputError if the run's folder holds another run, or this one finished without
    `resume`, or none with `resume`."""
    folder = settings.folder
    if not (folder / "config.toml").is_file():
        if resume:
            raise InputError(f"there is no run {folder} to resume; leave --resume out to start it")
        return
    if read_settings(folder) != settings:
        raise InputError(
            f"{folder} was started with other settings (see {folder / 'config.toml'});"
            " give the same, or another name="
        )
    if finished(settings) and not resume:
        raise InputError(
            f"{folder} exists already and is finished; give another name=, or judge it again with"
            f" python -m unet_fem.evaluate {folder}"
        )


def finished(settings: Settings) -> bool:
    """Whether the run has had all its epochs and was judged, and compared with those beside it."""
    history = settings.folder / "history.json"  # a regression has none
    last = ["metrics.json", COMPARISON] if settings.beside else ["metrics.json"]
    if not all((settings.folder / name).is_file() for name in last):
        return False
    if not history.is_file():
        return True
    return settings.train.epochs <= max(map(len, read_history(history).values()), default=0)


def read_history(path: Path) -> dict[str, list[float]]:
    """{name: value of each epoch} of a run's history. Raises InputError where it is damaged."""
    history = read_json(path)
    if not all(
        isinstance(values, list) and all(isinstance(value, (int, float)) for value in values)
        for values in history.values()
    ):
        raise InputError(f"{path} is damaged (not lists of numbers); delete {path.parent}")
    return history


def prepare_folder(settings: Settings, dataset: Dataset, resume: bool = False) -> None:
    """Make the run's folder with its settings and the mesh of its dataset, see `vet_folder`; one
    that is there must be of this dataset, see `check_dataset`."""
    vet_folder(settings, resume)
    if (settings.folder / "config.toml").is_file():
        check_dataset(settings.folder, dataset)
    else:
        write_text(settings.folder / MESH, dataset.mesh_digest + "\n")
        write_text(settings.folder / SCENE, dataset.scene.toml())
    write_text(settings.folder / "config.toml", settings.toml())


def matching_dataset(settings: Settings, scene: Scene) -> Dataset:
    """The dataset of `settings`. Raises InputError if it is missing, damaged, another scene's, or
    for reading only."""
    dataset = open_dataset(settings.data)
    if dataset.scene != scene:
        raise InputError(
            f"{settings.data} was made from another scene than {settings.scene};"
            " delete it or give another data="
        )
    return dataset.for_learning()


def ensure_dataset(settings: Settings) -> Dataset:
    """The dataset of `settings`, generated first if its file is missing. Raises InputError if it
    cannot be made or is another scene's, KeyboardInterrupt if making it was interrupted."""
    scene, path = load_scene(settings.scene), Path(settings.data)
    if not path.is_file():
        count = len(scene.interactions.all())
        print(f"{path} is missing: simulating {count} interactions of {settings.scene}", flush=True)
        # a process of its own: its workers would otherwise import this one's libraries
        command = ["-m", "fem.generate", settings.scene, "--out", str(path), "--quiet"]
        code = subprocess.run([sys.executable, *command]).returncode
        if code == 130:
            raise KeyboardInterrupt
        if code:
            raise InputError(
                f"{path} was not made, for the reason above (exit code {code});"
                " mend it and give the same command again"
            )
    return matching_dataset(settings, scene)
