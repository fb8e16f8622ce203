"""A solver answers where the guard does not vouch for the network."""

import numpy as np
import pytest

from fem.errors import InputError, SolverStopped, Stop
from fem.online.reduced import ReducedStepper
from fem.online.stepper import Stepper
from unet_fem.runtime.fallback import Fallback, packed, unpacked
from unet_fem.steppers import open_stepper

DT = 0.25  # s


class Solver(ReducedStepper):
    """Stands for a full-order solver; it counts its frames, and stops at more than `bears` mN."""

    bears, frames = np.inf, 0

    def step(self, force, dt=None):
        if np.abs(force).max() > self.bears:
            raise SolverStopped.because(Stop.NOT_IN_EQUILIBRIUM, "too much")
        self.frames += 1
        return super().step(force, dt)


@pytest.fixture
def pair(constitutive):
    """(a Fallback, its solver, the forces (4, N, 3) of which the third is flagged)."""
    _, model, files = constitutive
    solver = Solver(model)
    body = open_stepper(files["tflite"], interval=DT, fallback=solver, effort=(0.05, 12))
    body.surrogate.guard.weights[:] = 0
    rng, nodes = np.random.default_rng(0), model.force.ravel()
    forces = np.zeros((4, model.meta["nodes"], 3), "float32")
    forces[:, nodes] = np.array([0.1, 0.2, 2.0, 0.1])[:, None, None] * rng.standard_normal(
        (1, len(nodes), 3)
    )
    body.surrogate.guard.far = 20.0  # mm2
    return body, solver, forces


def alone(pair, kind):
    """The answers of the network, or the solver, by itself."""
    body, solver, forces = pair
    stepper = {"network": body.surrogate, "solver": Solver(solver.model)}[kind]
    found = np.array([stepper.step(force, DT) for force in forces])
    body.reset()
    return found


def test_it_is_the_network_until_a_frame_is_flagged_and_then_the_solver(pair):
    body, solver, forces = pair
    network, wanted = alone(pair, "network"), alone(pair, "solver")
    assert isinstance(body, Fallback) and isinstance(body, Stepper)
    for k, force in enumerate(forces):
        found = body.step(force)
        np.testing.assert_array_equal(found, network[k] if k < 2 else wanted[k])
        assert body.corrected == (k >= 2) and not body.flagged
        assert solver.frames == (0 if k < 2 else k + 1)
    body.reset()
    np.testing.assert_array_equal(body.step(forces[0]), network[0])


@pytest.mark.filterwarnings("error")
def test_where_the_solver_stops_the_network_goes_on_and_is_flagged(pair):
    body, solver, forces = pair
    network, solver.bears = alone(pair, "network"), 3.0
    for k, force in enumerate(forces):
        np.testing.assert_array_equal(body.step(force), network[k])
        assert not body.corrected and body.flagged == (k == 2)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_it_goes_back_to_any_moment(pair, frames):
    body, _, forces = pair
    for force in forces[:frames]:
        body.step(force)
    state = body.state()
    after = [body.step(force) for force in forces[frames:]]
    body.reset()
    body.restore(state)
    for force, wanted in zip(forces[frames:], after, strict=True):
        np.testing.assert_array_equal(body.step(force), wanted)
    with pytest.raises(InputError, match="another stepper"):
        body.restore({})


def test_a_force_is_kept_without_its_zeros():
    force = np.zeros((2, 3, 4, 3), "float32")
    force[1, 2, 0] = 1.5, -2.0, 0.25
    found, dt = unpacked(packed(force, 0.01))
    np.testing.assert_array_equal(found, force)
    assert dt == 0.01 and packed(force, 0.01).size == 2 + 4 + 2 * 3
