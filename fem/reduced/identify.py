"""Shear modulus and Prony series of a tissue from a measured record of a press: depth of the probe,
force on it."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize
import scipy.stats

from fem.errors import InputError
from fem.material.base import shear_modulus
from fem.online.constitutive import ConstitutiveStepper
from fem.online.press import Press
from fem.online.reduced_model import ReducedModel
from fem.online.retissue import Learned, with_tissue

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "depth": {"mm": 1.0, "um": 1e-3, "m": 1e3},
    "force": {"mN": 1.0, "N": 1e3, "uN": 1e-3},
}  # into s, mm and mN
TOLD = 3.0  # a value known to this factor at best is not told by the record
ALIKE = 0.95  # correlation of two relaxation times above which only both together are told
FEWEST = 20  # rows of a record


@dataclass(frozen=True, eq=False)
class Record:
    """time (n,) s, rising; depth (n,) mm that the probe has pushed the surface; force (n,) mN."""

    time: np.ndarray
    depth: np.ndarray
    force: np.ndarray


def read_record(path: Path | str) -> Record:
    """The record in a CSV file with columns time, depth and force whose names end in their units,
    such as time_s, depth_mm and force_mN; others are passed over.

    Raises InputError for a missing column, an unknown unit, values that are not finite, and times
    that do not rise.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read ({error}); give a CSV file") from None
    names = [name.strip() for name in rows[0]] if rows else []
    found = {}
    for quantity, units in UNITS.items():
        wanted = {f"{quantity}_{unit}": factor for unit, factor in units.items()}
        own = [name for name in names if name in wanted]
        if len(own) != 1:
            raise InputError(
                f"{path} has the columns {', '.join(names) or 'none'}; give one of"
                f" {', '.join(wanted)}"
            )
        found[quantity] = wanted[own[0]] * _column(path, rows[1:], names.index(own[0]), own[0])
    if len(found["time"]) < FEWEST:
        raise InputError(f"{path} has {len(found['time'])} rows; give at least {FEWEST}")
    steps = np.diff(found["time"])
    if not steps.min() > 0:
        row = int(np.argmax(steps <= 0)) + 3
        raise InputError(f"{path}: the time does not rise in line {row}; sort it, leave gaps out")
    return Record(**found)


def _column(path, rows, place, name):
    values = np.empty(len(rows))
    for number, row in enumerate(rows):
        try:
            values[number] = float(row[place])
        except (ValueError, IndexError):
            values[number] = np.nan
        if not np.isfinite(values[number]):
            raise InputError(
                f"{path}: {name} in line {number + 2} is no finite number; leave such lines out"
            )
    return values


@dataclass(frozen=True, eq=False)
class Identified:
    """What a record tells.

    mu: Pa; prony: ((g, tau s), ...) by rising tau; low, high: {"mu", "g1", "tau1", ...} ends of the
    intervals of `confidence`; misfit: of the forces, relative L2; told: {name: whether the record
    tells it}; alike: names of relaxation times that it cannot tell apart.
    """

    mu: float
    prony: tuple[tuple[float, float], ...]
    low: dict[str, float]
    high: dict[str, float]
    misfit: float
    told: dict[str, bool]
    alike: list[tuple[str, str]]
    confidence: float


class Pressed:
    """The force on a probe that follows a record, for any tissue.

    model, learned: a constitutive network of the body; position (3,) mm, radius mm: of the probe.
    """

    def __init__(
        self,
        model: ReducedModel,
        learned: Learned,
        record: Record,
        position: np.ndarray,
        radius: float,
    ) -> None:
        self.model, self.learned, self.record = model, learned, record
        self.position, self.radius = position, radius
        self.mu = float(np.mean(shear_modulus(model.law)))

    def __call__(self, prony: tuple[tuple[float, float], ...]) -> np.ndarray:
        """(n,) mN along the inward normal, at the modulus of the model, `self.mu`."""
        stepper = ConstitutiveStepper(*with_tissue(self.model, self.learned, prony=prony))
        press, found, before = Press(stepper, self.model.surface()), [], 0.0
        before = self.record.time[0] - np.diff(self.record.time).mean()
        for time, depth in zip(self.record.time, self.record.depth, strict=True):
            touch = press(self.position, depth, self.radius, dt=float(time - before))
            if touch.flagged:
                raise InputError(
                    f"the record cannot be followed at {time:g} s ({touch.reason}); give a probe's"
                    " place on the body, and depths that its network was made for"
                )
            found.append(np.linalg.norm(touch.force))
            before = time
        return np.array(found)


