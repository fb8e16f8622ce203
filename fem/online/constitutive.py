"""The constitutive network in NumPy alone: a reduced model with a learned start and step.

    a = l + s (a_old - l_old)              start
    a = a + z,  z + B z = r(a)             one evaluation
    B z = - N [T(H + A z) - T(H) - C A z]  at the first few points

r is the residual of fem.online.reduced. B is how the stiffness has changed since rest, seen at a
few of the points, where the stress T, divided by c, is asked for once more; the step is Newton's,
solved by KRYLOV generalized conjugate residuals. Further evaluations of a frame start where
Anderson acceleration of these steps leads. Symbols, blocks and sides are those of
fem.online.reduced, in whose file s and N stand beside the arrays of the reduced model:

    gain (R,)              s
    N<b> (R_b, 9 k)        of the stresses of k points a side, left and right folded as T is
    V<b> (R_b, R_b)        see fem.online.retissue; not in every file
    guard (2, 5)           see unet_fem.runtime.guard, for this effort and for one evaluation
                           always; not in every file
    effort (2,)            a frame whose last step or residual is longer than effort[0] |a| gets
                           another evaluation, up to effort[1] of them

unet_fem.networks.constitutive trains them. The stepper that knows nothing of them opens the file as
well.
"""

from pathlib import Path

import numpy as np

from fem.errors import InputError
from fem.files import load_arrays, save_arrays
from fem.material.base import Hyperelastic, bulk_modulus
from fem.material.neo_hooke import NeoHooke
from fem.online.point_law import NeoHookePoints
from fem.online.reduced import ReducedStepper
from fem.online.reduced_model import FORMAT, ReducedModel
from fem.online.secants import Secants

KRYLOV = 3  # conjugate residuals a step
SECANTS = 5  # of a frame
TINY = 1e-7  # mm2, where nothing is out of balance
TRUST = 0.5  # a step is at most TRUST (|a| + 1 mm) long
REMEDY = "train one with python -m unet_fem.train configs/constitutive.toml"


def bulk_of(law: Hyperelastic) -> np.ndarray:
    """K / mu of the points, () or (m,). Raises InputError for another law than the neo-Hookean."""
    if not isinstance(law, NeoHooke):
        raise InputError(
            f"the constitutive network holds the neo-Hookean law, not {type(law).__name__};"
            " step the reduced model itself"
        )
    shared = np.ndim(law.mu) and not np.ndim(law.nu)
    return np.asarray(bulk_modulus(1.0, law.nu) if shared else law.K / law.mu, np.float32)


