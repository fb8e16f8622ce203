"""Settings of one training run, read from a TOML file and key=value overrides."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
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
    hard: how many interactions of the split "hard" to learn from too, beside "train"; the rest of
    that split is judged by.
    """

    split: Literal["interactions", "frames"] = "interactions"
    each: int = number(0, 1_000_000, default=0)
    seed: int = number(0, 2**32 - 1, default=0)
    hard: int = number(0, 1_000_000, default=0)

    def __post_init__(self) -> None:
        config.normalised(self, "samples")
        if self.split == "interactions" and not self.each:
            reason = "samples.split = 'interactions' with samples.each = 0"
            config.refuse_unused(self, ["seed"], "samples", reason)


@dataclass(frozen=True)
class TrainChoice:
    """schedule "cosine" lets the learning rate fall to zero at the last epoch; precision is Keras's
    policy."""

    epochs: int = number(1, 1_000_000, default=20)
    batch_size: int = number(1, 1_000_000, default=16)
    learning_rate: float = number(1e-12, 1, default=1e-3)
    schedule: Literal["cosine", "constant"] = "cosine"
    precision: Literal["float32", "mixed_bfloat16"] = "float32"
    seed: int = number(0, 2**32 - 1, default=1)

    def __post_init__(self) -> None:
        config.normalised(self, "train")


@dataclass(frozen=True)
class Beside:
    """What is trained beside a run on the same data, to compare with it: as in Settings."""

    model: Options = field(default_factory=CnnLstm)
    train: TrainChoice = field(default_factory=TrainChoice)
    loss: LossChoice = field(default_factory=LossChoice)
    input: InputChoice = field(default_factory=InputChoice)

    def __post_init__(self) -> None:
        config.normalised(self, "beside")


@dataclass(frozen=True)
class Settings:
    """name: of the folder under runs/; scene: scene file; data: HDF5 file, generated from the scene
    if missing; model: the options of its kind, see unet_fem.networks.registry, whose row says which
    of the other tables it reads; the rest is refused; beside: other models that are trained on the
    same and compared with it, each of another kind, see `others`."""

    name: str
    scene: str
    data: str
    train: TrainChoice = field(default_factory=TrainChoice)
    model: Options = field(default_factory=CnnLstm)
    loss: LossChoice = field(default_factory=LossChoice)
    input: InputChoice = field(default_factory=InputChoice)
    samples: SampleChoice = field(default_factory=SampleChoice)
    beside: tuple[Beside, ...] = ()

    def __post_init__(self) -> None:
        config.normalised(self)
        plain_name(self.name, "name")
        for table, names in unused(self.model.kind).items():
            reason = f"model.kind = '{self.model.kind}'"
            config.refuse_unused(getattr(self, table), names, table, reason)
        kinds = [self.model.kind, *(other.model.kind for other in self.beside)]
        for kind in kinds:
            if kinds.count(kind) > 1:
                raise InputError(
                    f"beside: {kinds.count(kind)} models are of model.kind = '{kind}', after which"
                    " their runs are named; give one of each kind"
                )
        _ = self.others  # refuses what does not fit

    @property
    def others(self) -> list["Settings"]:
        """Those of `beside` as runs of their own, named <name>_<kind>."""
        alone = replace(self, beside=()) if self.beside else self
        return [
            replace(
                alone.with_model(other.model),
                name=f"{self.name}_{other.model.kind}",
                train=other.train,
                loss=other.loss,
                input=other.input,
            )
            for other in self.beside
        ]

    @property
    def stepped(self) -> bool:
        """Whether the model is a stepper in a file of its own."""
        return bool(network(self.model.kind).stepper)

    @property
    def fitted(self) -> bool:
        """Whether the model is a regression, which is not trained."""
        return network(self.model.kind).fitted

    @property
    def folder(self) -> Path:
        """Of the run."""
        return Path("runs") / self.name

    def with_model(self, model: Options) -> "Settings":
        """These settings with another model, and without those that it has no use for."""
        tables = {
            table: replace(getattr(self, table), **config.defaults(TABLES[table], names))
            for table, names in unused(model.kind).items()
        }
        return replace(self, model=model, **tables)

    def toml(self) -> str:
        """The settings as a TOML file, with those alone that the model's kind reads, and without
        [input], [samples] and [[beside]] where they are the defaults."""
        tree = without(config.to_dict(self), unused(self.model.kind))
        tree["beside"] = [without(own, unused(own["model"]["kind"])) for own in tree["beside"]]
        for name, usual in (("input", InputChoice()), ("samples", SampleChoice()), ("beside", ())):
            if getattr(self, name) == usual:
                tree.pop(name, None)
        return config.dump_toml(tree)


TABLES = {"train": TrainChoice, "loss": LossChoice, "input": InputChoice, "samples": SampleChoice}


def unused(kind: str) -> dict[str, list[str]]:
    """{table: names} of the settings besides [model] that this kind has no use for."""
    row = network(kind)
    return {
        table: [own.name for own in fields(cls) if not row.uses(table, own.name)]
        for table, cls in TABLES.items()
    }


def without(tree: dict, names: dict[str, list[str]]) -> dict:
    """Nested dicts without the entries {table: names}, and without tables that become empty."""
    left = {
        table: {name: value for name, value in own.items() if name not in names[table]}
        for table, own in tree.items()
        if table in names and isinstance(own, dict)
    }
    return {name: left.get(name, own) for name, own in tree.items() if left.get(name, True)}


def load_settings(
    path: Path | str, overrides: Iterable[str] = (), say: Callable[[str], object] = str
) -> Settings:
    """Settings from the TOML file at `path`, with ["key=value", ...] laid over it.

    A model.kind among the overrides that is not the file's leaves out what the file says of its own
    kind, which would be refused: its [model] and [[beside]] tables and the settings that the other
    kind has no use for. say: is told what.
    """
    tree, changes = config.read_toml(path), config.parse_overrides(overrides)
    wanted, own = _kind(changes, default=None), _kind(tree)
    if wanted is not None and wanted != own:
        rest = {name: own for name, own in tree.items() if name not in ("model", "beside")}
        left = without(rest, unused(wanted))
        out = sorted({f"[{name}]" for name in tree.keys() - left.keys()}) + [
            f"{table}.{name}"
            for table in left.keys() & TABLES.keys()
            for name in tree[table].keys() - left[table].keys()
        ]
        if out:
            say(f"left out of {path}, for model.kind = '{wanted}': {', '.join(sorted(out))}")
        tree = left
    return from_tree(config.merge(tree, changes))


def from_tree(tree: dict) -> Settings:
    """Settings from nested dicts. Raises InputError for what is unknown, of a wrong type, or the
    option of another kind of model."""
    beside = tree.get("beside", [])
    if not isinstance(beside, list) or not all(isinstance(own, dict) for own in beside):
        raise InputError(f"beside = {beside!r} must be tables, [[beside]]")
    others = [{**own, "model": model_options(own.get("model", {}))} for own in beside]
    model = model_options(tree.get("model", {}))
    return config.build(Settings, {**tree, "model": model, "beside": others})


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
