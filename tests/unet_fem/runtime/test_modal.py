"""The modal network: trained in Keras on whole interactions, stepped in LiteRT frame by frame."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.online.fields import Fields
from fem.online.reduced_model import Block, ReducedModel
from fem.online.stepper import Stepper
from unet_fem.deployment.modal import export_modal, within
from unet_fem.networks.modal import ModalNetwork
from unet_fem.runtime.modal import ModalSurrogate, write_modal
from unet_fem.steppers import open_stepper
from unet_fem.training.modal import Lessons, Recipe, largest_modes, train_modal

GUARD = np.array([0.01, 1.0, 0.0, 0.0, 1e9])
PRONY = ((0.12, 330.0), (0.8, 11.0))
SIZES, NODES, FORCED, FREE = (7, 5), 30, 9, 12

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


def make(folder, **options):
    """(network, surrogate) of random weights."""
    model = random_model(**options)
    model, _ = within(model, np.arange(model.modes))
    network = ModalNetwork(model.modes, 16, 3, remembered=4, scales=(2.0, 0.5))
    rng = np.random.default_rng(4)
    network.set_weights([0.3 * rng.standard_normal(w.shape) for w in network.get_weights()])
    path = folder / "net.tflite"
    write_modal(path, export_modal(network, model), model, GUARD)
    return network, ModalSurrogate(path)


CASES = {"mirrored": {}, "one side": {"sides": 1}, "elastic": {"prony": ()}}


@pytest.fixture(scope="module", params=CASES)
def both(request, tmp_path_factory):
    return make(tmp_path_factory.mktemp("network"), **CASES[request.param])


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory):
    return make(tmp_path_factory.mktemp("network"))[1]


def forces(count=5, size=0.3):
    """(count, N, 3) mN that grow."""
    rng = np.random.default_rng(5)
    return (np.linspace(0.2, 1, count) * size)[:, None, None] * rng.standard_normal((NODES, 3))


def coordinates(stepper, dt):
    stepper.reset()
    return np.array([(stepper.step(f, dt), stepper.a.copy())[1] for f in forces()])


@pytest.mark.parametrize("dt", [0.01, 0.25, 30.0])
def test_keras_on_all_frames_is_the_graph_frame_by_frame(both, dt):
    network, stepper = both
    g = np.array([stepper.fields.encode(f)[1].copy() for f in forces()])[None]
    prony = tuple(map(tuple, stepper.model.prony))
    x, past = Lessons(g, g, np.array([dt])).inputs(prony)
    wanted = np.asarray(network((x, past)))[0] + x[0, :, : g.shape[-1]]
    np.testing.assert_allclose(coordinates(stepper, dt), wanted, atol=1e-5 * np.abs(wanted).max())


def test_the_same_linear_answer_after_another_past_is_another_answer(mirrored):
    """What is remembered of the features tells them apart."""
    force = forces()[-1]
    mirrored.reset()
    mirrored.step(force, 0.25)
    once, state = mirrored.a.copy(), mirrored.state()
    mirrored.reset()
    mirrored.restore(mirrored.state() | {"features": 2 * state["features"]})
    mirrored.step(force, 0.25)
    assert np.abs(mirrored.a - once).max() > 1e-3 * np.abs(once).max()


def test_no_force_moves_nothing_after_any_reset(both):
    _, surrogate = both
    surrogate.step(forces()[0], 0.25)
    surrogate.reset()
    for _ in range(3):
        assert np.abs(surrogate.step(np.zeros((NODES, 3)), 0.25)).max() < 1e-5


def test_the_displacement_is_that_of_the_coordinates(both):
    _, surrogate = both
    u = surrogate.step(forces()[0], 0.25)
    wanted = Fields(surrogate.model).decode(surrogate.a, u.shape)
    np.testing.assert_allclose(u, wanted, atol=1e-5 * np.abs(wanted).max())


def test_it_is_a_stepper_whose_file_goes_back_to_any_moment(mirrored):
    body = open_stepper(mirrored.path, interval=0.25)
    assert isinstance(body, ModalSurrogate) and isinstance(body, Stepper)
    before, after = forces()[:2]
    body.step(before)
    state = body.state()
    first = body.step(after)
    body.step(before, 0.01)
    body.restore(state)
    np.testing.assert_array_equal(body.step(after), first)
    with pytest.raises(InputError, match="another stepper"):
        body.restore(state | {"features": np.zeros((3, 1))})


@pytest.mark.parametrize("bad", ["shape", "NaN", "dt", "no dt"])
def test_bad_input_is_refused_and_leaves_the_state(mirrored, bad):
    force = forces()[0]
    mirrored.step(force, 0.25)
    state = mirrored.state()
    wrong = {"shape": force[1:], "NaN": force * np.nan}.get(bad, force)
    with pytest.raises(InputError):
        mirrored.step(wrong, {"dt": -1.0, "no dt": None}.get(bad, 0.25))
    assert all(np.array_equal(state[name], values) for name, values in mirrored.state().items())


def test_damaged_files_are_refused_by_name(mirrored, tmp_path):
    path, data = tmp_path / "net.tflite", mirrored.path.read_bytes()
    with pytest.raises(InputError, match="no modal network"):
        ModalSurrogate(tmp_path / "none.tflite")
    path.write_bytes(data[:1000])
    with pytest.raises(InputError, match="not a whole"):
        ModalSurrogate(path)
    path.write_bytes(data[:200] + b"0000" + data[204:])
    with pytest.raises(InputError, match="its graph is not"):
        ModalSurrogate(path)
    write_modal(path, data[: data.index(b"PK")], mirrored.model, np.ones(3))
    with pytest.raises(InputError, match="guard must be five"):
        ModalSurrogate(path)


def test_a_force_that_no_contact_makes_is_flagged(mirrored):
    stepper = mirrored
    stepper.reset()
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
