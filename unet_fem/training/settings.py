"""Settings of one training run, read from a TOML file and key=value overrides."""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from fem import settings as config
from fem.errors import InputError
from fem.files import plain_name
from fem.online.volume import VOLUME_BAND
from fem.ranges import number
from unet_fem.networks.registry import NETWORKS, CnnLstm, Options, network

QUICK = Path("configs/quick.toml")


@dataclass(frozen=True)
class LossChoice:
    """See unet_fem.training.losses.volume_loss; volume_weight 0 leaves the volume term out.

    volume_of: the volume that it watches and that the threshold is a share of, of all cells or of
    the mesh's cell set "tumour" alone: the paper says both.
    """

    volume_weight: float = number(0, 1e6, default=0.1)
    volume_threshold: float = number(0, 10, default=VOLUME_BAND)
    volume_of: Literal["all", "tumour"] = "all"
    direction_weight: float = number(0, 1e6, default=0.0)

    def __post_init__(self) -> None:
        config.normalised(self, "loss")


@dataclass(frozen=True)
class InputChoice:
    """What the model sees of the forces.

    memory: "window", the last forces as they are, or "creep", as creeping tissue remembers them,
    see fem.online.creep.CreepFilter; the window is then one of remembered forces. Elastic tissue
    has no memory: there both are the same. physics: "force", or "elastic", the linear elastic
    answer to it, to which a network then learns the correction.
    """

    memory: Literal["window", "creep"] = "window"
    physics: Literal["force", "elastic"] = "force"

    def __post_init__(self) -> None:
        config.normalised(self)


@dataclass(frozen=True)
class SampleChoice:
    """Which frames the model learns from, see unet_fem.training.readings.

    split: "interactions", whole ones as the dataset has them, or "frames" at random, which leaks;
    each: frames at random of each interaction, 0 for all; seed: of the draw.
    """

    split: Literal["interactions", "frames"] = "interactions"
    each: int = number(0, 1_000_000, default=0)
    seed: int = number(0, 2**32 - 1, default=0)

    def __post_init__(self) -> None:
        config.normalised(self, "samples")


@dataclass(frozen=True)
class TrainChoice:
    """schedule "cosine" lets the learning rate fall to zero at the last epoch; precision is Keras's
    policy. A regression is fitted in closed form and reads none of it."""

    epochs: int = number(1, 1_000_000)
    batch_size: int = number(1, 1_000_000, default=16)
    learning_rate: float = number(1e-12, 1, default=1e-3)
    schedule: Literal["cosine", "constant"] = "cosine"
    precision: Literal["float32", "mixed_bfloat16"] = "float32"
    seed: int = number(0, 2**32 - 1, default=1)

    def __post_init__(self) -> None:
        config.normalised(self, "train")


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
    input: InputChoice = field(default_factory=InputChoice)
    samples: SampleChoice = field(default_factory=SampleChoice)

    def __post_init__(self) -> None:
        config.normalised(self)
        plain_name(self.name, "name")
        if self.input.physics == "elastic" and self.fitted:
            raise InputError(
                f"input.physics = 'elastic' has no meaning for model.kind = '{self.model.kind}',"
                " only for networks; leave it out"
            )

    @property
    def fitted(self) -> bool:
        """Whether the model is a regression, which is not trained."""
        return network(self.model.kind).fitted

    @property
    def folder(self) -> Path:
        """Of the run."""
        return Path("runs") / self.name

    def toml(self) -> str:
        """The settings as a TOML file, with the options of the model's kind alone, and without
        [input] and [samples] where they are the defaults."""
        tree = config.to_dict(self)
        for name, usual in (("input", InputChoice()), ("samples", SampleChoice())):
            if getattr(self, name) == usual:
                del tree[name]
        return config.dump_toml(tree)


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
