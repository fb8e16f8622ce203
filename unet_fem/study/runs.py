"""The runs of a study: train, export and prune what is missing, each by the command that a reader
would give."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from fem.errors import InputError
from unet_fem.deployment.exported import files_there
from unet_fem.study.settings import Study
from unet_fem.training.run import open_run, read_settings
from unet_fem.training.settings import Settings

KERAS = "tf.function"  # the form that a Keras model is timed in, and under which it is judged
SMALLER = {"thin": "filters or units removed", "pruned": "zeros in the convolutions"}


@dataclass(frozen=True)
class Smaller:
    """A run that pruning makes: its name, the main run that it comes from, how ("thin" or
    "pruned") and the share that is gone."""

    name: str
    parent: str
    how: str
    share: float

    @property
    def label(self) -> str:
        """What is gone, in words."""
        return f"{100 * self.share:.0f} % {SMALLER[self.how]}"


class CommandFailed(RuntimeError):
    """A command of the study ended with `code`; the message says how to go on."""

    def __init__(self, words: tuple[str, ...], code: int) -> None:
        super().__init__(
            f"stopped by python {' '.join(words)} (exit code {code}); what is done is kept:"
            " give the same command again"
        )
        self.code = code


def smaller_runs(study: Study) -> list[Smaller]:
    """What tools/prune.py makes of the main runs, named as it names them."""
    return [
        Smaller(f"{main.run}_{how}{100 * share:.0f}", main.run, how, share)
        for main in study.main
        for how in SMALLER
        for share in study.prune
    ]


def trained_runs(study: Study) -> dict[str, tuple[Settings, str | None]]:
    """{name: (settings, the run that it was pruned from or None)} of the study's networks that are
    trained to the end and of what pruning made of the main ones.

    Raises InputError where they learned from different data.
    """
    names: dict[str, tuple[str, str | None]] = {
        network.name: ("metrics.json", None) for network in study.networks
    }
    names |= {run.name: ("pruned", run.parent) for run in smaller_runs(study)}
    found: dict[str, tuple[Settings, str | None]] = {}
    for name, (done, parent) in names.items():
        folder = study.folder.parent / name
        if (folder / done).is_file():
            found[name] = read_settings(folder), parent
    for name, (settings, _) in found.items():
        if settings.data != study.data:
            raise InputError(
                f"run '{name}' is of {settings.data}, '{study.main[0].run}' of {study.data};"
                " give all networks of a study the same data"
            )
    return found


def deployed_runs(study: Study) -> dict[str, tuple[Settings, str | None]]:
    """Those of `trained_runs` that are exported: the deployed ones and what pruning made."""
    names = [*study.deployed, *(run.name for run in smaller_runs(study))]
    runs = trained_runs(study)
    return {name: runs[name] for name in dict.fromkeys(names) if name in runs}


def run_files(settings: Settings) -> list[Path]:
    """All files of a run that a measurement may read."""
    own = [settings.folder / name for name in ("config.toml", "best.keras", "history.json")]
    return [path for path in own if path.is_file()] + list(files_there(settings).values())


def train_networks(study: Study) -> None:
    """Train every network that has no metrics yet; one that was cut off goes on where it was."""
    for number, network in enumerate(study.networks, 1):
        settings = network.settings
        begun = (settings.folder / "config.toml").is_file()
        if begun and read_settings(settings.folder) != settings:
            raise InputError(
                f"{settings.folder} was made with other settings than the study's network"
                f" '{network.name}'; delete it or rename the network"
            )
        if (settings.folder / "metrics.json").is_file():
            open_run(settings.folder)  # refuses one that was trained on another mesh
            continue
        print(f"\nnetwork {number} of {len(study.networks)}: {network.name}", flush=True)
        resume = ["--resume"] if begun else []
        command(
            "-m",
            "unet_fem.train",
            network.config,
            *network.changes,
            f"name={network.name}",
            *resume,
        )


def deploy(study: Study) -> None:
    """Export every deployed run, and prune the main ones both ways."""
    for name in study.deployed:
        folder = study.network(name).folder
        if not (folder / "quantization.json").is_file():
            command("tools/quantize.py", str(folder))
    sparsity = [str(share) for share in study.prune]
    for main in study.main:
        folder = study.network(main.run).folder
        for kind, flags in (("weights", []), ("filters", ["--filters"])):
            if not (folder / f"pruning_{kind}.json").is_file():
                command(
                    "tools/prune.py",
                    str(folder),
                    *flags,
                    "--sparsity",
                    *sparsity,
                    "--epochs",
                    str(main.prune_epochs),
                    "--rounds",
                    str(study.rounds),
                )


def make_long_data(study: Study) -> None:
    """Simulate the long interactions whose dataset is missing."""
    for own in study.long:
        if not Path(own.data).is_file():
            command("-m", "fem.generate", own.scene, "--out", own.data)


def command(*words: str) -> None:
    """Run one of the project's own commands from the folder that holds it. Raises CommandFailed
    with its exit code if it fails."""
    print("$ python " + " ".join(words), flush=True)
    code = subprocess.run([sys.executable, *words]).returncode
    if code:
        raise CommandFailed(words, code)
