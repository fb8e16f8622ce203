"""Instruments that push on the free surface: smooth circular footprints with a path, a force
history and a direction."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fem.contact.surface import Surface
from fem.errors import InputError
from fem.ranges import check_fields, number
from fem.settings import normalised

PATTERNS = ("hold", "release", "oscillate")


@dataclass(frozen=True, eq=False)
class Contact:
    """One instrument during one interaction (m, N, s, Hz; unit direction).

    The centre runs from `start` to `end` while the contact acts. The force climbs to `peak` over
    `ramp`, stays for `hold`, and then goes on as `pattern`: "hold", "release" (down to the share
    `low` over another `ramp`) or "oscillate" (between 1 and the share `low` at `rate`).
    """

    start: np.ndarray
    end: np.ndarray
    direction: np.ndarray
    radius: float = number(1e-6, 1e3, "m")
    peak: float = number(-1e6, 1e6, "N")
    onset: float = number(-1e6, 1e6, "s", default=0.0)
    ramp: float = number(1e-6, 1e6, "s", default=0.5)
    hold: float = number(0, np.inf, "s", default=np.inf)
    pattern: str = "hold"
    low: float = number(0, 1, default=0.0)
    rate: float = number(0, 100, "Hz", default=1.0)
    duration: float = number(0, np.inf, "s", default=np.inf)

    def __post_init__(self) -> None:
        check_fields(self, "contact")
        for name in ("start", "end", "direction"):
            if np.shape(getattr(self, name)) != (3,):
                raise InputError(
                    f"a contact's {name} has shape {np.shape(getattr(self, name))}; give (x, y, z)"
                )
        length = math.hypot(*self.direction)
        if not abs(length - 1) < 1e-6:
            raise InputError(f"a contact's direction has length {length:g}; give a unit vector")
        if self.pattern not in PATTERNS:
            raise InputError(
                f"a contact's pattern '{self.pattern}' is not one of {', '.join(PATTERNS)}"
            )
        if not self.duration > self.onset:
            raise InputError(
                f"a contact of duration {self.duration} s ends before its onset at {self.onset} s"
            )

    def force(self, t: float) -> np.ndarray:
        """Force vector (3,) in N at time t."""
        rise = smooth_step((t - self.onset) / self.ramp)
        after = t - self.onset - self.ramp - self.hold
        if self.pattern == "release":
            rise *= 1 - (1 - self.low) * smooth_step(after / self.ramp)
        elif self.pattern == "oscillate" and after > 0:
            rise *= 1 - (1 - self.low) * (1 - np.cos(2 * np.pi * self.rate * after)) / 2
        return self.peak * rise * self.direction

    def centre(self, t: float) -> np.ndarray:
        """Reference position (3,) in m of the footprint's centre at time t."""
        return self.start + smooth_step((t - self.onset) / (self.duration - self.onset)) * (
            self.end - self.start
        )


@dataclass(frozen=True)
class Push:
    """A push at one place that rises and is then held: the simplest Contact.

    at: "top" (the highest part of the surface that can be pushed on), "middle" (farthest from its
    rim), "rim" (nearest to it), or a point (x, y, z) in m; force: N, below 0 pulls; radius: of the
    footprint, m; direction: of the force, straight inwards if left out; onset, ramp: s.
    """

    at: str | tuple[float, float, float]
    force: float = number(-1e6, 1e6, "N")
    radius: float = number(1e-6, 1e3, "m")
    direction: tuple[float, float, float] | None = None
    onset: float = number(-1e6, 1e6, "s", default=0.0)
    ramp: float = number(1e-6, 1e6, "s", default=0.5)

    def __post_init__(self) -> None:
        normalised(self, "push")
        if isinstance(self.at, str) and self.at not in ("top", "middle", "rim"):
            raise InputError(f"a push at '{self.at}'; give 'top', 'middle', 'rim' or a point in m")
        if self.direction is not None and not np.linalg.norm(self.direction) > 0:
            raise InputError(f"a push along {self.direction} has no direction; leave it out")

    def on(self, surface: Surface) -> Contact:
        """This push on a surface."""
        near = self._place(surface)
        centre = surface.points[near] if isinstance(self.at, str) else np.array(self.at)
        inwards = -surface.normal[near]
        if self.direction is not None:
            inwards = np.array(self.direction) / np.linalg.norm(self.direction)
        return Contact(centre, centre, inwards, self.radius, self.force, self.onset, self.ramp)

    def _place(self, surface):
        points, clearance = surface.points, surface.clearance
        if self.at == "middle":
            return clearance.argmax()
        if self.at == "rim":
            return clearance.argmin()
        if self.at == "top":
            z = points[:, 2]
            highest = np.flatnonzero(z >= z.max() - 1e-6 * np.ptp(points, axis=0).max())
            return highest[clearance[highest].argmax()]
        return np.square(points - self.at).sum(axis=1).argmin()


class Load:
    """Nodal force field of some contacts; call it with the time in s for (3, N) in N."""

    def __init__(self, surface: Surface, contacts: Iterable[Contact | Push]) -> None:
        self.surface = surface
        self.contacts = [
            contact.on(surface) if isinstance(contact, Push) else contact for contact in contacts
        ]

    def __call__(self, t: float) -> np.ndarray:
        total: Any = 0.0
        for contact in self.contacts:
            total = total + contact.force(t)[:, None] * self.surface.footprint(
                contact.centre(t), contact.radius
            )
        return total


def smooth_step(x: float) -> float:
    """0 below 0, 1 above 1, 3x^2 - 2x^3 between."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3 - 2 * x)
