"""The reduced solver: viscoelastic equilibrium in a few hundred modes, with the material's own law
at a few hundred points. NumPy alone.

    u   = Phi a                             a (R,) modal coordinates in mm
    F_p = I + (A a)_p                       deformation gradient at m material points
    T_p = c P_e(F_p) - F_p Q_p              the law, less the viscous stress of the point's past
    r   = (g + a_Q - M [T ; b]) / c - a     residual in mm;  b = c a - a_Q,  g = K_r^-1 Phi^T f
    a  <- a + r, Anderson-accelerated       until |r| is small beside |a|

A frame starts at the linear answer to the creep-convolved force, g~ = g + sum_k j_k s_k, plus the
last frame's difference from it. P_e is the elastic first Piola-Kirchhoff stress, the viscous one is
that of S = F^-1 P_e (quasi-linear viscoelasticity), and both are in units of the shear modulus at
rest of the point. K_r is the stiffness at rest in the modes, and M has K_r^-1 in it. The linear
part is exact: the points carry the nonlinear remainder alone.

What passes from frame to frame, exact for stresses and forces that run linearly in between
(a_k, old_k, new_k = fem.online.creep.exponential_weights(dt, tau_k)):

    c   = 1 - sum_k g_k a_k new_k
    Q   = sum_k g_k ((1 - a_k) q_k + a_k old_k S_old)         S_e at the points, a_Q likewise of a
    q_k <- (1 - a_k) q_k + a_k old_k S_old + a_k new_k S_new

Neither A, M, g nor the filters hold dt: frames may have any length, and lengths may change. Long
ones are taken in steps.

The arrays of a file `unet-fem reduced 1`, little-endian float32 unless said, C order. Two blocks
where the body has a mirror plane: 0 of the even modes and 1 of the odd ones, a = [a_0; a_1]. h
points (or nodes) are on the left, and their images on the right; all that belongs to a right one is
kept mirrored, R v and R F R, where nothing but the sums and differences below needs a sign. Without
a mirror there is block 0 alone, and all are left ones.

    A<b> (9 h, n_b) 1/mm       H_b = A_b a_b[:n_b], as (3, 3, h); the first n_b modes are seen
                               H_left = H_0 + H_1,  H_right = H_0 - H_1;  F = I + H
    M<b> (R_b, 9 h + n_b)      on z_b = [T_b ; b_b[:n_b]],  T_0 = T_left + T_right and T_1 = T_left
                               - T_right, as (9 h,); r_b = (g_b + a_Q,b - M_b z_b) / c - a_b
    encoder<b> (R_b, 3 h_f) mm/mN   g_b of f_0 = f_left + R f_right and f_1 = f_left - R f_right, as
                               (3, h_f); of the nodes in `force` (sides, h_f) int32
    decoder<b> (3 h_u, R_b)    u_b (3, h_u);  u_left = u_0 + u_1,  R u_right = u_0 - u_1; of the
                               nodes in `free` (sides, h_u) int32; the other nodes stand still
    flexibility<b> (R_b, R_b) mm/mN   K_r^-1 of the block
    missing<b> (k_b, 3 h_f) mm/mN   |missing_b f_b|^2, summed, is the square of what the modes miss
                               of the linear answer to f: for fem.online.indicator
    prony (K, 2) float64       g, tau in s
    places (N, 3), faces (M, 4) int32    mm of the nodes, and those of the faces that contacts push
                               on; not in files of before
    grid_shape (3,), grid_index (N,) int64    the node grid of the mesh, where it has one
    meta uint8                 JSON in UTF-8: `axis` that R flips, digests of `mesh` and `material`,
                               `law` {kind, parameters: a number, or one a point, left ones first},
                               `nodes` N, `interval` s of the frames that M was fitted to
"""

import math
from pathlib import Path

import numpy as np

from fem.errors import InputError
from fem.online.creep import Creep, CreepFilter, steps_within
from fem.online.fields import Fields
from fem.online.reduced_model import ReducedModel
from fem.online.residual import Residual
from fem.online.secants import Secants
from fem.online.stepper import State, as_field, check_interval, check_state
from fem.ranges import checked

# chosen on validation interactions, see docs/reduced.md
TOLERANCE, MOST, SECANTS = 2e-3, 20, 8
FLOOR = 1e-4  # mm, of |r|: below it a frame is at rest whatever |a|
WORSE = 4.0  # a step that raises |r|^2 so much is taken back


