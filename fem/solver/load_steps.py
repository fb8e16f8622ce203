"""The steps of a solver that is implicit in time: as long as what the tissue remembers of the load
runs nearly linearly over each."""

from typing import NamedTuple

import numpy as np

from fem.online.creep import Creep, CreepFilter, exponential_weights
from fem.online.stepper import State
from fem.solver.load_ramp import NodalLoad, sampled_load

# share of the largest remembered load so far that may have relaxed besides what a step knows of it
BEND = 0.005
STRAIGHT = 3e-4  # the same, below which a step knows nothing of it
SAMPLE = 0.015  # share of the stress that may relax between two samples of the load
JUMP = 1e-6  # share of an `advance` in which a load comes that jumps at its start


class LoadStep(NamedTuple):
    """time: s, of its end; load: (3, N) N there; change: of f~ over the step, (3, N) N, see
    LoadSteps; bends: b_k, (3, N) N of each Prony term, None where it is too small to matter."""

    time: float
    load: np.ndarray
    change: np.ndarray
    bends: list[np.ndarray | None]


class LoadSteps:
    """Picks the steps from the load alone.

    In linear tissue the elastic stress follows the remembered load f~ (see fem.online.creep). A
    step over which that runs linearly is exact. Where f~ bends, the stress of its distance from the
    chord relaxes besides: for each term the load

        b_k = integral over the step of exp(-(end - s) / tau_k) (f~(s) - chord(s)) ds / tau_k

    whose linear answer makes the step exact again in linear tissue. The longest steps are taken in
    which sum g_k |b_k| is a small part of the largest f~ so far.

    prony: of the material; shape: of the load
    """

    def __init__(self, prony: tuple[tuple[float, float], ...], shape: tuple[int, ...]) -> None:
        self.prony = prony
        self.memory = CreepFilter(Creep.of(prony), shape)
        self.remembered = np.zeros(shape)  # N, f~ at the end of the last step
        self.largest = 0.0  # N, of the norms of f~

    def plan(
        self, load: NodalLoad, start: float, end: float, old: np.ndarray, jump: np.ndarray | None
    ) -> list[LoadStep]:
        """The steps from `start` to `end`.

        old: the load in which the last ended; jump: the load at `start`, where it is another
        """
        if not self.prony:
            last = sampled_load(load, end, old.shape)
            return [LoadStep(end, last, last - old, [])]
        relaxing = -sum(g * np.expm1((start - end) / tau) for g, tau in self.prony)
        count = int(np.ceil(relaxing / SAMPLE))
        inner = start + (end - start) * np.arange(1, count) / max(count, 1)
        times = [*inner, end]
        loads = [sampled_load(load, time, old.shape) for time in times]
        if jump is not None:
            times.insert(0, start + JUMP * (end - start))
            loads.insert(0, jump)
        return self._longest([start, *times], loads)

    def _longest(self, times, loads):
        """Some of the samples, each as late as the one before it allows; loads: at all but the
        first time."""
        kept: list[LoadStep] = []
        last: LoadStep | None = None
        begin, old = times[0], self.remembered
        relaxed = np.zeros((len(self.prony), *old.shape))  # of f~ since `begin`
        for before, time, load in zip(times, times[1:], loads, strict=False):
            now = self.memory.step(load, time - before)
            self.largest = max(self.largest, float(np.linalg.norm(now)))
            relaxed = self._relaxed(time - before, self.remembered, now, relaxed)
            bends = relaxed - self._relaxed(time - begin, old, now)
            if last and sum(self._sizes(bends)) > BEND * self.largest:
                kept.append(last)
                begin, old = before, self.remembered
                relaxed = self._relaxed(time - before, old, now)
                bends = np.zeros_like(relaxed)
            last = LoadStep(time, load, now - old, self._noticed(bends))
            self.remembered = now
        return [*kept, last]

    def _relaxed(self, elapsed, old, new, past=None):
        """What of a load that runs from `old` to `new` has relaxed at the end of `elapsed` seconds,
        and of the `past` that had relaxed at their start, one a term."""
        weights = [exponential_weights(elapsed, tau) for _, tau in self.prony]
        found = np.stack([a * before * old + a * after * new for a, before, after in weights])
        if past is not None:
            for (a, _, _), share, relaxed in zip(weights, found, past, strict=True):
                share += (1 - a) * relaxed
        return found

    def _sizes(self, bends):
        """[g_k |b_k|], N."""
        return [g * np.linalg.norm(b) for (g, _), b in zip(self.prony, bends, strict=True)]

    def _noticed(self, bends):
        """The bends that matter."""
        least = STRAIGHT * self.largest
        return [
            bend if size > least else None
            for bend, size in zip(bends, self._sizes(bends), strict=True)
        ]

    def state(self) -> State:
        """All that the next plan depends on besides the load; nothing for elastic tissue."""
        if not self.prony:
            return {}
        kept = {"f~": self.remembered.copy(), "largest": np.array(self.largest)}
        return self.memory.state() | kept

    def restore(self, state: State) -> None:
        """Go on from what `state` gave."""
        if self.prony:
            self.memory.restore(state)
            self.remembered, self.largest = np.array(state["f~"]), float(state["largest"])
