"""Settings of a study, read from a TOML file: which networks it trains and which competitors it
measures."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from fem import settings as config
from fem.cache import cache_root
from fem.errors import InputError
from fem.files import plain_name
from fem.ranges import check_distinct, checked, number, shown, takes
from unet_fem.steppers import STEPPERS, maker
from unet_fem.training.settings import Settings, load_settings

LINEAR = "linear regression"  # names the regression among the claims of the paper
CLAIMS = ("volume", "units", "steps", "float16", "int8", "pruning", "latency", "fem")


@dataclass(frozen=True)
class Network:
    """A training run: its name, its configuration file, the key=value changes laid over that, and
    the settings that were tried for it on validation interactions."""

    name: str
    config: str
    changes: tuple[str, ...] = ()
    tries: int = number(1, 1_000_000, default=1)

    @property
    def settings(self) -> Settings:
        """Of the run, read from its files now."""
        return load_settings(self.config, [*self.changes, f"name={self.name}"])


@dataclass(frozen=True)
class Main:
    """A network that is pruned and shown in every figure.

    label: its name in figures and tables; prune_epochs: of fine-tuning.
    """

    label: str
    run: str
    prune_epochs: int = number(1, 1_000_000, default=10)


@dataclass(frozen=True)
class Answer:
    """A competitor that joins by configuration: whatever steps (see unet_fem.steppers).

    label: its name; family: joined in figures; file: that its stepper is opened from, or stepper:
    kind of one that is made from the dataset's mesh and material, a FEM; options: keywords of
    either, such as the effort of a constitutive network; shown: whether it has a line over time and
    a panel over forces
    made: the commands that make the file. interactions: that it has learned from, 0 for none; hard:
    whether hard forces were among them; tries: settings that were tried on validation interactions
    scene: that its data are of, "" for the study's dataset; simulated: interactions of it, those of
    validation among them, 0 for `interactions`; training: s on one thread for what comes after the
    data, None where it is not recorded
    """

    label: str
    family: str
    file: str = ""
    stepper: str = ""
    options: dict = field(default_factory=dict)
    interactions: int = number(0, 1_000_000_000, default=0)
    hard: bool = False
    tries: int = number(1, 1_000_000, default=1)
    shown: bool = False
    made: tuple[str, ...] = ()
    scene: str = ""
    simulated: int = number(0, 1_000_000_000, default=0)
    training: float | None = number(0, 1e9, "s", default=None)

    def __post_init__(self) -> None:
        if bool(self.file) == bool(self.stepper):
            raise InputError(
                f"answers: '{self.label}' has file = '{self.file}' and stepper ="
                f" '{self.stepper}'; give one of the two"
            )
        if not (self.label.strip() and self.family.strip()):
            raise InputError(
                f"answers: label = '{self.label}', family = '{self.family}'; give both"
            )
        if self.hard and not self.interactions:
            raise InputError(
                f"answers: hard of '{self.label}' has no meaning without interactions; leave it out"
            )
        if self.file:
            known = sorted({str(row.suffix) for row in STEPPERS.values() if row.suffix})
            if Path(self.file).suffix not in known:
                raise InputError(
                    f"answers: file = '{self.file}' ends in none of {', '.join(known)}"
                )
        else:
            takes(maker(self.stepper), self.options, f"answers: '{self.label}'", 2)


@dataclass(frozen=True)
class Order:
    """The paper's claim that `better` errs less than `worse`, by the share `gain` of its error.

    Both are labels of main networks, or "linear regression"; says: the paper's sentence.
    """

    better: str
    worse: str
    says: str
    gain: float = number(0, 1)


@dataclass(frozen=True)
class Arm:
    """One side of a comparison: runs that differ in their seeds alone."""

    label: str
    runs: tuple[str, ...]


@dataclass(frozen=True)
class Fem:
    """The FEM as a competitor at fixed latency.

    interactions: numbers of the usual test interactions that the headline figure judges every
    competitor on; hard: how many of the hard ones besides, None for all
    steps: warm-started steps a frame; frames: lengths of a frame in s
    reference_safety: share of the critical step that the reference takes; checked: interactions
    that its own error is measured on
    """

    interactions: tuple[int, ...] = number(1, 1_000_000)
    hard: int | None = number(1, 1_000_000, default=None)
    steps: tuple[int, ...] = number(1, 1_000_000, default=(1, 2, 5, 11, 22, 44, 100, 200))
    frames: tuple[float, ...] = number(1e-4, 1e5, "s", default=(0.01, 0.25))
    reference_safety: float = number(1e-3, 1, default=0.85)
    checked: int = number(0, 1_000_000, default=3)


@dataclass(frozen=True)
class Stability:
    """Test interactions whose forces are multiplied by each factor, to see how far every competitor
    holds."""

    interactions: tuple[int, ...] = number(1, 1_000_000)
    factors: tuple[float, ...] = number(1e-3, 1e3, default=(0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0))


@dataclass(frozen=True)
class Long:
    """Interactions that last longer than those of the study: their scene, the dataset that is
    simulated of it where it is missing, and how many of its tests are taken, None for all."""

    scene: str
    data: str
    interactions: int | None = number(1, 1_000_000, default=None)


@dataclass(frozen=True)
class Study:
    """name: of the folder under runs/ for its page; the runs themselves lie beside it

    main: the networks that are pruned and shown in every figure, the paper's best first: its
    dataset is the study's, and it is the one whose configurations are compared; deployed: runs
    that are exported in every form
    answers: competitors that join by their files or kinds
    order: claims of the paper; claims: {one of CLAIMS: the paper's sentence}, a claim without one
    is not judged; paper_latency: {label of a main network, or "FEM": s} as the paper gives them;
    configurations: runs of the paper's table of configurations;
    physics: arms of the comparison with and without the volume term, the first of them without;
    learning_rate: two runs, the schedule first; window: two runs, the shorter first
    prune: shares to remove; pod_modes: numbers of modes of the POD with regression; long: datasets
    of longer interactions; rounds: turns of each competitor when run times are taken; tries:
    settings that may be tried for each competitor on validation
    """

    name: str
    networks: tuple[Network, ...]
    main: tuple[Main, ...]
    configurations: tuple[str, ...]
    deployed: tuple[str, ...]
    physics: tuple[Arm, ...]
    learning_rate: tuple[str, str]
    window: tuple[str, str]
    fem: Fem
    stability: Stability
    long: tuple[Long, ...]
    answers: tuple[Answer, ...] = ()
    order: tuple[Order, ...] = ()
    claims: dict = field(default_factory=dict)
    paper_latency: dict = field(default_factory=dict)
    prune: tuple[float, ...] = number(0.01, 0.99, default=(0.5, 0.8))
    pod_modes: tuple[int, ...] = number(1, 1_000_000, default=(5, 10, 20, 40, 80, 160))
    rounds: int = number(1, 1_000_000, default=100)
    tries: int = number(1, 1_000_000, default=12)

    def __post_init__(self) -> None:
        for name in (self.name, *(network.name for network in self.networks)):
            plain_name(name, "name")
        for label, seconds in self.paper_latency.items():
            checked(f"paper_latency.{label}", seconds, 1e-9, 1e6, "s")
        for name, says in self.claims.items():
            if not isinstance(says, str):
                raise InputError(f"claims.{name} = {shown(says)} must be the paper's words")
        self._check_lists()
        names = [network.name for network in self.networks]
        if len(set(names)) < len(names):
            raise InputError("networks: two have the same name; a run's name must be its own")
        if not self.main:
            raise InputError("main: there is none; name at least one network in [[main]]")
        labels = [main.label for main in self.main]
        if len({LINEAR, *labels}) <= len(labels):
            raise InputError(
                f"main: the labels {', '.join(labels)} must differ from each other and from"
                f" {LINEAR}"
            )
        used = [
            *(main.run for main in self.main),
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
        for name in self.claims:
            if name not in CLAIMS:
                raise InputError(f"claims: '{name}' is not one of {', '.join(CLAIMS)}")
        self._check_tries()
        for label in (label for order in self.order for label in (order.better, order.worse)):
            if label not in (*labels, LINEAR):
                raise InputError(
                    f"order: '{label}' is no label of a main network:"
                    f" {', '.join(labels)} or {LINEAR}"
                )
        for label in self.paper_latency:
            if label not in (*labels, "FEM"):
                raise InputError(
                    f"paper_latency.{label} is of none of {', '.join(labels)} and FEM; leave it out"
                )
        for order in self.order:
            check_distinct("order: better and worse", (order.better, order.worse))

    def _check_lists(self) -> None:
        """None names one thing twice."""
        own = ("deployed", "configurations", "learning_rate", "window", "prune", "pod_modes")
        lists = {name: getattr(self, name) for name in own}
        for table in ("fem", "stability"):
            fields = getattr(self, table)
            lists |= {f"{table}.{name}": getattr(fields, name) for name in vars(fields)}
        for name, values in lists.items():
            if isinstance(values, tuple):
                check_distinct(name, values)
        check_distinct("prune, in whole percents", [f"{100 * share:.0f}" for share in self.prune])

    def _check_tries(self) -> None:
        """Every competitor has the same budget of settings to try on validation."""
        spent = {network.name: network.tries for network in self.networks}
        spent |= {answer.label: answer.tries for answer in self.answers}
        for name, tries in spent.items():
            if not 1 <= tries <= self.tries:
                raise InputError(
                    f"'{name}' has tries = {tries}, the study allows 1 to tries = {self.tries} for"
                    " each competitor; choose among fewer settings, or give all the same budget"
                )
        labels = [answer.label for answer in self.answers]
        if len(set(labels)) < len(labels):
            raise InputError("answers: two have the same label; a competitor's must be its own")

    @property
    def folder(self) -> Path:
        """The study's folder among the runs."""
        return Path("runs") / self.name

    @property
    def cache(self) -> Path:
        """Where its results are kept, see fem.cache."""
        return cache_root() / self.name

    @property
    def data(self) -> str:
        """Path of the study's dataset: that of its first main network."""
        return self.network(self.main[0].run).data

    def network(self, name: str) -> Settings:
        """The Settings of the run called `name`."""
        return next(network.settings for network in self.networks if network.name == name)

    def replicas(self, name: str) -> list[str]:
        """The runs that differ from the run called `name` in their seeds alone, itself first."""
        own = _but_for_seed(self.network(name))
        others = [network.name for network in self.networks if network.name != name]
        return [name, *(run for run in others if _but_for_seed(self.network(run)) == own)]


def _but_for_seed(settings: Settings) -> Settings:
    return replace(settings, name="any", train=replace(settings.train, seed=0))


def load_study(path: Path | str, overrides: Iterable[str] = ()) -> Study:
    """The Study in the TOML file at `path`, with ["key=value", ...] laid over it."""
    return config.build(
        Study, config.merge(config.read_toml(path), config.parse_overrides(overrides))
    )
