"""The run of a constitutive network: from its dataset over the reduced model to its files."""

import os
import shutil
import tempfile
from pathlib import Path

from tqdm import tqdm

from fem.data.dataset import Dataset
from fem.files import make_folder
from fem.online.reduced_model import ReducedModel
from fem.reduced.build import Choice, reduce
from unet_fem.deployment.constitutive import make_network
from unet_fem.networks.registry import Constitutive
from unet_fem.training.constitutive import Recipe
from unet_fem.training.judge import evaluate
from unet_fem.training.run import model_file
from unet_fem.training.settings import Settings

APART = ".partial-"  # of the folder that the network's files are made in


def train_constitutive(settings: Settings, dataset: Dataset, quiet: bool = False) -> dict:
    """All that `settings` asks for, into settings.folder, which unet_fem.training.run has made; a
    reduced model and a network that are there already are kept. Returns the metrics, see
    unet_fem.training.judge.evaluate."""
    done = model_file(settings)
    if not done.is_file():
        model = _reduced(settings, dataset)
        print("training the constitutive network", flush=True)
        options, hard = _options(settings), settings.samples.hard
        recipe = Recipe(options.steps) if options.steps else None
        for left in settings.folder.glob(f"{APART}*"):  # by a process that was killed
            shutil.rmtree(left)
        # elsewhere first: what is written on the way has no guard yet
        with tempfile.TemporaryDirectory(dir=settings.folder, prefix=APART) as apart:
            made = make_network(dataset, model, apart, hard, options.coarse, recipe, _tell)
            make_folder(done.parent)
            for path in sorted(made.values(), key=lambda path: path.name == done.name):
                os.replace(path, Path(done.parent, path.name))  # the judged one last
    return evaluate(settings, dataset, quiet)


def _reduced(settings, dataset):
    """The reduced model of the run."""
    kept = settings.folder / "reduced.npz"
    if kept.is_file():
        return ReducedModel.load(kept)
    options = _options(settings)
    choice = Choice(options.modes, options.inputs, options.points, settings.samples.hard)
    print("making the reduced model", flush=True)
    model, _ = reduce(dataset, choice, _tell, _progress)
    model.save(kept)
    return model


def _options(settings):
    assert isinstance(settings.model, Constitutive), "the one kind that comes here"
    return settings.model


def _tell(line):
    print(f"  {line}", flush=True)


def _progress(which):
    return tqdm(which, "  reading", unit=" interactions", disable=None)
