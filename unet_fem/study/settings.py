"""Settings of a study, read from a TOML file: which networks it trains and which competitors it
measures."""

from dataclasses import dataclass, field
from pathlib import Path

from fem import settings as config
from fem.errors import InputError
from unet_fem.training.settings import load_settings


@dataclass(frozen=True)
class Network:
    """A training run: its name, its configuration file and the key=value changes laid over that."""

    name: str
    config: str
    changes: tuple[str, ...] = ()

    @property
    def settings(self):
        return load_settings(self.config, [*self.changes, f"name={self.name}"])


@dataclass(frozen=True)
class Arm:
    """One side of a comparison: runs that differ in their seeds alone."""

    label: str
    runs: tuple[str, ...]


@dataclass(frozen=True)
class Fem:
    """The FEM as a competitor at fixed latency.

    interactions: numbers of the test interactions that the headline figure judges every competitor
    on, besides the hard ones
    steps: warm-started steps a frame; frames: lengths of a frame in s
    reference_safety: share of the critical step that the reference takes; checked: interactions
    that its own error is measured on
    """

    interactions: tuple[int, ...]
    steps: tuple[int, ...] = (1, 2, 5, 11, 22, 44, 100, 200)
    frames: tuple[float, ...] = (0.01, 0.25)
    reference_safety: float = 0.85
    checked: int = 3


@dataclass(frozen=True)
class Stability:
    """Test interactions whose forces are multiplied by each factor, to see how far every competitor
    holds."""

    interactions: tuple[int, ...]
    factors: tuple[float, ...] = (0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True)
class Study:
    """name: of the folder under runs/ for what is measured; the runs themselves lie beside it

    cnn_lstm, unet: the runs that are pruned and shown in every figure; deployed: those that are
    exported in every form
    configurations: runs of the paper's table of configurations; physics: arms of the comparison
    with and without the volume term, the first of them without; learning_rate: two runs, the
    schedule first; window: two runs, the shorter first
    prune: shares to remove; prune_epochs: of fine-tuning the
    CNN-LSTM and the U-Net
    pod_modes: numbers of modes of the POD with regression; long_scene: scene of the long
    interactions and its dataset
    rounds: timings of each competitor; notes: {section of the page: what its numbers mean, in
    words}
    """

    name: str
    networks: tuple[Network, ...]
    cnn_lstm: str
    unet: str
    configurations: tuple[str, ...]
    deployed: tuple[str, ...]
    physics: tuple[Arm, ...]
    learning_rate: tuple[str, str]
    window: tuple[str, str]
    fem: Fem
    stability: Stability
    long_scene: str
    long_data: str
    prune: tuple[float, ...] = (0.5, 0.8)
    prune_epochs: tuple[int, int] = (10, 3)
    pod_modes: tuple[int, ...] = (5, 10, 20, 40, 80, 160)
    rounds: int = 200
    notes: dict = field(default_factory=dict)

    def __post_init__(self):
        names = [network.name for network in self.networks]
        if len(set(names)) < len(names):
            raise InputError("networks: two have the same name; a run's name must be its own")
        used = [
            self.cnn_lstm,
            self.unet,
            *self.configurations,
            *self.deployed,
            *self.learning_rate,
            *self.window,
            *(run for arm in self.physics for run in arm.runs),
        ]
        for name in used:
            if name not in names:
                raise InputError(
                    f"run '{name}' is not among the networks of the study: {', '.join(names)}"
                )

    @property
    def folder(self):
        return Path("runs") / self.name

    def network(self, name):
        """The Settings of the run called `name`."""
        return next(network.settings for network in self.networks if network.name == name)


def load_study(path, overrides=()):
    return config.build(
        Study, config.merge(config.read_toml(path), config.parse_overrides(overrides))
    )
