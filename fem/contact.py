"""Instruments that push on the free surface: smooth circular footprints with a path, a force history and a direction."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.spatial

from fem import element
from fem.errors import InputError

PATTERNS = ("hold", "release", "oscillate")


@dataclass(frozen=True)
class Contact:
    """One instrument during one interaction (m, N, s, Hz; unit direction).

    The centre runs from `start` to `end` while the contact acts. The force climbs to `peak` over `ramp`, stays for
    `hold`, and then goes on as `pattern`: "hold", "release" (down to the share `low` over another `ramp`) or
    "oscillate" (between 1 and the share `low` at `rate`).
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
        return self.start + smooth_step((t - self.onset) / (self.duration - self.onset)) * (self.end - self.start)


@dataclass(frozen=True)
class ContactRange:
    """What the contacts of a scene are drawn from: (low, high) pairs, and the number of contacts.

    radius m, force N (peak), travel m (length of the path), ramp s, hold s, onset s, rate Hz; cone: largest angle in
    degrees between the force and the inward normal; low: share of the peak left by a release or an oscillation.
    """

    count: int
    radius: tuple[float, float]
    force: tuple[float, float]
    travel: tuple[float, float] = (0.0, 0.0)
    cone: float = 0.0
    ramp: tuple[float, float] = (0.3, 1.0)
    hold: tuple[float, float] = (0.2, 1.5)
    onset: tuple[float, float] = (0.0, 1.0)
    low: tuple[float, float] = (0.0, 0.6)
    rate: tuple[float, float] = (0.3, 1.0)

    def __post_init__(self):
        if self.count < 1:
            raise InputError(f"contact.count = {self.count} must be at least 1")
        if not 0 <= self.cone < 90:
            raise InputError(f"contact.cone = {self.cone} degrees must be from 0 to below 90")
        for name in ("radius", "force", "travel", "ramp", "hold", "onset", "low", "rate"):
            low, high = getattr(self, name)
            if not (0 <= low <= high < np.inf):
                raise InputError(f"contact.{name} = [{low:g}, {high:g}] must be two numbers from low to high, none negative")
        for name in ("radius", "ramp"):
            if getattr(self, name)[0] <= 0:
                raise InputError(f"contact.{name} starts at {getattr(self, name)[0]:g}; it must be above 0")


class Surface:
    """The free surface of a mesh, with quadrature points that turn a footprint into consistent nodal forces."""

    def __init__(self, mesh):
        faces = mesh.free_faces
        if not len(faces):
            raise InputError("the mesh has no free surface to push on: every boundary node is fixed")
        points = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3)
        shape, gradient = element.quad_shape(points)  # (4, 4), (4, 2, 4)
        corners = mesh.points[faces]  # (M, 4, 3)
        tangents = np.einsum("qra,mai->mqri", gradient, corners)
        normal = np.cross(tangents[..., 0, :], tangents[..., 1, :]).reshape(-1, 3)  # outward, of length dA
        self.area = np.linalg.norm(normal, axis=1)  # (P,)
        self.normal = normal / self.area[:, None]
        self.points = np.einsum("qa,mai->mqi", shape, corners).reshape(-1, 3)  # (P, 3)
        column = np.arange(len(self.area)).reshape(-1, 4, 1)
        row = np.broadcast_to(faces[:, None], (len(faces), 4, 4))
        weight = np.broadcast_to(shape, row.shape)
        entries = (weight.ravel(), (row.ravel(), np.broadcast_to(column, row.shape).ravel()))
        self.spread = scipy.sparse.csr_matrix(entries, (mesh.n_nodes, len(self.area)))
        rim = mesh.points[np.union1d(faces[mesh.fixed[faces]], _edge_nodes(faces))]
        self.clearance = scipy.spatial.cKDTree(rim).query(self.points)[0]  # (P,) m, inf without a rim

    def footprint(self, centre, radius):
        """Share of a unit force that each node takes, (N,): consistent with the pressure (1 - r^2/R^2)^2, sum exactly 1.

        r is measured along the surface's tangent plane under the centre, so that a straight path may cut through a curved
        surface, and never reaches the other side of a thin wall. Raises InputError if the circle holds no point of the surface.
        """
        offset = self.points - centre
        squared = np.einsum("pi,pi->p", offset, offset)
        near = self.normal @ self.normal[squared.argmin()] > -0.5
        mean = self.normal.T @ (near * bump(squared / (2 * radius) ** 2) * self.area)
        normal = mean / max(np.linalg.norm(mean), 1e-300)
        height = offset @ normal
        distance = np.linalg.norm(offset - height[:, None] * normal, axis=1)
        pressure = near * (np.abs(height) < radius) * bump(np.square(distance / radius)) * self.area
        total = pressure.sum()
        if total == 0:
            raise InputError(
                f"a footprint of radius {radius:g} m at {np.array2string(centre, precision=4)} m misses the free surface; widen contact.radius"
            )
        return self.spread @ (pressure / total)


