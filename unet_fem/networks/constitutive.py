"""A recurrent network whose activation is the tissue's own law: one step of the reduced balance of
forces (fem.online.reduced), read as a network and trained as one.

    start    a = l + s (a_old - l_old)         l: the linear viscoelastic answer, g remembered
    dense    H_p = (A a)_p                     displacement gradients at m material points
    law      T_p = P_e(F_p) - F_p Q_p / c,     F = I + H; Q: what is left of the past stress
    dense    r = g / c - b - M [T ; b],        b = a - a_Q / c; r: how far from balance, in mm
    coarse   a = a + z,  z + B z = r,          B z = - N [T(H + A z) - T(H) - C A z]
    memory   S_e = F^-1 P_e and a enter the relaxed stresses, which forget by exp(-dt / tau)

The network contains the law, it does not learn one. A and M are those of a reduced model and stay;
s and N are trained. B is how the stiffness has changed since rest, seen at the first few of the
points, and the step is Newton's, by a few generalized conjugate residuals. Symbols, blocks and
sides are those of fem.online.reduced, a = [a_0; a_1]; lengths are in mm, stresses in units of the
shear modulus. Written in keras.ops alone, batch first.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import keras
import numpy as np
from keras import ops

from fem.online.constitutive import KRYLOV, TINY, TRUST, bulk_of
from fem.online.reduced_model import ReducedModel
from unet_fem.networks.point_stress import Stress, at_rest, full, neo_hooke, second_stress, times


class Memory(NamedTuple):
    """What the next frame depends on besides its force.

    history (B, K + 1, 6 m + R): relaxed stresses of the points, and beside them relaxed coordinates
    in mm, of the K Prony terms, and the last S_e and a. slow (B, C + 1, R) mm: what C retardations
    remember of g, and the last g. correction (B, R) mm: a - l of the last frame.
    """

    history: Any
    slow: Any
    correction: Any


class Rates(NamedTuple):
    """What a frame's length and a Prony series come down to, see unet_fem.runtime.rates.

    c (B, 1). past (B, 1, K + 1): of a history in Q. advance (B, K + 1, K + 2): of a history and the
    new stress in the next one. creep (B, C + 1, C + 2): of the slow ones and the new g. remembered
    (B, 1, C + 1): of the new slow ones in l.
    """

    c: Any
    past: Any
    advance: Any
    creep: Any
    remembered: Any


class Frame(NamedTuple):
    """What does not change within a frame: g / c (B, R), Q / c (B, 3, 3, m), a_Q / c (B, R), and K
    / mu, one value or one a point (m,)."""

    g: Any
    Q: Any
    aQ: Any
    bulk: Any


class ConstitutiveCell(keras.layers.Layer):
    """One frame of the network: (g, Memory, rates) -> (a, Memory, signs).

    A: (9 h, n_b) and M: (R_b, 9 h + n_b) of each parity, see fem.online.reduced; bulk: K / mu, one
    value or one a point (m,). coarse: how many points of a side N sees, the first ones.
    signs (B, 2): |r| at the start and |last step|, as shares of |a|.
    """

    def __init__(
        self,
        A: Sequence[np.ndarray],
        M: Sequence[np.ndarray],
        bulk: float | np.ndarray,
        coarse: int,
    ) -> None:
        super().__init__()
        self.h, self.coarse, self.sides = len(A[0]) // 9, coarse, len(A)
        self.sizes, self.seen = [len(rows) for rows in M], [one.shape[1] for one in A]
        starts = np.cumsum([0, *self.sizes])
        self.parts = [slice(*ends) for ends in zip(starts[:-1], starts[1:], strict=True)]
        self.bulk = np.float32(bulk) if np.ndim(bulk) == 0 else np.asarray(bulk, "float32")
        sees = [a.reshape(9, self.h, -1)[:, :coarse].reshape(9 * coarse, a.shape[1]) for a in A]
        self.A = [self._constant(f"A{b}", a.T) for b, a in enumerate(A)]
        self.Ac = [self._constant(f"coarse{b}", a.T) for b, a in enumerate(sees)]
        self.M = [self._constant(f"M{b}", rows.T) for b, rows in enumerate(M)]
        self.gain = self.add_weight((starts[-1],), "ones", name="gain")
        self.N = [
            self.add_weight((9 * coarse, R), "zeros", name=f"N{b}")
            for b, R in enumerate(self.sizes)
        ]

    @property
    def modes(self) -> int:
        """R, of all parities."""
        return sum(self.sizes)

    def _constant(self, name, value):
        made = self.add_weight(value.shape, "zeros", name=name, trainable=False)
        made.assign(np.asarray(value, "float32"))
        return made

    @classmethod
    def of(cls, model: ReducedModel, coarse: int) -> "ConstitutiveCell":
        """Around a ReducedModel. Raises InputError for another law than the neo-Hookean."""
        A, M = [block.A for block in model.blocks], [block.M for block in model.blocks]
        return cls(A, M, bulk_of(model.law), coarse)

    def gradients(self, a: Any, A: list) -> Any:
        """H (B, 3, 3, m) at the points of A, those on the left first."""
        parts = [
            ops.reshape(
                ops.matmul(a[:, p.start : p.start + n], rows), (-1, 3, 3, rows.shape[1] // 9)
            )
            for p, n, rows in zip(self.parts, self.seen, A, strict=True)
        ]
        if self.sides == 1:
            return parts[0]
        even, odd = parts
        return ops.concatenate([even + odd, even - odd], axis=3)

    def folded(self, T: Any) -> list:
        """(B, 9 h) of each parity of a field at the points (B, 3, 3, m)."""
        h = T.shape[-1] // self.sides
        left, right = T[..., :h], T[..., h:]
        parts = [left + right, left - right] if self.sides == 2 else [T]
        return [ops.reshape(part, (-1, 9 * h)) for part in parts]

    def begin(
        self, g: Any, memory: Memory, rates: Rates, bulk: Any = None
    ) -> tuple[Any, Any, Any, Frame]:
        """(a of the start, l, the slow ones of the creep, the Frame) under the force of g; bulk:
        K / mu, the cell's own if left out."""
        slow = ops.matmul(rates.creep, ops.concatenate([memory.slow, g[:, None]], axis=1))
        linear = g + weighted(rates.remembered, slow)
        past = weighted(rates.past, memory.history) / rates.c
        six = 6 * self.sides * self.h
        Q = full(ops.reshape(past[:, :six], (-1, 6, six // 6)))
        frame = Frame(g / rates.c, Q, past[:, six:], self.bulk if bulk is None else bulk)
        return linear + self.gain * memory.correction, linear, slow, frame

    def remember(self, memory: Memory, S: Any, a: Any, rates: Rates) -> Any:
        """The history after a frame that ends at a with the stresses S (B, 6, m)."""
        new = ops.concatenate([ops.reshape(S, (-1, 6 * self.sides * self.h)), a], axis=1)
        rows = ops.concatenate([memory.history, new[:, None]], axis=1)
        return ops.matmul(rates.advance, rows)

    def residual(self, a: Any, frame: Frame) -> tuple[Any, Any, Stress]:
        """(r (B, R) mm, H, Stress) at the coordinates a."""
        H = self.gradients(a, self.A)
        stress = neo_hooke(H, frame.bulk)
        T = stress.P - frame.Q - times(H, frame.Q)
        b = a - frame.aQ
        products = [
            ops.matmul(ops.concatenate([T_b, b[:, p.start : p.start + n]], axis=1), M)
            for T_b, p, n, M in zip(self.folded(T), self.parts, self.seen, self.M, strict=True)
        ]
        return frame.g - b - ops.concatenate(products, axis=1), H, stress

    def change(self, r: Any, H: Any, P: Any, frame: Frame) -> list:
        """Inputs (B, 9 coarse) of N of each parity: how the stress of a few points changes over a
        step r, less what it would at rest."""
        H, P, Q = (self._first(field) for field in (H, P, frame.Q))
        D = self.gradients(r, self.Ac)
        bulk = self._first(frame.bulk) if self.bulk.ndim else frame.bulk
        T = neo_hooke(H + D, bulk).P - P - at_rest(D, bulk) - times(D, Q)
        return self.folded(T)

    def _first(self, field):
        c, h = self.coarse, self.h
        if self.sides == 1:
            return field[..., :c]
        return ops.concatenate([field[..., :c], field[..., h : h + c]], axis=-1)

    def step(self, a: Any, frame: Frame) -> tuple[Any, Any, Stress]:
        """(step (B, R) mm, r, Stress) of one evaluation at a."""
        r, H, stress = self.residual(a, frame)
        if not self.coarse:
            return r, r, stress
        done: list[tuple] = []
        step, rest = ops.zeros_like(r), r
        for _ in range(KRYLOV):
            z = limited(rest, a)  # the law is not defined at what a runaway r gives
            q = z - self.coarse_residual(z, H, stress.P, frame)
            for y, p, square in done:
                share = 100 * dot(q, p) / square
                z, q = z - share * y, q - share * 0.01 * p
            p = 100 * q  # or TINY would be nothing in float16
            square = dot(p, p) + 1e4 * TINY
            share = 100 * dot(rest, p) / square
            step, rest = step + share * z, rest - share * q
            done.append((z, p, square))
        return step + rest, r, stress

    def coarse_residual(self, step: Any, H: Any, P: Any, frame: Frame) -> Any:
        """N D (B, R) mm: what a step adds to the residual beside - step."""
        products = [
            ops.matmul(x, N) for x, N in zip(self.change(step, H, P, frame), self.N, strict=True)
        ]
        return ops.concatenate(products, axis=1)

    def call(
        self,
        g: Any,
        memory: Memory,
        rates: Rates,
        evaluations: int = 1,
        bulk: Any = None,
        given: tuple[Any, Any] | None = None,
    ) -> tuple[Any, Memory, Any]:
        """a (B, R) mm, Memory and signs, from g (B, R) mm.

        bulk: K / mu, the cell's own if left out. given: (a (B, R), whether to start there (B, 1)).
        """
        a, linear, slow, frame = self.begin(g, memory, rates, bulk)
        if given is not None:
            a = a + given[1] * (given[0] - a)
        first = None
        for _ in range(evaluations):
            step, r, stress = self.step(a, frame)
            step = limited(step, a)
            first = dot(r, r) if first is None else first
            a = a + step
        signs = ops.concatenate([first, dot(step, step)], axis=1)
        signs = ops.sqrt(signs) / (norm(a) + 1e-3)
        history = self.remember(memory, second_stress(stress), a, rates)
        return a, Memory(history, slow, a - linear), signs

    @property
    def learned(self) -> dict[str, np.ndarray]:
        """{"gain", "N0", ...} as fem.online.constitutive has them."""
        found = {"gain": ops.convert_to_numpy(self.gain)}
        return found | {f"N{b}": ops.convert_to_numpy(N).T for b, N in enumerate(self.N)}

    def learn(self, learned: dict[str, np.ndarray]) -> None:
        """Take over what `learned` gave."""
        self.gain.assign(learned["gain"])
        for b, N in enumerate(self.N):
            N.assign(learned[f"N{b}"].T)

    def seen_by_N(self, g: Any, memory: Memory, rates: Rates) -> tuple:  # noqa: N802
        """(r of the start, what a step r adds to it beside - r, inputs of N of each parity)."""
        a, _, _, frame = self.begin(g, memory, rates)
        r, H, stress = self.residual(a, frame)
        step = limited(r, a)
        after, _, _ = self.residual(a + step, frame)
        return r, after - r + step, *self.change(step, H, stress.P, frame)

    def rest(self, batch: int, K: int, C: int) -> Memory:
        """No force in the past, for K Prony terms and C retardations."""
        R = self.modes
        shapes = (K + 1, 6 * self.sides * self.h + R), (C + 1, R), (R,)
        return Memory(*(ops.zeros((batch, *shape)) for shape in shapes))


def weighted(weights: Any, rows: Any) -> Any:
    """(B, n): the rows (B, k, n) times the weights (B, 1, k), added up. In LiteRT this is faster
    than a product of matrices, and slices that keep their axes are faster than others."""
    parts = (weights[:, :, k : k + 1] * rows[:, k : k + 1] for k in range(rows.shape[1]))
    return ops.reshape(sum(parts), (-1, rows.shape[2]))


def dot(u: Any, v: Any) -> Any:
    """(B, 1)."""
    return ops.sum(u * v, axis=1, keepdims=True)


def norm(a: Any) -> Any:
    """(B, 1) Euclidean, never zero."""
    a = 100 * a  # or TINY would be nothing in float16
    return 0.01 * ops.sqrt(dot(a, a) + 1e4 * TINY)


def limited(step: Any, a: Any) -> Any:
    """`step` (B, R), scaled back where it is longer than TRUST (|a| + 1 mm)."""
    return step * ops.minimum(1.0, TRUST * (norm(a) + 1) / norm(step))