def identify(
    pressed: Pressed, terms: int = 2, rows: int = 200, confidence: float = 0.95
) -> Identified:
    """The tissue whose forces come nearest to the record's, by least squares.

    terms: of the Prony series; rows: that the record is thinned to at most. The network must be of
    a tissue with the same K / mu, a common factor on both being exact. Intervals are those of the
    linearised fit (Student's t), on logarithms.
    """
    record = pressed.record
    scale = float(np.abs(record.force).max())
    if not scale > 0:
        raise InputError("the record's forces are all zero; there is nothing to fit")
    last = len(record.time) - 1  # half of the rows evenly, half of them early, where it is fast
    places = np.concatenate(
        [np.linspace(0, last, rows // 2), np.geomspace(1, last + 1, rows - rows // 2) - 1]
    )
    chosen = np.unique(places.round().astype(int))
    thin = Record(record.time[chosen], record.depth[chosen], record.force[chosen])
    follow = Pressed(pressed.model, pressed.learned, thin, pressed.position, pressed.radius)
    span = thin.time[-1] - thin.time[0]
    step = float(np.diff(thin.time).min())

    def residuals(x):
        return (np.exp(x[0]) * follow(series(x)) - thin.force) / scale

    times = np.geomspace(max(span / 30, 3 * step), 2 * span, terms + 2)[1:-1]
    start = np.concatenate([[0.0], np.full(terms, -1.0), np.log(times)])
    low = np.concatenate([[-15.0], np.full(terms, -12.0), np.full(terms, np.log(step / 10))])
    high = np.concatenate([[15.0], np.full(terms, 5.0), np.full(terms, np.log(1000 * span))])
    fit = scipy.optimize.least_squares(
        residuals, start, bounds=(low, high), x_scale=1.0, diff_step=1e-3, xtol=1e-6, ftol=1e-8
    )
    return _identified(fit, pressed.mu, thin, terms, confidence, scale)


def series(x: np.ndarray) -> tuple[tuple[float, float], ...]:
    """The Prony series of (ln of a factor on mu, ln g_k / g_inf ..., ln tau_k ...): any x has sum g
    below 1."""
    terms = len(x) // 2
    odds, times = np.exp(x[1 : 1 + terms]), np.exp(x[1 + terms :])
    order = np.argsort(times)
    g = odds / (1 + odds.sum())
    return tuple((float(g[k]), float(times[k])) for k in order)


def _identified(fit, mu, record, terms, confidence, scale) -> Identified:
    x, free = fit.x, max(len(record.time) - len(fit.x), 1)
    variance = 2 * fit.cost / free
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac, rcond=1e-12) * variance
    width = scipy.stats.t.ppf((1 + confidence) / 2, free) * np.sqrt(np.diag(covariance))
    order = np.argsort(x[1 + terms :])
    prony = series(x)
    value: dict[str, Any] = {"mu": mu * float(np.exp(x[0]))}
    width = np.minimum(width, 50.0)  # a factor of e^50 is infinity to any reader
    half = {"mu": width[0]}
    place = {}
    for k, (g, tau) in enumerate(prony, start=1):
        value |= {f"g{k}": g, f"tau{k}": tau}
        half |= {f"g{k}": width[1 + order[k - 1]], f"tau{k}": width[1 + terms + order[k - 1]]}
        place[f"tau{k}"] = 1 + terms + order[k - 1]
    spread = np.sqrt(np.diag(covariance))
    names = list(place)
    alike = [
        (one, other)
        for i, one in enumerate(names)
        for other in names[i + 1 :]
        if abs(covariance[place[one], place[other]])
        > ALIKE * spread[place[one]] * spread[place[other]]
    ]
    misfit = np.sqrt(2 * fit.cost) * scale / np.linalg.norm(record.force)
    return Identified(
        value["mu"],
        prony,
        {name: float(value[name] * np.exp(-half[name])) for name in value},
        {name: float(value[name] * np.exp(half[name])) for name in value},
        float(misfit),
        {name: bool(half[name] < np.log(TOLD)) for name in value},
        alike,
        confidence,
    )
