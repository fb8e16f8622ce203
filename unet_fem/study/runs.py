"""The runs of a study: train, export and prune what is missing, each by the command that a reader
would give."""

import subprocess
import sys

from fem.errors import InputError
from unet_fem.training.run import open_run, read_settings


def train_networks(study):
    """Train every network that has no metrics yet; one that was cut off goes on where it was."""
    for number, network in enumerate(study.networks, 1):
        settings = network.settings
        written = settings.folder / "config.toml"
        if written.is_file() and read_settings(settings.folder) != settings:
            raise InputError(
                f"{settings.folder} was made with other settings than the study's network '{network.name}'; delete it or rename the network"
            )
        if (settings.folder / "metrics.json").is_file():
            open_run(settings.folder)  # refuses one that was trained on another mesh
            continue
        print(f"\nnetwork {number} of {len(study.networks)}: {network.name}", flush=True)
        resume = ["--resume"] if written.is_file() else []
        command(
            "-m",
            "unet_fem.train",
            network.config,
            *network.changes,
            f"name={network.name}",
            *resume,
        )


def deploy(study):
    """Export every deployed run, prune the two main ones both ways, and export what that makes."""
    for name in study.deployed:
        export(study.network(name).folder)
    sparsity = [str(share) for share in study.prune]
    for name, epochs in zip((study.cnn_lstm, study.unet), study.prune_epochs):
        folder = study.network(name).folder
        for kind, flags in (("weights", []), ("filters", ["--filters"])):
            if not (folder / f"pruning_{kind}.json").is_file():
                command(
                    "tools/prune.py",
                    str(folder),
                    *flags,
                    "--sparsity",
                    *sparsity,
                    "--epochs",
                    str(epochs),
                    "--rounds",
                    str(study.rounds),
                )


def export(folder):
    if not (folder / "quantization.json").is_file():
        command("tools/quantize.py", str(folder))


def pruned_runs(study, name):
    """{label: run name} of what pruning makes of the run called `name`."""
    kinds = {"thin": "filters or units removed", "pruned": "zeros in the convolutions"}
    return {
        f"{100 * share:.0f} % {text}": f"{name}_{kind}{100 * share:.0f}"
        for kind, text in kinds.items()
        for share in study.prune
    }


def command(*words):
    """Run one of the project's own commands from the folder that holds it; stop with its exit code
    if it fails."""
    print("$ python " + " ".join(words), flush=True)
    code = subprocess.run([sys.executable, *words]).returncode
    if code:
        print(
            f"stopped by the command above (exit code {code}); what is done is kept: give the same command again",
            file=sys.stderr,
        )
        sys.exit(code)
