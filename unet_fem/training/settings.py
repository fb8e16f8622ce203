"""Settings of one training run, read from a TOML file and key=value overrides."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fem import settings as config
from fem.errors import InputError

QUICK = Path("configs/quick.toml")


@dataclass(frozen=True)
class ModelChoice:
    """kind "cnn_lstm" takes units and steps (of the window), "unet" takes filters."""

    kind: Literal["cnn_lstm", "unet"] = "cnn_lstm"
    units: int = 512
    steps: int = 2
    filters: int = 64

    def __post_init__(self):
        for name in ("units", "steps", "filters"):
            if getattr(self, name) < 1:
                raise InputError(f"model.{name} = {getattr(self, name)} must be at least 1")

    @property
    def window(self):
        """Frames of force that the model sees at once; None if it sees one frame and has no time
        axis."""
        return self.steps if self.kind == "cnn_lstm" else None


@dataclass(frozen=True)
class LossChoice:
    """See unet_fem.training.losses.volume_loss; volume_weight 0 leaves the volume term out."""

    volume_weight: float = 0.1
    volume_threshold: float = 0.07
    direction_weight: float = 0.0

    def __post_init__(self):
        for name in ("volume_weight", "volume_threshold", "direction_weight"):
            if not getattr(self, name) >= 0:
                raise InputError(f"loss.{name} = {getattr(self, name)} must not be negative")


@dataclass(frozen=True)
class TrainChoice:
    """schedule "cosine" lets the learning rate fall to zero at the last epoch; precision is Keras's
    global policy."""

    epochs: int
    batch_size: int = 16
    learning_rate: float = 1e-3
    schedule: Literal["cosine", "constant"] = "cosine"
    precision: Literal["float32", "mixed_bfloat16"] = "float32"
    seed: int = 1

    def __post_init__(self):
        if self.epochs < 1 or self.batch_size < 1 or not 0 < self.learning_rate < 1:
            raise InputError(
                f"train: epochs = {self.epochs} and batch_size = {self.batch_size} must be at least 1,"
                f" and learning_rate = {self.learning_rate} between 0 and 1"
            )


@dataclass(frozen=True)
class Settings:
    """name: of the folder under runs/; scene: scene file; data: HDF5 file, generated from the scene
    if missing."""

    name: str
    scene: str
    data: str
    train: TrainChoice
    model: ModelChoice = field(default_factory=ModelChoice)
    loss: LossChoice = field(default_factory=LossChoice)

    def __post_init__(self):
        if not self.name or Path(self.name).name != self.name:
            raise InputError(
                f"name = '{self.name}' must be a plain folder name; it is made under runs/"
            )

    @property
    def folder(self):
        return Path("runs") / self.name

    def toml(self):
        return config.dump_toml(config.to_dict(self))


def load_settings(path, overrides=()):
    """Settings from the TOML file at `path`, with ["key=value", ...] laid over it."""
    tree = config.merge(config.read_toml(path), config.parse_overrides(overrides))
    return config.build(Settings, tree)
