"""Creep of linear viscoelastic tissue, and forces as the tissue remembers them."""

import math
from dataclasses import dataclass

import numpy as np

from fem.errors import InputError
from fem.online.stepper import State, as_field, check_interval
from fem.ranges import checked_array

RELAXED, MOST = 0.2, 1000  # see steps_within


def exponential_weights(elapsed: float, tau: float) -> tuple[float, float, float]:
    """(a, old, new) of r <- r + a (old f_old + new f_new - r), the solution of r' = (f - r) / tau
    after `elapsed` seconds, exact where f runs linearly from f_old to f_new.

    `expm1` keeps a = 1 - exp(-x) exact for steps far below tau, and a series takes over where the
    quotient would cancel.
    """
    x = elapsed / tau
    a = float(-np.expm1(-x))
    new = (1 - a / x) / a if x > 1e-4 else 0.5 + x / 12
    return a, 1 - new, new


@dataclass(frozen=True)
class Creep:
    """D(t) = 1 + sum j_k (1 - exp(-t / l_k)): the displacement under a held force, in elastic
    answers.

    terms: ((j, l in s), ...), the weights and retardation times; positive.
    """

    terms: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if self.terms:
            checked_array("the terms of creep", self.terms, (None, 2), 1e-300, 1e15)

    @classmethod
    def of(cls, prony: tuple[tuple[float, float], ...]) -> "Creep":
        """The creep function of the relaxation function G(t) = 1 - sum g_k (1 - exp(-t / tau_k)).

        With the relaxed strains q_k' = (e - q_k) / tau_k the stress is s = e - sum g_k q_k. In the
        coordinates y_k = sqrt(g_k tau_k) q_k the answer to a stress is e = s + v . y,
        y' = S y + v s with v_k = sqrt(g_k / tau_k) and the symmetric S = v v^T - diag(1 / tau):
        each eigenvector of S is one retardation. Terms of equal times come out as one.

        A weight of zero leaves its term out. Raises InputError for a negative weight, a time that
        is not positive, values that are not finite, and where sum g is 1 or more: such tissue flows
        without end.
        """
        for g, tau in checked_array("prony", prony, (None, 2)) if np.size(prony) else ():
            if not (0 <= g < np.inf and 0 < tau < np.inf):
                raise InputError(
                    f"the Prony series has (g, tau) = ({g}, {tau}); give g of at least 0 and"
                    " tau > 0, both finite"
                )
        prony = tuple((g, tau) for g, tau in prony if g > 0)
        if not prony:
            return cls(())
        g, tau = np.array(prony, float).T
        if not g.sum() < 1:
            raise InputError(
                f"the weights g of the Prony series add up to {g.sum():g}: such tissue flows"
                " without end; keep their sum below 1"
            )
        v = np.sqrt(g / tau)
        rates, vectors = np.linalg.eigh(np.outer(v, v) - np.diag(1 / tau))
        times = -1 / rates
        weights = (vectors.T @ v) ** 2 * times
        order = np.argsort(times)
        kept = order[weights[order] > 1e-12 * weights.sum()]
        return cls(tuple((float(weights[k]), float(times[k])) for k in kept))

    @classmethod
    def from_array(cls, terms: np.ndarray) -> "Creep":
        """That of the terms (K, 2), see `array`."""
        return cls(tuple((float(weight), float(time)) for weight, time in terms))

    @property
    def array(self) -> np.ndarray:
        """The terms as an array (K, 2), for a file."""
        return np.array(self.terms, float).reshape(-1, 2)

    def __call__(self, t: np.ndarray | float) -> np.ndarray:
        """D at t seconds after the force came, of the shape of t."""
        t = np.asarray(t, float)
        total = np.ones_like(t)
        for weight, time in self.terms:
            total -= weight * np.expm1(-t / time)
        return total


def filter_weights(creep: Creep, dt: float) -> np.ndarray:
    """(terms + 1, terms + 2) from the r_k of dt seconds ago, the force of then and that of now to
    the r_k and f~ of now, see CreepFilter. Raises InputError for a dt that is not positive and
    finite."""
    check_interval(None, dt)
    count = len(creep.terms)
    weights = np.zeros((count + 1, count + 2))
    weights[-1, -1] = 1.0
    for k, (weight, time) in enumerate(creep.terms):
        a, old, new = exponential_weights(dt, time)
        weights[k, [k, -2, -1]] = 1 - a, a * old, a * new
        weights[-1] += weight * weights[k]
    return weights


