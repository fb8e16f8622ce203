"""Ranges that the contacts of a scene are drawn from, and the seeded draws."""

from dataclasses import dataclass, replace

import numpy as np

from fem.contact.push import PATTERNS, Contact
from fem.contact.surface import Surface
from fem.ranges import number
from fem.settings import normalised


@dataclass(frozen=True)
class ContactRange:
    """What the contacts of a scene are drawn from: (low, high) pairs, and the number of contacts.

    radius m, force N (peak), travel m (length of the path), ramp s, hold s, onset s, rate Hz; cone:
    largest angle in degrees between the force and the inward normal; low: share of the peak left by
    a release or an oscillation; pull: share of the contacts that pull outwards, as an instrument
    that has gripped the tissue does.
    """

    count: int = number(1, 1000)
    radius: tuple[float, float] = number(1e-6, 1e3, "m", ascending=True)
    force: tuple[float, float] = number(0, 1e4, "N", ascending=True)
    travel: tuple[float, float] = number(0, 1000, "m", ascending=True, default=(0.0, 0.0))
    cone: float = number(0, 89.9, "degrees", default=0.0)
    ramp: tuple[float, float] = number(1e-4, 1e5, "s", ascending=True, default=(0.3, 1.0))
    hold: tuple[float, float] = number(0, 1e5, "s", ascending=True, default=(0.2, 1.5))
    onset: tuple[float, float] = number(0, 1e5, "s", ascending=True, default=(0.0, 1.0))
    low: tuple[float, float] = number(0, 1, ascending=True, default=(0.0, 0.6))
    rate: tuple[float, float] = number(0, 100, "Hz", ascending=True, default=(0.3, 1.0))
    pull: float = number(0, 1, default=0.0)

    def __post_init__(self) -> None:
        normalised(self, "contact")


def draw_contacts(
    surface: Surface,
    ranges: ContactRange,
    duration: float,
    rng: np.random.Generator,
    factor: tuple[float, float] | None = None,
) -> list[Contact]:
    """The contacts of one interaction, a list of Contact drawn with the generator `rng`.

    factor: (low, high) makes a hard interaction: every contact acts from the start, holds long
    enough for all to push together, and peaks at low to high times the largest force in `ranges`.
    """
    return [_draw_contact(surface, ranges, duration, rng, factor) for _ in range(ranges.count)]


def _draw_contact(surface, ranges, duration, rng, factor):
    radius = rng.uniform(*ranges.radius)
    inside = np.flatnonzero(surface.clearance >= min(radius, 0.9 * surface.clearance.max()))
    start = inside[rng.choice(len(inside), p=surface.area[inside] / surface.area[inside].sum())]
    reach = np.linalg.norm(surface.points[inside] - surface.points[start], axis=1)
    length = rng.uniform(*ranges.travel)
    # the end lies near the drawn distance, in a random direction, inside the same part of the
    # surface and on the same side
    behind = surface.normal[inside] @ surface.normal[start] < 0.5
    end = inside[
        np.argmin(
            np.abs(reach - length)
            + rng.uniform(0, 0.1 * ranges.travel[1] + 1e-12, len(reach))
            + np.where(behind, np.inf, 0)
        )
    ]
    peak = rng.uniform(*ranges.force) if factor is None else rng.uniform(*factor) * ranges.force[1]
    onset = rng.uniform(*ranges.onset) if factor is None else 0.0
    hold = rng.uniform(*ranges.hold) if factor is None else ranges.ramp[1]
    contact = Contact(
        start=surface.points[start],
        end=surface.points[end],
        direction=tilt(-surface.normal[start], np.radians(ranges.cone), rng),
        radius=radius,
        peak=peak,
        onset=min(onset, 0.5 * duration),
        ramp=rng.uniform(*ranges.ramp),
        hold=hold,
        pattern=PATTERNS[rng.integers(len(PATTERNS))],
        low=rng.uniform(*ranges.low),
        rate=rng.uniform(*ranges.rate),
        duration=duration,
    )
    if ranges.pull and rng.uniform() < ranges.pull:  # the last draw: without it all are as ever
        return replace(contact, direction=-contact.direction)
    return contact


def tilt(axis: np.ndarray, angle: float, rng: np.random.Generator) -> np.ndarray:
    """A unit vector drawn evenly from the cone of half-angle `angle` about the unit vector
    `axis`."""
    cosine = rng.uniform(np.cos(angle), 1.0)
    azimuth = rng.uniform(0, 2 * np.pi)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    return cosine * axis + np.sqrt(1 - cosine**2) * (
        np.cos(azimuth) * side + np.sin(azimuth) * np.cross(axis, side)
    )