class ConstitutiveStepper(ReducedStepper):
    """A ReducedModel with a learned step as a Stepper for frames of any length.

    learned: {"gain", "N0", ..., "effort"}; effort: in place of the learned one; (1, 1) is always
    one evaluation. After a step `unrest` is the longer of the last step and the residual before it,
    beside |a|; see ReducedStepper for the rest.
    """

    def __init__(
        self,
        model: ReducedModel,
        learned: dict[str, np.ndarray],
        interval: float | None = None,
        effort: tuple[float, int] | None = None,
    ) -> None:
        share, most = learned["effort"] if effort is None else effort
        super().__init__(model, interval)
        self._secants = Secants(model.modes, SECANTS)
        if not (0 < share <= 1 and most >= 1):
            raise InputError(f"effort = ({share}, {most}) must be a share up to 1 and at least 1")
        self.share, self.most = float(share), int(most)
        self.gain = learned["gain"]
        self.N = [learned[f"N{b}"] for b in range(len(model.blocks))]
        k, h = self.N[0].shape[1] // 9, model.points // len(model.blocks)
        first = np.concatenate([side * h + np.arange(k) for side in range(len(self.N))])
        self._bulk = bulk_of(model.law)
        if self._bulk.ndim:
            self._bulk = self._bulk[first]
        self._first = first
        self._laws = {1: self._coarse_law(1)}  # by how many steps are asked for side by side
        self._A = [b.A.reshape(9, h, -1)[:, :k].reshape(9 * k, -1) for b in model.blocks]

    @classmethod
    def open(
        cls,
        path: Path | str,
        interval: float | None = None,
        effort: tuple[float, int] | None = None,
    ) -> "ConstitutiveStepper":
        """That of the file at `path`. Raises InputError for another file."""
        return cls(*load_constitutive(path), interval, effort)

    def _solve(self, a):
        """The coordinates after one evaluation, or a few; of a frame that does not settle, those of
        the best."""
        start, self.evaluations = a + (self.gain - 1) * self._correction, 0
        kept, best = start, np.inf
        self._secants.clear()
        while True:
            a, step = self._evaluated(start)
            self.evaluations += 1
            if self.unrest < best:
                kept, best = start, self.unrest
            if self.unrest <= self.share:
                return a
            if self.evaluations == self.most:
                return a if self.unrest <= best else self._evaluated(kept)[0]
            start = start + limited(self._secants.step(start, step), start)

    def _evaluated(self, start):
        """(coordinates, step) of one evaluation from `start`."""
        r = self.residual(start)
        step = limited(self._step(r, start), start)
        a = start + step
        size = float(np.linalg.norm(a)) + 1e-3
        self.unrest = max(float(np.linalg.norm(r)), float(np.linalg.norm(step))) / size
        return a, step

    def _step(self, r, a):
        """Newton's step from a, where the residual r was last asked for."""
        z, rest = self.newton(r[:, None], a)
        return (z + rest)[:, 0]

    def newton(self, right: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(z, right - z - B z), (R, q) each: z + B z = right of each of q columns, from a, where
        the residual was last asked for."""
        step, rest = np.zeros_like(right), right
        done: list[tuple[np.ndarray, ...]] = []
        for _ in range(KRYLOV):
            z = limited(rest, a)  # the law is not defined at what a runaway r gives
            q = z - self._coarse_residual(z)
            for y, p, square in done:
                share = _dots(q, p) / square
                z, q = z - share * y, q - share * p
            square = _dots(q, q) + np.float32(TINY)
            share = _dots(rest, q) / square
            step, rest = step + share * z, rest - share * q
            done.append((z, q, square))
        return step, rest

    def _coarse_law(self, count):
        """The law at the first points, `count` times over, and room for its change."""
        at = np.repeat(self._first, count)
        law = self.model.law.of_cells(at, self.model.points)
        # type: ignore[arg-type]
        return NeoHookePoints(law, len(at)), np.empty((3, 3, len(at)), np.float32)

    def _coarse_residual(self, z):
        """What steps z (R, q) add to the residual beside - z: (R, q)."""
        residual, first, count = self.residual, self._first, z.shape[1]
        if count not in self._laws:
            self._laws[count] = self._coarse_law(count)
        law, T = self._laws[count]
        parts = [
            (A @ z[p.start : p.start + A.shape[1]]).reshape(3, 3, -1)
            for A, p in zip(self._A, residual.parts, strict=True)
        ]
        D = np.concatenate([parts[0] + parts[1], parts[0] - parts[1]], 2) if parts[1:] else parts[0]
        H, P, bulk = residual.law.H[:, :, first], residual.law.P[:, :, first], self._bulk
        if count > 1:
            H, P = np.repeat(H, count, 2), np.repeat(P, count, 2)
            bulk = np.repeat(bulk, count) if bulk.ndim else bulk
        np.add(H, D, out=law.H)
        law(1.0, None, T)
        T -= P
        T -= D
        T -= D.swapaxes(0, 1)
        T.reshape(9, -1)[::4] -= bulk * np.trace(D)
        if residual.prony:
            Q = residual.viscous(first) / np.float32(residual.c)
            if count > 1:
                Q = np.repeat(Q, count, 2)
            T -= np.einsum("ikm,kjm->ijm", D, Q)
        k = T.shape[2] // len(parts)
        left, right = T[:, :, :k], T[:, :, k:]
        folded = [left + right, left - right] if parts[1:] else [T]
        both = zip(self.N, folded, strict=True)
        return np.concatenate([N @ F.reshape(-1, count) for N, F in both])


def _dots(x, y):
    """(q,) of the columns of two (R, q)."""
    return np.einsum("rq,rq->q", x, y)


def limited(step: np.ndarray, a: np.ndarray) -> np.ndarray:
    """`step` (R,), or each of its columns (R, q), scaled back where it is longer than TRUST (|a| +
    1 mm)."""
    length = np.linalg.norm(step, axis=0)
    most = TRUST * (float(np.linalg.norm(a)) + 1)
    if (length <= most).all():
        return step
    return step * np.where(length <= most, 1, most / length).astype(np.float32)


def save_constitutive(
    path: Path | str, model: ReducedModel, learned: dict[str, np.ndarray]
) -> None:
    """Write a model and {"gain", "N0", ..., "effort"} to `path` (.npz), at once or not at all."""
    save_arrays(path, format=FORMAT, **model.arrays(), **learned)


def load_constitutive(path: Path | str) -> tuple[ReducedModel, dict[str, np.ndarray]]:
    """What `save_constitutive` wrote. Raises InputError for another file."""
    model, arrays = ReducedModel.load(path), load_arrays(path)
    return model, learned_of(model, arrays, path)


def learned_of(
    model: ReducedModel, arrays: dict[str, np.ndarray], path: Path | str
) -> dict[str, np.ndarray]:
    """The learned ones of `arrays`. Raises InputError where they are missing or do not fit."""
    names = ["gain", "effort", *(f"N{b}" for b in range(len(model.blocks)))]
    missing = [name for name in names if name not in arrays]
    if missing:
        raise InputError(f"{path} holds no {missing[0]}: no network was trained on it; {REMEDY}")
    shares = [f"V{b}" for b in range(len(model.blocks)) if f"V{b}" in arrays]
    guard = ["guard"] if "guard" in arrays else []
    learned = {name: arrays[name] for name in names + shares + guard}
    columns = (0, *learned["N0"].shape)[-1]
    shapes: dict[str, tuple] = {"gain": (model.modes,), "effort": (2,)}
    shapes |= {f"N{b}": (len(block.M), columns) for b, block in enumerate(model.blocks)}
    shapes |= dict.fromkeys(guard, (2, 5))
    shapes |= {name: (len(model.blocks[b].M),) * 2 for b, name in enumerate(shares)}
    for name, shape in shapes.items():
        found = learned[name]
        if found.shape != shape or found.dtype.kind != "f" or not np.isfinite(found).all():
            raise InputError(f"{path}: {name} must be finite and of shape {shape}; {REMEDY}")
    if not columns or columns % 9 or columns > len(model.blocks[0].A):
        raise InputError(f"{path}: N0 has {columns} columns, which are no 9 a point; {REMEDY}")
    return learned
