"""Instruments that push on the free surface: smooth circular footprints with a path, a force
history and a direction."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Contact:
    """One instrument during one interaction (m, N, s, Hz; unit direction).

    The centre runs from `start` to `end` while the contact acts. The force climbs to `peak` over
    `ramp`, stays for `hold`, and then goes on as `pattern`: "hold", "release" (down to the share
    `low` over another `ramp`) or "oscillate" (between 1 and the share `low` at `rate`).
    """

    start: np.ndarray
    end: np.ndarray
    direction: np.ndarray
    radius: float
    peak: float
    onset: float
    ramp: float
    hold: float
    pattern: str
    low: float
    rate: float
    duration: float

    def force(self, t):
        """Force vector (3,) in N at time t."""
        rise = smooth_step((t - self.onset) / self.ramp)
        after = t - self.onset - self.ramp - self.hold
        if self.pattern == "release":
            rise *= 1 - (1 - self.low) * smooth_step(after / self.ramp)
        elif self.pattern == "oscillate" and after > 0:
            rise *= 1 - (1 - self.low) * (1 - np.cos(2 * np.pi * self.rate * after)) / 2
        return self.peak * rise * self.direction

    def centre(self, t):
        """Reference position (3,) in m of the footprint's centre at time t."""
        return self.start + smooth_step((t - self.onset) / (self.duration - self.onset)) * (
            self.end - self.start
        )


class Load:
    """Nodal force field of some contacts; call it with the time in s for (3, N) in N."""

    def __init__(self, surface, contacts):
        self.surface, self.contacts = surface, contacts

    def __call__(self, t):
        total = 0.0
        for contact in self.contacts:
            total = total + contact.force(t)[:, None] * self.surface.footprint(
                contact.centre(t), contact.radius
            )
        return total


def smooth_step(x):
    """0 below 0, 1 above 1, 3x^2 - 2x^3 between."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3 - 2 * x)
