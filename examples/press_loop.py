"""A haptic loop at 1 kHz: a hand pushes a device, a virtual coupling ties it to the tissue.

    python examples/press_loop.py runs/constitutive/network.npz [--seconds 5] [--coupling 0.5]

The device is a mass with friction, the coupling a spring between it and the point where the tissue
is held. Sampled once a tick, a spring is stable up to 2 * friction / dt; --coupling is in such
units. Beyond it the loop buzzes unless a passivity controller (Hannaford and Ryu 2002) brakes it;
the tissue itself must never give back more energy than it was given, in either case.
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np

from fem.commands import command_line
from fem.errors import InputError
from fem.online.press import Press

DT = 1e-3  # s, a tick; the device itself moves in PARTS of it
PARTS = 10
MASS, FRICTION = 0.02, 0.2  # kg, N s/m: of the device
HAND = 2000.0  # N/m: the hand's spring to where it wants to be
SCALE = 1000.0  # the device shows so many times the force of the tissue, which is a mN
DEEP, PERIOD = 3.0, 1.0  # mm, s: how deep the hand wants to be, up and down
MOTOR = 3000.0  # mN, the most that the device can show
RADIUS = 2.5  # mm


@dataclass
class Run:
    """What a run saw: arrays by tick, in mm, mN and s; energies in uJ (mN mm)."""

    device: np.ndarray
    tool: np.ndarray
    force: np.ndarray
    elapsed: np.ndarray
    given: float
    taken: float

    @property
    def passive(self) -> float:
        """Net energy that the tissue kept, as a share of what it was given: below 0 it made
        some."""
        return (self.given - self.taken) / max(self.given, 1e-12)


def run(press: Press, seconds: float, coupling: float, controlled: bool = False) -> Run:
    """`seconds` of the loop at `coupling` times the stable spring; controlled: with the passivity
    controller."""
    surface = press.surface
    place = surface.points[surface.points[:, 2].argmax()]
    spring = coupling * 2 * FRICTION / DT  # N/m = mN/mm
    position = speed = tool = before = moved = observed = brake = 0.0
    press.reset()
    kept, energy = [], [0.0, 0.0]
    for tick in range(round(seconds / DT)):
        started = time.perf_counter()
        touch = press(place, max(tool, 0.0), RADIUS, dt=DT)
        spent = time.perf_counter() - started
        reaction = float(np.linalg.norm(touch.force))
        work = (before + reaction) / 2 * moved  # mN mm, since the tick before
        energy[int(work < 0)] += abs(work)
        before = reaction
        # the tool has no mass: it stands where spring and tissue, with its local compliance,
        # balance
        stiff = SCALE / touch.compliance
        moved = (spring * (position - tool) - SCALE * reaction) / (spring + stiff)
        tool += moved
        shown = np.clip(spring * (position - tool), -MOTOR, MOTOR) + brake * speed
        began = position
        for part in range(PARTS):  # the motor holds its force for a tick, hand and friction do not
            t = (tick + part / PARTS) * DT
            wanted = DEEP * 0.5 * (1 - np.cos(2 * np.pi * t / PERIOD))
            # N/m is mN/mm, N s/m is mN s/mm, and mN is kg mm/s2
            pushed = HAND * (wanted - position) - FRICTION * speed - shown
            speed += DT / PARTS * pushed / MASS
            position += DT / PARTS * speed
        observed += shown * (position - began)  # mN mm that the motor has taken from the device
        if controlled:
            # brake away what it has given instead, but never more than stops the device
            brake = min(max(-observed, 0.0) / (speed**2 * DT + 1e-12), MASS / DT)
        kept.append((position, tool, reaction, spent))
    return Run(*np.array(kept).T, *energy)


@command_line
def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("network", help="file of a constitutive network")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--coupling", type=float, nargs="+", default=[0.5, 1.0, 2.0])
    options = parser.parse_args(arguments)
    if not (0 < options.seconds <= 3600 and min(options.coupling) > 0):
        raise InputError("--seconds must be above 0 and at most 3600, --coupling above 0")
    press = Press.open(options.network)
    print("coupling  controller  kept %  largest mm  tick us: p50   p99  above 1 ms")
    for coupling in options.coupling:
        for controlled in (False, True):
            done = run(press, options.seconds, coupling, controlled)
            p50, p99 = 1e6 * np.percentile(done.elapsed, (50, 99))
            print(
                f"{coupling:8g}  {'on' if controlled else 'off':>10}  {100 * done.passive:6.2f}"
                f"  {np.abs(done.device).max():10.3f}  {p50:13.0f} {p99:5.0f}"
                f"  {np.mean(done.elapsed > 1e-3):10.4f}"
            )


if __name__ == "__main__":
    main()
