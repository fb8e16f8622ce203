"""Orders of accuracy: the solver against a vibrating bar, a manufactured motion, and its own
energy."""

import dataclasses

import numpy as np
import pytest

from fem.material.neo_hooke import NeoHooke
from fem.mesh.shapes import box
from fem.solver.explicit import Solver
from fem.solver.internal_force import ELEMENTS

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)
EDGE = 1e-3  # m


def no_load(mesh):
    return lambda t: np.zeros((3, mesh.n_nodes))


def order(sizes, errors):
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def test_waves_in_a_confined_bar_run_at_the_dilatational_speed():
    """A held bar without lateral strain vibrates at the frequency of sqrt((K + 2 mu) / rho), in
    second order of the cell."""
    length, amplitude = 8 * EDGE, 1e-9
    w = np.pi / (2 * length) * np.sqrt((TISSUE.K + 2 * TISSUE.mu) / TISSUE.density)
    duration, errors, cells = 1.1 * 2 * np.pi / w, [], [4, 8, 16]
    for n in cells:
        mesh = box((1, 1, n), length / n, "bottom")
        solver, mode = Solver(mesh, TISSUE), np.sin(np.pi * mesh.points[:, 2] / (2 * length))
        solver.v[2] = amplitude * w * mode
        steps = int(np.ceil(duration / (0.5 * solver.critical_step)))
        for _ in range(steps):
            solver.advance(duration / steps, no_load(mesh), steps=1)
            solver.u[:2] = solver.v[:2] = 0  # no lateral strain
        errors.append(
            np.abs(solver.u[2] - amplitude * np.sin(w * duration) * mode).max() / amplitude
        )
    assert errors[-1] < 2e-3
    assert order([1 / n for n in cells], errors) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("kind", ELEMENTS)
def test_manufactured_motion_converges_in_second_order(kind, distort):
    """A finite motion with the body force that it needs converges with the square of the cell, on
    warped cells."""
    length, w, amplitude = 8 * EDGE, 60.0, np.array([0.08, -0.05, 0.1]) * 8 * EDGE
    duration, errors, cells = 0.6 * np.pi / w, [], [4, 6, 9]

    def shape(X):
        return np.sin(np.pi * X / length).prod(axis=1)

    def stress(X, g):
        s, c = np.sin(np.pi * X / length), np.cos(np.pi * X / length) * np.pi / length
        gradient = np.stack([c[:, i] * s[:, i - 1] * s[:, i - 2] for i in range(3)], axis=1)
        F = np.eye(3) + g * amplitude[:, None] * gradient[:, None]  # (n, 3, 3)
        return np.moveaxis(TISSUE.stress(np.moveaxis(F, 0, -1)), -1, 0)

    for n in cells:
        cubes = box((n, n, n), length / n)
        X = cubes.points + 0.15 * EDGE * shape(cubes.points)[:, None] * [1, -1, 0.5]
        mesh = dataclasses.replace(
            cubes, points=X, fixed=cubes.fixed | (cubes.points[:, 2] > 0.999 * length)
        )
        solver, d = Solver(mesh, TISSUE, kind), 1e-4 * length

        def body_force(t, X=X, d=d, mass=solver.mass):
            g, acceleration = np.sin(w * t) ** 2, 2 * w * w * np.cos(2 * w * t)
            divergence = sum(
                (stress(X + d * e, g) - stress(X - d * e, g))[..., j] / (2 * d)
                for j, e in enumerate(np.eye(3))
            )
            return (
                mass
                / TISSUE.density
                * (TISSUE.density * acceleration * amplitude[:, None] * shape(X) - divergence.T)
            )

        for _ in range(24):  # short runs, so that the load is sampled every 8 steps
            solver.advance(duration / 24, body_force, steps=8)
        exact = np.sin(w * duration) ** 2 * amplitude[:, None] * shape(X)
        errors.append(np.linalg.norm(solver.u - exact) / np.linalg.norm(exact))
    assert errors[-1] < 0.08
    assert order([1 / n for n in cells], errors) == pytest.approx(2, abs=0.3)


def test_energy_error_is_second_order_in_the_step():
    """The energy of a free nonlinear vibration stays within an error that falls with the square of
    the step."""
    mesh, ratios, errors = box((4, 4, 3), EDGE), [0.6, 0.3, 0.15], []
    x, y, z = mesh.points.T / EDGE
    for ratio in ratios:
        solver, record = Solver(mesh, TISSUE), []
        solver.v[2] = np.where(
            mesh.fixed, 0, 0.15 * np.sin(np.pi * x / 4) * np.sin(np.pi * y / 4) * z / 3
        )

        def observe(step, record=record):
            record.append(step.energies().kinetic + step.energies().strain)

        steps = round(0.02 / (ratio * solver.critical_step))
        solver.advance(0.02, no_load(mesh), [observe], steps)
        errors.append(np.abs(np.array(record) / record[0] - 1).max())
    assert errors[-1] < 5e-3
    assert order(ratios, errors) == pytest.approx(2, abs=0.3)


def test_motion_is_second_order_in_the_step():
    """A sudden force, and a change of the step on the way, leave the displacement second-order
    accurate in the step."""
    mesh, runs = box((3, 3, 2), EDGE), []
    load = np.zeros((3, mesh.n_nodes))
    load[2, ~mesh.fixed & (mesh.points[:, 2] > 1.9 * EDGE)] = -1e-4
    for n in (1, 2, 4, 32):
        solver = Solver(mesh, TISSUE)
        for share in (30, 50):  # the second half takes shorter steps
            solver.advance(0.006, lambda t: load, steps=share * n)
        runs.append(solver.u.copy())
    errors = [np.abs(u - runs[-1]).max() / np.abs(runs[-1]).max() for u in runs[:-1]]
    assert errors[-1] < 3e-3
    assert order([4, 2, 1], errors) == pytest.approx(2, abs=0.3)
