"""The networks and regressions that a run can hold: a row each, with the settings of its own.

The table is read without Keras: a row names its functions as "module:function", and they are
imported when they are called. A new network is one file with its function, and its options and row
here.
"""

import dataclasses
import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import ModuleType
from typing import TYPE_CHECKING, Protocol

from fem.errors import InputError
from fem.ranges import checked_array, number
from fem.settings import normalised
from unet_fem.networks.block import block_channels, coarse_block

if TYPE_CHECKING:
    import keras
    import numpy as np

    from fem.online.regression import Regression
    from unet_fem.networks.pod import Samples

Reference = str | Callable  # "module:function", or the function itself


@dataclass(frozen=True)
class Options:
    """The [model] table of a run: its kind, and the settings that this kind alone has."""

    kind: str = field(default="", init=False)

    def __post_init__(self) -> None:
        normalised(self, "model")

    def own(self) -> dict[str, int | bool]:
        """{name: value} of the kind's own settings."""
        return {name: value for name, value in dataclasses.asdict(self).items() if name != "kind"}

    @property
    def window(self) -> int | None:
        """Frames of force that the model sees at once; None if it sees one frame and has no time
        axis."""
        return None

    def check(self, grid: tuple[int, int, int]) -> None:
        """Raises InputError where the model does not fit a grid of nodes (nx, ny, nz)."""

    def weights(self, grid: tuple[int, int, int]) -> float:
        """About how many weights the model has on that grid, to tell whether they fit memory."""
        return 0.0


@dataclass(frozen=True)
class CnnLstm(Options):
    """units: of the LSTM, per direction; steps: frames of the window."""

    kind: str = field(default="cnn_lstm", init=False)
    units: int = number(1, 100_000, default=512)
    steps: int = number(1, 1000, default=2)

    @property
    def window(self) -> int:
        return self.steps

    def check(self, grid: tuple[int, int, int]) -> None:
        block_channels(self.units, coarse_block(grid))

    def weights(self, grid: tuple[int, int, int]) -> float:
        features = 32 * math.prod(n / 3 for n in grid)
        return 8.0 * self.units * (features + self.units)


@dataclass(frozen=True)
class UNet(Options):
    """filters: channels of the first convolution."""

    kind: str = field(default="unet", init=False)
    filters: int = number(1, 10_000, default=64)

    def weights(self, grid: tuple[int, int, int]) -> float:
        return 400.0 * self.filters**2


@dataclass(frozen=True)
class Linear(Options):
    """steps: frames of the window."""

    kind: str = field(default="linear", init=False)
    steps: int = number(1, 1000, default=1)

    @property
    def window(self) -> int | None:
        return self.steps if self.steps > 1 else None


@dataclass(frozen=True)
class Pod(Linear):
    """modes: of the training displacements; quadratic: whether squares of the forces are among the
    inputs."""

    kind: str = field(default="pod", init=False)
    modes: int = number(1, 1_000_000, default=40)
    quadratic: bool = True


@dataclass(frozen=True)
class Elastic(Options):
    """K^-1 f with the stiffness at rest: nothing is learned."""

    kind: str = field(default="elastic", init=False)


@dataclass(frozen=True)
class Constitutive(Options):
    """modes, inputs, points: of the reduced model that it stands on, see fem.reduce; coarse: points
    a side that N sees; steps: of training through windows of frames, 0 for the fit alone."""

    kind: str = field(default="constitutive", init=False)
    modes: int = number(1, 100_000, default=320)
    inputs: int = number(1, 100_000, default=120)
    points: int = number(1, 100_000, default=300)
    coarse: int = number(1, 100_000, default=40)
    steps: int = number(0, 1_000_000, default=300)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.inputs > self.modes:
            raise InputError(
                f"model.inputs = {self.inputs} must be at most model.modes = {self.modes}, of which"
                " they are"
            )


class Model(Protocol):
    """What a run makes: a Keras model, a Regression, or a stepper that is followed."""

    @property
    def input_shape(self) -> tuple[int | None, ...]:
        """(None, [T,] nx, ny, nz, 3)."""

    def __call__(self, force: "np.ndarray") -> "np.ndarray":
        """Displacement (S, nx, ny, nz, 3) mm from force windows (S, [T,] nx, ny, nz, 3) mN."""


