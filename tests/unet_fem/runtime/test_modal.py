"""The modal network: trained in Keras on whole interactions, stepped in NumPy frame by frame."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.reduced_model import Block, ReducedModel
from fem.online.stepper import Stepper
from unet_fem.deployment.modal import within
from unet_fem.networks.modal import ModalNetwork
from unet_fem.runtime.modal import ModalStepper, load_modal, save_modal
from unet_fem.steppers import open_stepper
from unet_fem.training.modal import Lessons, Recipe, largest_modes, train_modal

PRONY = ((0.12, 330.0), (0.8, 11.0))
SIZES, NODES, FORCED, FREE = (7, 5), 30, 9, 12
MIRROR = np.concatenate([np.full(n, s, "float32") for n, s in zip(SIZES, (1, -1), strict=True)])

pytestmark = pytest.mark.filterwarnings("ignore:do not trust")  # random forces


def random_model(sides=2, prony=PRONY):
    rng = np.random.default_rng(3)

    def draw(*shape):
        return (0.3 * rng.standard_normal(shape)).astype("float32")

    blocks = [
        Block(
            A=draw(9, 2),
            M=draw(R, 11),
            encoder=draw(R, 3 * FORCED),
            decoder=draw(3 * FREE, R),
            flexibility=np.eye(R, dtype="float32"),
            missing=draw(3, 3 * FORCED),
        )
        for R in SIZES[:sides]
    ]
    nodes = rng.permutation(NODES)
    law = {"kind": "neo_hooke", "mu": 400.0, "nu": 0.42, "density": 1000.0, "prony": list(prony)}
    return ReducedModel(
        tuple(blocks),
        force=nodes[: sides * FORCED].reshape(sides, -1).astype("int32"),
        free=nodes[: sides * FREE].reshape(sides, -1).astype("int32"),
        prony=np.array(prony, float).reshape(-1, 2),
        axis=0 if sides == 2 else None,
        grid=None,
        meta={"mesh": "m", "material": "t", "law": law, "nodes": NODES, "interval": 0.25},
    )


def random_network(modes):
    network = ModalNetwork(modes, 16, 3, remembered=4, scales=(2.0, 0.5))
    rng = np.random.default_rng(4)
    network.set_weights([0.3 * rng.standard_normal(w.shape) for w in network.get_weights()])
    return network


def make(**options):
    model = random_model(**options)
    network = random_network(model.modes)
    weights = network.weights_of_file() | {"guard": np.array([0.01, 1.0, 0.0, 0.0])}
    return network, ModalStepper(within(model, np.arange(model.modes))[0], weights)


@pytest.fixture(params=["mirrored", "one side", "elastic"])
def both(request):
    options = {"mirrored": {}, "one side": {"sides": 1}, "elastic": {"prony": ()}}[request.param]
    return make(**options)


def forces(count=5, size=0.3):
    """(count, N, 3) mN that grow."""
    rng = np.random.default_rng(5)
    return (np.linspace(0.2, 1, count) * size)[:, None, None] * rng.standard_normal((NODES, 3))


def coordinates(stepper, dt):
    stepper.reset()
    return np.array([(stepper.step(f, dt), stepper.a.copy())[1] for f in forces()])


@pytest.mark.parametrize("dt", [0.01, 0.25, 30.0])
def test_keras_on_all_frames_is_numpy_frame_by_frame(both, dt):
    network, stepper = both
    g = np.array([stepper.fields.encode(f)[1].copy() for f in forces()])[None]
    prony = tuple(map(tuple, stepper.model.prony))
    x, past = Lessons(g, g, np.array([dt])).inputs(prony)
    wanted = np.asarray(network((x, past)))[0] + x[0, :, : g.shape[-1]]
    np.testing.assert_allclose(coordinates(stepper, dt), wanted, atol=1e-5 * np.abs(wanted).max())


def test_two_ways_to_the_same_linear_answer_differ():
    """What is remembered of the features tells them apart."""
    _, stepper = make()
    force = forces()[-1]
    stepper.step(force, 0.25)
    linear, once = stepper.layers.inputs.copy(), stepper.a.copy()
    stepper.layers.inputs[:] = linear
    stepper.layers.past[:] = 2 * stepper.layers.features()  # as after another past
    again = stepper.layers.correction() + linear[: len(once)]
    assert np.abs(again - once).max() > 1e-2 * np.abs(once).max()


def test_no_force_moves_nothing_after_any_reset(both):
    _, stepper = both
    stepper.step(forces()[0], 0.25)
    stepper.reset()
    for _ in range(3):
        assert np.abs(stepper.step(np.zeros((NODES, 3)), 0.25)).max() < 1e-6


def test_it_is_a_stepper_whose_file_goes_back_to_any_moment(tmp_path):
    _, stepper = make()
    save_modal(tmp_path / "net.npz", stepper.model, stepper.weights)
    body = open_stepper(tmp_path / "net.npz", interval=0.25)
    assert isinstance(body, ModalStepper) and isinstance(body, Stepper)
    before, after = forces()[:2]
    np.testing.assert_array_equal(body.step(before), stepper.step(before, 0.25))
    state = body.state()
    first = body.step(after)
    body.step(before, 0.01)
    body.restore(state)
    np.testing.assert_array_equal(body.step(after), first)
    with pytest.raises(InputError, match="another stepper"):
        body.restore(state | {"features_remembered": np.zeros((3, 1))})


@pytest.mark.parametrize("bad", ["shape", "NaN", "dt", "no dt"])
def test_bad_input_is_refused_and_leaves_the_state(bad):
    _, stepper = make()
    force = forces()[0]
    stepper.step(force, 0.25)
    state = stepper.state()
    wrong = {"shape": force[1:], "NaN": force * np.nan}.get(bad, force)
    with pytest.raises(InputError):
        stepper.step(wrong, {"dt": -1.0, "no dt": None}.get(bad, 0.25))
    assert all(np.array_equal(state[name], values) for name, values in stepper.state().items())


def test_damaged_files_are_refused_by_name(tmp_path):
    _, stepper = make()
    model, weights = stepper.model, stepper.weights
    with pytest.raises(InputError, match="no modal network"):
        load_modal(tmp_path / "none.npz")
    model.save(tmp_path / "reduced.npz")
    with pytest.raises(InputError, match="not a whole"):
        load_modal(tmp_path / "reduced.npz")
    cases = {"W1": weights["W1"][:, 1:], "out": weights["out"] * np.nan, "guard": np.ones(3)}
    for name, wrong in cases.items():
        save_modal(tmp_path / "net.npz", model, weights | {name: wrong})
        with pytest.raises(InputError, match=f"net.npz: {name} must be"):
            load_modal(tmp_path / "net.npz")
    save_modal(tmp_path / "net.npz", model, {"guard": weights["guard"]})
    with pytest.raises(InputError, match="does not hold W0"):
        load_modal(tmp_path / "net.npz")


def test_a_force_that_no_contact_makes_is_flagged():
    _, stepper = make()
    force = np.zeros((NODES, 3))
    force[np.setdiff1d(np.arange(NODES), stepper.model.force)[0]] = 0.1
    stepper.step(force, 0.25)
    assert stepper.flagged and stepper.bound == np.inf
    stepper.reset()
    force = np.zeros((NODES, 3))
    force[stepper.model.force[0]] = 0.1
    stepper.step(force, 0.25)
    assert stepper.flagged and "none that the data's contacts make" in stepper.guard.reason


def test_fewer_modes_are_those_with_the_most_of_the_displacement():
    a = np.ones((2, 3, 12), "float32") * np.arange(12)[::-1]
    kept = largest_modes(Lessons(a, a, np.ones(2)), 4)
    assert kept.tolist() == [0, 1, 2, 3]
    model = random_model()
    part, parity = within(model, np.array([0, 2, 8]))
    assert parity.tolist() == [1, 1, -1] and part.points == 0
    np.testing.assert_array_equal(part.blocks[1].encoder, model.blocks[1].encoder[[1]])
    np.testing.assert_array_equal(part.blocks[0].decoder, model.blocks[0].decoder[:, [0, 2]])


def test_training_learns_a_correction_that_only_the_past_of_a_square_explains():
    """a = l + e, e the Prony filter of l_0^2: neither l nor g at the moment have it."""
    rng, prony = np.random.default_rng(0), ((0.8, 1.0),)
    g = np.cumsum(0.3 * rng.standard_normal((300, 8, 3)), axis=1).astype("float32")
    lessons = Lessons(g, np.zeros_like(g), np.full(len(g), 0.25))
    x, past = lessons.inputs(prony)
    remembered = past @ x[..., :1] ** 2 - x[..., :1] ** 2
    lessons = Lessons(g, x[..., :3] + remembered, lessons.interval)
    parity = np.ones(3, "float32")
    recipe = Recipe(epochs=25, learning_rate=1e-2)
    network = train_modal(lessons, prony, parity, recipe, 0, width=24, layers=2, remembered=3)
    wrong = np.asarray(network((x, past))) - remembered
    assert np.linalg.norm(wrong) < 0.15 * np.linalg.norm(remembered * np.ones(3))