class ReducedStepper:
    """A ReducedModel as a Stepper for frames of any length.

    interval: s between calls that give no dt, or None; tolerance: |r| / |a| at which a frame ends;
    most: evaluations a frame at most, 1 for a fixed effort

    A frame in which much of the stress relaxes is taken in steps, see
    fem.online.creep.steps_within. After a frame `a` (R,) are its coordinates, `evaluations` how
    many its last step took, `unrest` the last |r| / |a|, and `carried` whether all of the force
    stood at nodes that contacts push on.
    """

    def __init__(
        self,
        model: ReducedModel,
        interval: float | None = None,
        tolerance: float = TOLERANCE,
        most: int = MOST,
    ) -> None:
        if not 0 < tolerance < 1:
            raise InputError(f"tolerance = {tolerance} must be between 0 and 1")
        if most < 1:
            raise InputError(f"most = {most} evaluations a frame must be at least 1")
        if interval is not None:
            check_interval(None, interval)
        self.model, self.interval, self.grid = model, interval, model.grid
        self.tolerance, self.most = tolerance, most
        self.fields, self.residual = Fields(model), Residual(model)
        creep = Creep.of(tuple((float(g), float(tau)) for g, tau in model.prony))
        self._memory = CreepFilter(creep, (model.modes,))
        self._elapsed, self._steps = math.nan, 1  # s, the dt that the residual's filters are for
        self._secants = Secants(model.modes, SECANTS)
        self.reset()

    @classmethod
    def open(cls, path: Path | str, interval: float | None = None) -> "ReducedStepper":
        """That of the file at `path`. Raises InputError for another file."""
        return cls(ReducedModel.load(path), interval)

    def reset(self) -> None:
        """Back to rest: no force in the past."""
        self.residual.reset()
        self._memory.reset()
        self._correction = np.zeros(self.model.modes, np.float32)
        self._secants.clear()
        self.a = np.zeros(self.model.modes, np.float32)
        self.evaluations, self.unrest, self.carried = 0, 0.0, True

    def step(self, force: np.ndarray, dt: float | None = None) -> np.ndarray:
        """Displacement in mm, float32, dt seconds after the call before, under `force` in mN that
        grew linearly since; see fem.online.stepper.Stepper."""
        dt = self.take(dt)
        layout, g = self.fields.encode(as_field(force))
        self.carried = self.fields.carried
        if self._steps == 1:
            self._frame(g, dt)
        else:
            self._in_steps(g, dt)
        return self.fields.decode(self.a, layout)

    def _in_steps(self, g, dt):
        """A frame in several, under a force that grows linearly."""
        count, old = self._steps, self._memory.last.copy()
        self.residual.set_interval(dt / count)
        for step in range(1, count + 1):
            self._frame((old + step / count * (g - old)).astype(np.float32), dt / count)
        self.residual.set_interval(dt)

    def _frame(self, g, dt):
        """A frame under the force whose elastic answer is g (R,) mm."""
        linear = self._memory.step(g, dt).astype(np.float32)
        self.residual.begin(g)
        with np.errstate(all="ignore"):  # a guess may be anything; what is not finite is taken back
            self.a = self._solve(linear + self._correction)
        self._end(linear)

    def take(self, dt: float | None) -> float:
        """The dt in s of a frame that begins, `interval` for None. Raises InputError for one that
        it does not take."""
        if dt is None:
            dt = self.interval
        if dt is None or dt != self._elapsed:
            check_interval(None, dt)
            self._elapsed = float(dt or 0)
            self._steps = steps_within(tuple(self.residual.prony), self._elapsed)
            self.residual.set_interval(self._elapsed)
        return self._elapsed

    def ended(self, a: np.ndarray, g: np.ndarray) -> None:
        """Go on from a frame that was solved elsewhere: coordinates a (R,) mm under the force whose
        answer at rest is g (R,) mm."""
        self.a = a
        self._end(self._memory.step(g, self._elapsed).astype(np.float32))

    def _end(self, linear):
        self.residual.accept(self.a)
        self._correction = self.a - linear

    def _solve(self, a):
        """The coordinates at which the frame is at rest, from a first guess; where that cannot be
        reached in `most` evaluations, the best."""
        residual, tried = self.residual, 0
        best, kept, taken, share = np.inf, None, False, 1.0
        self._secants.begin()
        while tried < self.most:
            tried += 1
            r = residual(a)
            square = float(r @ r)
            if not square < WORSE * best:  # or NaN
                self._secants.clear()
                share, taken = share / 2, False
                a = kept[0] + share * kept[1] if kept else np.zeros_like(a)
                continue
            if square < best:
                best, kept, share = square, (a, r), 1.0
            taken, a = True, a + self._secants.step(a, r)
            scale = float(a @ a)
            if square <= self.tolerance**2 * scale + FLOOR**2:
                break
        self.evaluations = tried
        if not taken:
            a = np.zeros_like(a) if kept is None else kept[0]
            residual(a)  # once more, so that the history is that of it
        self.unrest = float(np.sqrt(min(best, square) / max(float(a @ a), FLOOR**2)))
        return a

    def state(self) -> State:
        """All that the next answer depends on: histories, the filters, the last correction and the
        secants."""
        found = self.residual.state() | self._memory.state() | self._secants.state()
        return found | {"correction": self._correction.copy()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises InputError for the state of another stepper."""
        check_state(state, self.state())
        checked("count", int(state["count"]), 0, 2**62, whole=True)
        self.residual.restore(state)
        self._memory.restore(state)
        self._correction = np.array(state["correction"], np.float32)
        self._secants.restore(state)