@dataclass(frozen=True)
class Network:
    """One row.

    label: what figures and tables call it. options: the dataclass of its settings.
    builder: of the untrained Keras model, called as builder(grid, force_scale=,
    displacement_scale=, mask=, lib=, **own settings).
    fitter: of a Regression in closed form, in place of a builder: fitter(train, validation, mask,
    **own settings but steps, which the samples' windows show).
    maker: of a Regression from a fem.data.dataset.Dataset alone, in place of both: maker(dataset).
    stepper: opens the run's file, of what answers frame by frame and is made by a command of its
    own (unet_fem.train), in place of all of them.
    thinner: puts the weightiest part of a model into a smaller one, thinner(model, small). size:
    name of the setting that makes it smaller.
    reads: which of a run's settings besides [model] it has a use for, as "table" or "table.name";
    the others are refused.
    """

    label: str
    options: type[Options]
    builder: Reference | None = None
    fitter: Reference | None = None
    maker: Reference | None = None
    stepper: Reference | None = None
    thinner: Reference | None = None
    size: str | None = None
    reads: tuple[str, ...] = ("train", "loss", "input", "samples")

    def build(
        self,
        grid: tuple[int, int, int],
        options: Options,
        scales: tuple[float, float] = (1.0, 1.0),
        mask: "np.ndarray | None" = None,
        lib: ModuleType | None = None,
    ) -> "keras.Model":
        """The untrained Keras model for a grid of nodes (nx, ny, nz).

        scales: (force mN, displacement mm). mask: (nx, ny, nz) bool, the free nodes. lib: the Keras
        to build with, keras if None. Raises InputError where the options do not fit the grid.
        """
        if self.builder is None:
            how = "steps by its own file" if self.stepper else "is fitted, not trained"
            raise InputError(f"a {self.label} {how}; it has no Keras model")
        checked_array("grid", grid, (3,), 2, 10_000, whole=True)
        checked_array("scales", scales, (2,), 1e-12, 1e12)
        options.check(grid)
        scaled = {"force_scale": scales[0], "displacement_scale": scales[1]}
        return resolve(self.builder)(grid, **options.own(), **scaled, mask=mask, lib=lib)

    def fit(
        self, train: "Samples", validation: "Samples", mask: "np.ndarray", options: Options
    ) -> "Regression":
        """The Regression on Samples of windows as `options` asks for, in closed form."""
        if self.fitter is None:
            raise InputError(f"a {self.label} is trained, not fitted in closed form")
        own = {name: value for name, value in options.own().items() if name != "steps"}
        return resolve(self.fitter)(train, validation, mask, **own)

    def uses(self, table: str, name: str) -> bool:
        """Whether it has a use for the setting `name` of `table`."""
        return table in self.reads or f"{table}.{name}" in self.reads

    @property
    def fitted(self) -> bool:
        """Whether it is a Regression, which no training makes."""
        return self.builder is None and self.stepper is None

    def thin(self, model: "keras.Model", small: "keras.Model") -> None:
        """Give `small`, a model of this kind with less of `size`, the weightiest part of
        `model`."""
        if self.thinner is None:
            raise InputError(f"a {self.label} cannot be made thinner")
        resolve(self.thinner)(model, small)


JUDGED = ("input.memory", "loss.volume_threshold")  # the second is drawn into a figure
NETWORKS = {
    "cnn_lstm": Network(
        "CNN-LSTM",
        CnnLstm,
        builder="unet_fem.networks.cnn_lstm:cnn_lstm",
        thinner="unet_fem.networks.thinning:thin_cnn_lstm",
        size="units",
    ),
    "unet": Network(
        "U-Net",
        UNet,
        builder="unet_fem.networks.unet:unet",
        thinner="unet_fem.networks.thinning:thin_unet",
        size="filters",
    ),
    "linear": Network(
        "linear regression",
        Linear,
        fitter="unet_fem.networks.pod:linear",
        reads=(*JUDGED, "samples"),
    ),
    "pod": Network(
        "POD regression", Pod, fitter="unet_fem.networks.pod:pod", reads=(*JUDGED, "samples")
    ),
    "constitutive": Network(
        "constitutive network",
        Constitutive,
        stepper="unet_fem.runtime.constitutive:ConstitutiveSurrogate",
        reads=("loss.volume_threshold", "samples.hard"),
    ),
    "elastic": Network(
        "linear elastic answer", Elastic, maker="fem.data.elastic:elastic_answer", reads=JUDGED
    ),
}


def network(kind: str) -> Network:
    """The row of `kind`. Raises InputError for an unknown one."""
    if not isinstance(kind, str) or kind not in NETWORKS:
        raise InputError(f"model.kind = {kind!r} is not one of {', '.join(NETWORKS)}")
    return NETWORKS[kind]


def resolve(reference: Reference) -> Callable:
    """The function that "module:function" names; a function is itself."""
    if callable(reference):
        return reference
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)
