"""A probe at a given place in the tissue: the force that a haptic device asks for. NumPy alone.

A device tells where its tip is, not how hard it pushes. With the residual r of fem.online.reduced,
g the answer at rest to a unit force of the probe's footprint, and p the mean of the displacement
under it, the tissue is at rest under a probe that has pushed it by d where

    r(a) + f g / c = 0,    p . a = d

and Newton's step for both takes two solutions of the network's own step, z = J^-1 (r + f g / c) and
y = J^-1 g / c:

    f <- f + (d - p . (a + z)) / (p . y),    a <- a + z + (change of f) y

p . y is the local compliance. A probe that only touches cannot pull: f is not below zero, and the
tissue is left where it comes back to by itself. A probe that holds on (`target`) has three of each.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fem.errors import InputError
from fem.files import load_arrays
from fem.online.constitutive import ConstitutiveStepper, learned_of, limited
from fem.online.contact_surface import ContactSurface
from fem.online.reduced_model import ReducedModel
from fem.online.stepper import State

SETTLED = 0.05  # a last step longer than this share of |a| + FLOOR is flagged
FLOOR = 0.1  # mm
SMALL = 0.01  # of |a| + 1 mm: what the law's change is asked for, to be its slope


@dataclass(frozen=True)
class Touch:
    """What a tick of a Press answers.

    force: (3,) mN of the tissue on the probe; displacement: (3,) mm of the tissue under it, mean of
    the footprint; compliance: mm/mN along the inward normal, or (3, 3) of a probe that holds on, of
    changes within dt; contact: whether they touch; flagged: whether nobody vouches for the answer,
    with its `reason`.
    """

    force: np.ndarray
    displacement: np.ndarray
    compliance: float | np.ndarray
    contact: bool
    flagged: bool = False
    reason: str = ""


class Press:
    """A constitutive network that is told where a probe is, call by call.

    stepper: it may be stepped by forces in between; surface: of its body, in mm; most: evaluations
    a tick at most. After a tick `a` (R,) are the coordinates in mm.

    What a device sends in error (a place that is not finite, or beside the tissue) is answered as
    if the probe were lifted, and flagged: the loop goes on.
    """

    def __init__(
        self, stepper: ConstitutiveStepper, surface: ContactSurface, most: int = 3
    ) -> None:
        if stepper.model.meta["nodes"] != surface.count:
            raise InputError(
                f"the surface is of {surface.count} nodes and the network of"
                f" {stepper.model.meta['nodes']}; give that of its own mesh"
            )
        self.stepper, self.surface, self.most = stepper, surface, most
        self._phi = stepper.fields.at(np.arange(surface.count))  # (N, 3, R), zero where held
        self._flexibility = [block.flexibility for block in stepper.model.blocks]
        self._stiffness = [np.linalg.inv(F.astype(float)).astype("f4") for F in self._flexibility]
        self._forget()

    @classmethod
    def open(cls, path: Path | str, interval: float | None = None, most: int = 3) -> "Press":
        """That of a constitutive network's file, .npz or .tflite. Raises InputError for another
        file, and for one without the body's surface."""
        arrays = load_arrays(path)
        model = ReducedModel.of(arrays, path)
        stepper = ConstitutiveStepper(model, learned_of(model, arrays, path), interval)
        return cls(stepper, model.surface(), most)

    def reset(self) -> None:
        """Back to rest, with the probe lifted."""
        self.stepper.reset()
        self._forget()

    def _forget(self):
        self._force, self._place, self._patch = np.zeros(3), None, None

    def __call__(
        self,
        position: np.ndarray,
        depth: float | None = None,
        radius: float = 2.5,
        *,
        target: np.ndarray | None = None,
        dt: float | None = None,
    ) -> Touch:
        """The answer dt seconds after the call before, to a probe of `radius` mm.

        position: (3,) mm, the point of the surface at rest that the probe is at; depth: mm inwards
        from there, of a probe that touches; target: (3,) mm, where a probe that holds on has moved
        that point to. Raises InputError unless one of the two is given, and for a dt that the
        stepper does not take.
        """
        if (depth is None) == (target is None):
            raise InputError("give depth, of a probe that touches, or target, of one that holds on")
        dt = self.stepper.take(dt)
        try:
            weights, unit = self._footprint(position, radius)
            wanted = _finite(depth if target is None else np.subtract(target, position))
        except InputError as error:
            return self._lifted(dt, str(error))
        if target is None:
            unit, floor = unit[None], 0.0
        else:
            unit, floor = np.eye(3), -np.inf
        return self._press(weights, unit, np.atleast_1d(wanted), floor)

    def _footprint(self, position, radius):
        """(((k,) nodes, (k,) shares), (3,) inward normal) under a probe."""
        place = (*np.asarray(position, float).ravel().tolist(), radius)
        if place != self._place:
            shares, normal = self.surface.patch(position, radius)
            nodes = np.flatnonzero(shares)
            weights = shares[nodes].astype(np.float32)
            mean = np.tensordot(weights, self._phi[nodes], 1)  # (3, R)
            self._place, self._patch = place, ((nodes, weights, mean), -normal)
        return self._patch

    def _press(self, patch, unit, wanted, floor):
        """unit (q, 3): the directions of the probe's forces; wanted (q,) mm along them."""
        stepper, residual = self.stepper, self.stepper.residual
        p = unit.astype(np.float32) @ patch[2]  # (q, R)
        g = self._at_rest(p.T)  # (R, q)
        residual.begin(np.zeros(len(g), np.float32))
        f, a = unit @ self._force, stepper.a.copy()
        load = g / np.float32(residual.c)
        evaluations, length, size = 0, np.inf, float(np.linalg.norm(a))
        with np.errstate(all="ignore"):  # what is not finite is taken back
            while evaluations < self.most and length > stepper.share * (size + FLOOR):
                r = residual(a) + load @ f.astype(np.float32)
                small = SMALL * (size + 1) / np.linalg.norm(load, axis=0)
                solved, rest = stepper.newton(np.column_stack([r, small * load]), a)
                solved[:, 1:] /= small
                rest[:, 1:] /= small
                z, y = solved[:, 0] + rest[:, 0], solved[:, 1:]
                stiff = self._loads(y).T @ rest[:, 1:]  # second order, J being symmetric in K
                compliance = (p @ y + np.float32(residual.c) * stiff).astype(float)
                y = y + rest[:, 1:]
                change = _solve(compliance, wanted - p @ (a + z))
                new = np.maximum(f + change, floor)
                whole = z + y @ (new - f).astype(np.float32)
                step = limited(whole, a)
                evaluations, length = evaluations + 1, float(np.linalg.norm(step))
                share = length / max(float(np.linalg.norm(whole)), 1e-30)
                if not (length < np.inf and np.isfinite(new).all()):
                    break
                a, f = a + step, f + min(share, 1.0) * (new - f)
                size = float(np.linalg.norm(a))
        stepper.ended(a, g @ f.astype(np.float32))
        stepper.evaluations, stepper.unrest = evaluations, length / (size + 1e-3)
        self._force = f @ unit
        settled = length <= SETTLED * (size + FLOOR)
        return Touch(
            -self._force,
            patch[2] @ a,
            float(compliance[0, 0]) if len(unit) == 1 else compliance,
            bool(np.isinf(floor) or f[0] > 0),
            not settled,
            "" if settled else "the frame did not settle",
        )

    def _lifted(self, dt, reason):
        """A tick without a probe, flagged."""
        self._forget()
        self.stepper.step(np.zeros((self.surface.count, 3), np.float32), dt)
        return Touch(np.zeros(3), np.full(3, np.nan), np.nan, False, True, reason)

    def _at_rest(self, work):
        """(R, q) mm, K_r^-1 of (R, q)."""
        return self._by_blocks(self._flexibility, work)

    def _loads(self, a):
        """(R, q) mN, K_r of (R, q)."""
        return self._by_blocks(self._stiffness, a)

    def _by_blocks(self, matrices, x):
        parts = zip(matrices, self.stepper.residual.parts, strict=True)
        return np.concatenate([A @ x[part] for A, part in parts])

    def displacement(self) -> np.ndarray:
        """(N, 3) mm of the whole body after the last tick."""
        return self.stepper.fields.decode(self.stepper.a, (self.surface.count, 3))

    def state(self) -> State:
        """All that the next answer depends on besides the next place."""
        return self.stepper.state() | {"probe": self._force.copy(), "a": self.stepper.a.copy()}

    def restore(self, state: State) -> None:
        """Go on from what `state` gave."""
        rest = dict(state)
        force, a = rest.pop("probe"), rest.pop("a")
        self.stepper.restore(rest)
        self._force, self.stepper.a = np.array(force), np.array(a)


def _solve(matrix, right):
    """Its solution, or infinite ones where there is none."""
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return np.full(len(right), np.inf)


def _finite(value):
    value = np.asarray(value, float)
    if value.shape not in ((), (3,)) or not np.isfinite(value).all():
        raise InputError(f"the probe is at {value.tolist()} mm; give finite mm")
    return value
