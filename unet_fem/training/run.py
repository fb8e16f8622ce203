"""The folder of a training run: made, opened, and matched with its dataset."""

import subprocess
import sys
from pathlib import Path

from fem.data.dataset import open_dataset
from fem.data.scene import load_scene
from fem.errors import InputError
from unet_fem.training import settings as config


def open_run(folder):
    """(settings, dataset) of the run in `folder`. Raises InputError if it is no run or does not fit
    its dataset."""
    folder = Path(folder)
    if not (folder / "config.toml").is_file():
        raise InputError(
            f"{folder} is not a training run (it has no config.toml); make one with python -m unet_fem.train"
        )
    settings = config.load_settings(folder / "config.toml")
    if settings.folder.resolve() != folder.resolve():
        raise InputError(
            f"{folder} was made as {settings.folder}; run from the folder that holds {settings.folder}"
        )
    return settings, open_dataset(settings.data)


def ensure_dataset(settings):
    """The dataset of `settings`, generated first if its file is missing. Raises InputError if it is
    another scene's."""
    scene, path = load_scene(settings.scene), Path(settings.data)
    if not path.is_file():
        print(
            f"{path} is missing: simulating {len(scene.interactions.all())} interactions of {settings.scene}",
            flush=True,
        )
        # a process of its own: its workers would otherwise import this one's libraries
        code = subprocess.run(
            [sys.executable, "-m", "fem.generate", settings.scene, "--out", str(path), "--quiet"]
        ).returncode
        if code:
            sys.exit(code)
    dataset = open_dataset(path)
    if dataset.scene != scene:
        raise InputError(
            f"{path} was made from another scene than {settings.scene}; delete it or give another data="
        )
    return dataset


def prepare_folder(settings, resume):
    """Make the run's folder with its settings. Raises InputError if it holds another run, or this
    one without `resume`."""
    folder, text = settings.folder, settings.toml()
    written = folder / "config.toml"
    if written.is_file():
        if not resume:
            raise InputError(
                f"{folder} exists already; add --resume to go on with it, or give another name="
            )
        if written.read_text() != text:
            raise InputError(
                f"{folder} was started with other settings (see {written}); give the same, or another name="
            )
    elif resume:
        raise InputError(f"there is no run {folder} to resume; leave --resume out to start it")
    folder.mkdir(parents=True, exist_ok=True)
    written.write_text(text)