def steps_within(prony: tuple[tuple[float, float], ...], dt: float) -> int:
    """How many steps a frame of dt seconds takes, so that the stress runs nearly linearly over
    each: RELAXED of it at most relaxes in one. MOST at most."""
    if relaxing(prony, dt) <= RELAXED:
        return 1
    low, high = 0.0, dt
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (low, middle) if relaxing(prony, middle) > RELAXED else (middle, high)
    return min(math.ceil(dt / low), MOST) if low else MOST


def relaxing(prony: tuple[tuple[float, float], ...], dt: float) -> float:
    """The share of a held stress that relaxes in dt seconds, 1 - G(dt)."""
    return -sum(g * math.expm1(-dt / tau) for g, tau in prony)


class CreepFilter:
    """f~(t) = integral of D(t - s) df(s), a sampled force as creeping tissue remembers it: under
    f~ an elastic tissue of the same stiffness moves alike, as far as it is linear.

    The force runs linearly from sample to sample, from none at the reset, and f~ is then exact for
    any intervals, which may change. With D = 1 + sum j_k (1 - exp(-t / l_k)) it is
    f~ = f + sum j_k r_k, r_k' = (f - r_k) / l_k, and the r_k are all that is kept besides the last
    force; without terms nothing is.
    """

    def __init__(self, creep: Creep, shape: tuple[int, ...]) -> None:
        """shape: of the force, such as (N, 3), or (p,) of some of its components."""
        self.creep, self.shape = creep, tuple(shape)
        self._elapsed = math.nan  # s, the interval that the weights are for
        self.reset()

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        # rows: r_k, the last force, this force; two of them, the new state is written to the other
        rows = len(self.creep.terms) + 2
        self._now, self._other = np.zeros((2, rows, math.prod(self.shape)))

    def step(self, force: np.ndarray, dt: float) -> np.ndarray:
        """f~, float64, of the shape and in the unit of `force`, which has come dt seconds after the
        last one.

        Raises InputError for another shape, values that are not finite and a dt that is not
        positive; the state is then as it was.
        """
        force = as_field(force)
        if force.shape != self.shape or force.dtype.kind not in "fiu":
            raise InputError(
                f"the force is {force.dtype} of shape {force.shape}; give real numbers of shape"
                f" {self.shape}"
            )
        if dt != self._elapsed:
            self._weigh(dt)
        now, new, last = self._now, self._other, len(self.creep.terms)
        now[-1] = force.ravel()
        if not math.isfinite(np.vdot(now[-1], now[-1])):  # its square is: cheaper than to ask each
            raise InputError("the force is not finite, or too large; give finite values")
        np.matmul(self._weights, now, out=new[:-1])
        remembered = new[last].reshape(self.shape).copy()
        new[last] = now[-1]
        self._now, self._other = new, now
        return remembered

    @property
    def last(self) -> np.ndarray:
        """The force of the last step, of `shape`; a view."""
        return self._now[len(self.creep.terms)].reshape(self.shape)

    def _weigh(self, dt: float) -> None:
        self._weights, self._elapsed = filter_weights(self.creep, dt), dt

    def state(self) -> State:
        """{"remembered": (terms + 1, *shape)}: the r_k and the last force; empty without terms."""
        if not self.creep.terms:
            return {}
        return {"remembered": self._now[:-1].reshape(-1, *self.shape).copy()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another filter."""
        if not self.creep.terms:
            return
        found, own = state.get("remembered"), (len(self.creep.terms) + 1, *self.shape)
        if found is None or np.shape(found) != own or not np.isfinite(found).all():
            what = "nothing" if found is None else f"shape {np.shape(found)}"
            raise InputError(
                f"the state holds {what} as remembered and this filter keeps finite values {own};"
                " restore what state() of the same stepper gave"
            )
        self._now[:-1] = np.reshape(found, (own[0], -1))


def remembered_force(creep: Creep, force: np.ndarray, interval: float) -> np.ndarray:
    """What a CreepFilter gives at the frames of `force`.

    force: (..., frames, d), `interval` s apart and linear between, from none one interval before
    the first frame. Raises InputError as a CreepFilter does.
    """
    if np.ndim(force) < 2:
        raise InputError(f"the force has shape {np.shape(force)}; give (..., frames, d)")
    frames = np.moveaxis(np.asarray(force), -2, 0)
    memory = CreepFilter(creep, frames.shape[1:])
    return np.stack([memory.step(frame, interval) for frame in frames], axis=-2)
