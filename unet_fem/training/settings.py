"""Settings of one training run, read from a TOML file and key=value overrides."""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from fem import settings as config
from fem.errors import InputError
from fem.online.volume import VOLUME_BAND
from unet_fem.networks.registry import NETWORKS, CnnLstm, Options, network

QUICK = Path("configs/quick.toml")


@dataclass(frozen=True)
class LossChoice:
    """See unet_fem.training.losses.volume_loss; volume_weight 0 leaves the volume term out.

    volume_of: the volume that it watches and that the threshold is a share of, of all cells or of
    the mesh's cell set "tumour" alone: the paper says both.
    """

    volume_weight: float = 0.1
    volume_threshold: float = VOLUME_BAND
    volume_of: Literal["all", "tumour"] = "all"
    direction_weight: float = 0.0

    def __post_init__(self) -> None:
        config.normalised(self)
        for name in ("volume_weight", "volume_threshold", "direction_weight"):
            if not getattr(self, name) >= 0:
                raise InputError(f"loss.{name} = {getattr(self, name)} must not be negative")


@dataclass(frozen=True)
class TrainChoice:
    """schedule "cosine" lets the learning rate fall to zero at the last epoch; precision is Keras's
    policy. A regression is fitted in closed form and reads none of it."""

    epochs: int
    batch_size: int = 16
    learning_rate: float = 1e-3
    schedule: Literal["cosine", "constant"] = "cosine"
    precision: Literal["float32", "mixed_bfloat16"] = "float32"
    seed: int = 1

    def __post_init__(self) -> None:
        config.normalised(self)
        if self.epochs < 1 or self.batch_size < 1 or not 0 < self.learning_rate < 1:
            raise InputError(
                f"train: epochs = {self.epochs} and batch_size = {self.batch_size} must be at least"
                f" 1, and learning_rate = {self.learning_rate} between 0 and 1"
            )


@dataclass(frozen=True)
class Settings:
    """name: of the folder under runs/; scene: scene file; data: HDF5 file, generated from the scene
    if missing; model: the options of its kind, see unet_fem.networks.registry."""

    name: str
    scene: str
    data: str
    train: TrainChoice
    model: Options = field(default_factory=CnnLstm)
    loss: LossChoice = field(default_factory=LossChoice)

    def __post_init__(self) -> None:
        config.normalised(self)
        if not self.name or Path(self.name).name != self.name:
            raise InputError(
                f"name = '{self.name}' must be a plain folder name; it is made under runs/"
            )

    @property
    def folder(self) -> Path:
        """Of the run."""
        return Path("runs") / self.name

    def toml(self) -> str:
        """The settings as a TOML file, with the options of the model's kind alone."""
        return config.dump_toml(config.to_dict(self))


def load_settings(path: Path | str, overrides: Iterable[str] = ()) -> Settings:
    """Settings from the TOML file at `path`, with ["key=value", ...] laid over it.

    A model.kind among the overrides that is not the file's leaves out the file's [model] table,
    whose options are those of another kind.
    """
    tree, changes = config.read_toml(path), config.parse_overrides(overrides)
    wanted = _kind(changes, default=None)
    if wanted is not None and wanted != _kind(tree):
        tree.pop("model", None)
    return from_tree(config.merge(tree, changes))


def from_tree(tree: dict) -> Settings:
    """Settings from nested dicts. Raises InputError for what is unknown, of a wrong type, or the
    option of another kind of model."""
    model = model_options(tree.get("model", {}))
    return config.build(Settings, {**tree, "model": model})


def model_options(tree: dict) -> Options:
    """The options of a [model] table: {"kind": ..., option: value}."""
    if not isinstance(tree, dict):
        raise InputError(f"'model' must be a table, not {tree!r}")
    own = dict(tree)
    kind = own.pop("kind", CnnLstm.kind)
    options = network(kind).options
    for name, kinds in foreign(own, options).items():
        raise InputError(
            f"model.{name} = {own[name]!r} has no meaning for model.kind = '{kind}',"
            f" only for {' and '.join(kinds)}; leave it out"
        )
    return config.build(options, own, "model")


def foreign(own: dict, options: type[Options]) -> dict[str, list[str]]:
    """{name: kinds that have it} of the settings in `own` that are other kinds' alone."""
    takes = {kind: _names(row.options) for kind, row in NETWORKS.items()}
    kinds = {name: [kind for kind, names in takes.items() if name in names] for name in own}
    return {
        name: others for name, others in kinds.items() if others and name not in _names(options)
    }


def _names(options: type[Options]) -> set[str]:
    return {entry.name for entry in fields(options) if entry.init}


def _kind(tree: dict, default: str | None = CnnLstm.kind) -> str | None:
    model = tree.get("model", {})
    return model.get("kind", default) if isinstance(model, dict) else default