def bump(x):
    """(1 - x)^2 from x = 0 to 1, then 0."""
    return np.square(np.clip(1 - x, 0, None))


def _edge_nodes(faces):
    """The nodes on the edge of the surface that the quadrilaterals `faces` (M, 4) make up."""
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    side, count = np.unique(sides, axis=0, return_counts=True)
    return side[count == 1]


class Load:
    """Nodal force field of some contacts; call it with the time in s for (3, N) in N."""

    def __init__(self, surface, contacts):
        self.surface, self.contacts = surface, contacts

    def __call__(self, t):
        total = 0.0
        for contact in self.contacts:
            total = total + contact.force(t)[:, None] * self.surface.footprint(contact.centre(t), contact.radius)
        return total


def draw_contacts(surface, ranges, duration, rng, factor=None):
    """The contacts of one interaction, a list of Contact drawn with the generator `rng`.

    factor: (low, high) makes a hard interaction: every contact acts from the start, holds long enough for all to push
    together, and peaks at low to high times the largest force in `ranges`.
    """
    return [_draw_contact(surface, ranges, duration, rng, factor) for _ in range(ranges.count)]


def _draw_contact(surface, ranges, duration, rng, factor):
    radius = rng.uniform(*ranges.radius)
    inside = np.flatnonzero(surface.clearance >= min(radius, 0.9 * surface.clearance.max()))
    start = inside[rng.choice(len(inside), p=surface.area[inside] / surface.area[inside].sum())]
    reach = np.linalg.norm(surface.points[inside] - surface.points[start], axis=1)
    length = rng.uniform(*ranges.travel)
    # the end lies near the drawn distance, in a random direction, inside the same part of the surface and on the same side
    behind = surface.normal[inside] @ surface.normal[start] < 0.5
    end = inside[np.argmin(np.abs(reach - length) + rng.uniform(0, 0.1 * ranges.travel[1] + 1e-12, len(reach)) + np.where(behind, np.inf, 0))]
    peak = rng.uniform(*ranges.force) if factor is None else rng.uniform(*factor) * ranges.force[1]
    onset = rng.uniform(*ranges.onset) if factor is None else 0.0
    hold = rng.uniform(*ranges.hold) if factor is None else ranges.ramp[1]
    return Contact(
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


def tilt(axis, angle, rng):
    """A unit vector drawn evenly from the cone of half-angle `angle` about the unit vector `axis`."""
    cosine = rng.uniform(np.cos(angle), 1.0)
    azimuth = rng.uniform(0, 2 * np.pi)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    return cosine * axis + np.sqrt(1 - cosine**2) * (np.cos(azimuth) * side + np.sin(azimuth) * np.cross(axis, side))


def smooth_step(x):
    """0 below 0, 1 above 1, 3x^2 - 2x^3 between."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3 - 2 * x)
