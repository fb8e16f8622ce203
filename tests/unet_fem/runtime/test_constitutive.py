"""The constitutive network in its three forms: Keras, NumPy alone, and a LiteRT graph."""

import numpy as np
import pytest
from ai_edge_litert.interpreter import Interpreter

from fem.errors import InputError
from fem.online.constitutive import ConstitutiveStepper, load_constitutive
from fem.online.creep import Creep, steps_within
from fem.online.reduced import ReducedStepper
from fem.online.retissue import with_tissue
from fem.online.stepper import Stepper
from unet_fem.deployment.conformal import fitted_guard
from unet_fem.deployment.constitutive_graph import export_constitutive
from unet_fem.networks.constitutive import ConstitutiveCell, Rates
from unet_fem.runtime.constitutive import ConstitutiveSurrogate, write_constitutive
from unet_fem.runtime.rates import rates
from unet_fem.steppers import open_stepper

PRONY = ((0.12, 330.0), (0.8, 11.0))
NODES = 30
INTERVALS = (0.25, 0.25, 0.01, 1.0, 0.25)  # s

pytestmark = pytest.mark.filterwarnings("ignore:do not trust")  # random forces


@pytest.fixture(scope="module", params=["mirrored", "one side", "elastic", "tissue by points"])
def network(request, make_network, tmp_path_factory):
    options = {
        "mirrored": {"sides": 2},
        "one side": {"sides": 1},
        "elastic": {"sides": 2, "prony": ()},
        "tissue by points": {"sides": 2, "per_point": True},
    }[request.param]
    return make_network(tmp_path_factory.mktemp("network"), **options)


@pytest.fixture(scope="module")
def mirrored(constitutive):
    return constitutive


def forces(count=5, size=0.3):
    """(count, N, 3) mN that grow."""
    rng = np.random.default_rng(5)
    return (np.linspace(0.2, 1, count) * size)[:, None, None] * rng.standard_normal((NODES, 3))


def pushed(model, size):
    """(N, 3) mN at the loadable nodes alone."""
    force, nodes = np.zeros((NODES, 3)), model.force.ravel()
    force[nodes] = forces(1, size)[0][nodes]
    return force


def coordinates(stepper):
    """(frames, R) of a stepper on the forces."""
    return np.array([(stepper.step(f, dt), stepper.a.copy())[1] for f, dt in frames()])


def frames():
    return list(zip(forces(), INTERVALS, strict=True))


@pytest.mark.parametrize("effort", [(1.0, 1), (1e-9, 2)])
def test_the_graph_the_cell_and_numpy_alone_answer_alike(network, effort):
    cell, model, files = network
    steppers = [
        ConstitutiveStepper.open(files["npz"], effort=effort),
        ConstitutiveSurrogate(files["tflite"], effort=effort),
    ]
    alone, graph = map(coordinates, steppers)
    prony = tuple(map(tuple, model.prony))
    memory, answers = cell.rest(1, len(prony), len(prony)), []
    for force, dt in frames():
        g = steppers[0].fields.encode(force)[1][None].copy()
        rate = Rates(*rates(prony, dt))
        a, memory, _ = cell(g, memory, rate, evaluations=effort[1])
        answers.append(np.asarray(a)[0])
    size = np.abs(alone).max()
    assert size > 0.05
    np.testing.assert_allclose(graph, alone, atol=1e-5 * size)
    np.testing.assert_allclose(answers, alone, atol=1e-5 * size)
    for force, dt in frames():
        u, v = (stepper.step(force, dt) for stepper in steppers)
    np.testing.assert_allclose(u, v, atol=1e-5 * np.abs(u).max())


def test_without_a_learned_step_it_is_one_evaluation_of_the_reduced_solver(mirrored, tmp_path):
    model = mirrored[1]
    cell = ConstitutiveCell.of(model, 4)
    path = tmp_path / "net.tflite"
    learned = cell.learned | {"effort": np.array([1.0, 1.0])}
    write_constitutive(path, export_constitutive(cell, model), model.arrays() | learned)
    found = coordinates(ConstitutiveSurrogate(path))
    wanted = coordinates(ReducedStepper(model, most=1))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_further_evaluations_lead_to_the_equilibrium_of_the_reduced_solver(mirrored):
    _, model, files = mirrored
    wanted = coordinates(ReducedStepper(model, tolerance=1e-6, most=60))
    distances = []
    for most in (1, 2, 8):
        found = coordinates(ConstitutiveSurrogate(files["tflite"], effort=(1e-7, most)))
        distances.append(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))
    assert distances[2] < 1e-4 < distances[1] < distances[0]


def test_one_evaluation_more_where_the_step_was_long(mirrored):
    surrogate = ConstitutiveSurrogate(mirrored[2]["tflite"], 0.25, effort=(0.05, 4))
    quiet, wild = forces(1, 0.01)[0], forces(1, 3.0)[0]
    counts = []
    for force in (quiet, quiet, wild):
        surrogate.step(force)
        counts.append(surrogate.evaluations)
    assert counts[1] == 1 < counts[2] <= 4


def test_accelerated_evaluations_are_those_of_numpy_alone(network):
    _, _, files = network
    effort = (1e-9, 5)
    wanted = coordinates(ConstitutiveStepper.open(files["npz"], effort=effort))
    found = coordinates(ConstitutiveSurrogate(files["tflite"], effort=effort))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_a_long_frame_is_taken_in_steps(mirrored):
    force = forces()[2]
    alone, graph = ConstitutiveStepper.open(mirrored[2]["npz"]), open_stepper(mirrored[2]["tflite"])
    for stepper in (alone, graph):
        stepper.step(0.3 * force, 0.25)
    found, wanted = graph.step(force, 30.0), alone.step(force, 30.0)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
    for stepper in (alone, graph):
        stepper.reset()
    graph.step(0.3 * force, 0.25)
    count = steps_within(PRONY, 30.0)
    for k in range(1, count + 1):
        steps = graph.step((0.3 + 0.7 * k / count) * force, 30.0 / count)
    assert count > 3
    np.testing.assert_allclose(steps, wanted, atol=2e-5 * np.abs(wanted).max())


def guarded(files, *guard, effort=(0.02, 12)):
    """A surrogate with another guard."""
    surrogate = ConstitutiveSurrogate(files["tflite"], 0.25, effort=effort)
    surrogate._learned["guard"] = np.array([guard, guard])
    surrogate._take_tissue()
    return surrogate


def test_a_frame_that_the_guard_doubts_settles_further(mirrored):
    _, model, files = mirrored
    force = pushed(model, 3.0)
    sure, doubting = guarded(files, 0, 0, 0, 0, 1e9), guarded(files, 0.02, 0, 0, 0, 1e9)
    for surrogate in (sure, doubting):
        surrogate.step(force)
    assert 0.004 < sure.guard.features[2] <= 0.02 and doubting.guard.features[2] <= 0.004
    assert doubting.evaluations > sure.evaluations and not doubting.flagged


def test_a_frame_that_does_not_settle_is_flagged(mirrored):
    surrogate = guarded(mirrored[2], 0, 0, 0, 0, 1e9, effort=(1e-9, 2))
    surrogate.step(pushed(mirrored[1], 3.0))
    assert surrogate.guard.reason == "the frame did not settle" and surrogate.bound == 0.05


def test_tissue_moved_farther_than_in_the_data_is_flagged_and_not_forgotten(mirrored):
    surrogate = guarded(mirrored[2], 0, 0, 0, 1e-3, 1e9)
    force = pushed(mirrored[1], 3.0)
    u = surrogate.step(force)
    largest = np.abs(u).max()
    assert surrogate.guard.features[3] == pytest.approx(largest**2, rel=1e-5)
    surrogate.guard.far = 0.9 * largest**2
    assert "farther" in flagged_of(surrogate, force)
    u = surrogate.step(0 * force)
    left = np.abs(u).max()
    assert surrogate.guard.features[3] > 2 * left**2
    after = surrogate.state()
    surrogate.step(0 * force)
    now = surrogate.bound
    surrogate.restore(after)
    surrogate.step(0 * force)
    assert surrogate.bound == now


def test_it_is_a_stepper_that_goes_back_to_any_moment(mirrored):
    surrogate = open_stepper(mirrored[2]["tflite"], interval=0.25)
    assert isinstance(surrogate, ConstitutiveSurrogate) and isinstance(surrogate, Stepper)
    assert isinstance(open_stepper(mirrored[2]["npz"]), ReducedStepper)
    before, after = forces()[:2]
    surrogate.step(before)
    state = surrogate.state()
    first = surrogate.step(after)
    surrogate.step(before, 0.01)
    surrogate.restore(state)
    np.testing.assert_array_equal(surrogate.step(after), first)
    surrogate.reset()
    assert not surrogate.step(0 * after).any()


@pytest.mark.parametrize("bad", ["shape", "NaN", "dt"])
def test_bad_input_is_refused_and_leaves_the_state(mirrored, bad):
    surrogate = ConstitutiveSurrogate(mirrored[2]["tflite"], 0.25)
    force = forces()[0]
    surrogate.step(force)
    state = surrogate.state()
    wrong = {"shape": force[1:], "NaN": force * np.nan, "dt": force}[bad]
    with pytest.raises(InputError):
        surrogate.step(wrong, -1.0 if bad == "dt" else None)
    assert all(np.array_equal(state[name], values) for name, values in surrogate.state().items())


def test_files_of_others_are_refused_by_name(mirrored, tmp_path):
    _, model, files = mirrored
    with pytest.raises(InputError, match="no surrogate"):
        ConstitutiveSurrogate(tmp_path / "none.tflite")
    (tmp_path / "other.tflite").write_bytes(files["tflite"].read_bytes()[:1000])
    with pytest.raises(InputError, match="not a whole"):
        ConstitutiveSurrogate(tmp_path / "other.tflite")
    model.save(tmp_path / "plain.npz")
    with pytest.raises(InputError, match="no network was trained"):
        load_constitutive(tmp_path / "plain.npz")


def test_inputs_and_outputs_go_by_their_names(mirrored):
    interpreter = Interpreter(str(mirrored[2]["tflite"]))
    names = {detail["name"] for detail in interpreter.get_output_details()}
    assert names == {"a", "displacement", "signs", "new_history", "new_slow", "new_correction"}


@pytest.mark.parametrize(
    "change",
    [
        {"mu": 500.0, "K": 2000.0},
        {"prony": ((0.3, 5.0),)},
        {"prony": ()},
        {"K": 4000.0, "prony": ((0.1, 1.0), (0.2, 100.0))},
    ],
)
def test_another_tissue_in_the_graph_is_that_in_numpy(mirrored, change):
    surrogate = ConstitutiveSurrogate(mirrored[2]["tflite"])
    as_it_was = coordinates(surrogate)
    surrogate.set_material(**change)
    model, learned = load_constitutive(mirrored[2]["npz"])
    other, learned = with_tissue(model, learned, **change)
    wanted = coordinates(ConstitutiveStepper(other, learned))
    found = coordinates(surrogate)
    assert np.linalg.norm(wanted - as_it_was) > 1e-2 * np.linalg.norm(wanted)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_a_common_factor_of_the_moduli_is_exact(mirrored):
    surrogate = ConstitutiveSurrogate(mirrored[2]["tflite"], 0.25)
    law, force = surrogate.model.law, forces()[3]
    wanted = surrogate.step(force)
    surrogate.set_material(1.7 * law.mu, 1.7 * law.K)
    found = surrogate.step(1.7 * force)
    np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())


def test_tissue_that_the_graph_cannot_hold_is_refused(mirrored):
    surrogate = ConstitutiveSurrogate(mirrored[2]["tflite"])
    with pytest.raises(InputError, match="room for 2"):
        surrogate.set_material(prony=((0.1, 1.0), (0.1, 2.0), (0.1, 3.0)))
    with pytest.raises(InputError, match="mu = -1.0 must be"):
        surrogate.set_material(mu=-1.0)


def flagged_of(surrogate, force):
    """The reason that a step under `force` is flagged for."""
    surrogate.step(force, 0.25)
    return surrogate.guard.reason


def test_a_force_where_no_contact_pushes_is_flagged_until_the_reset(mirrored):
    _, model, files = mirrored
    surrogate, force = ConstitutiveSurrogate(files["tflite"]), np.zeros((NODES, 3))
    force[np.setdiff1d(np.arange(NODES), model.force)[0]] = 0.1
    assert "no contact" in flagged_of(surrogate, force) and surrogate.bound == np.inf
    state = surrogate.state()
    assert "no contact" in flagged_of(surrogate, 0 * force)
    surrogate.reset()
    assert not flagged_of(surrogate, 0 * force)
    surrogate.restore(state)
    assert surrogate.flagged is False and "no contact" in flagged_of(surrogate, 0 * force)


def test_the_bound_counts_what_the_modes_miss_of_forces_now_and_past(mirrored):
    _, model, files = mirrored
    surrogate = ConstitutiveSurrogate(files["tflite"])
    force = pushed(model, 0.01)
    with pytest.warns(RuntimeWarning, match="none that the data's contacts make"):
        surrogate.step(force, 0.25)
    lost = np.concatenate(
        [b.missing @ f for b, f in zip(model.blocks, surrogate.fields.folded, strict=True)]
    )
    linear = surrogate.a - surrogate.state()["correction"]
    missing = np.linalg.norm(lost) / np.linalg.norm(linear)
    grown = Creep.of(PRONY)(0.25)  # of what is missed, at most, for the force came slowly
    assert 1 <= surrogate.guard.features[1] / missing <= grown
    flagged_of(surrogate, 0 * force)
    assert surrogate.guard.features[1] > 0.1  # it is not forgotten with the force


def test_the_guard_covers_nine_of_ten_frames_like_those_it_was_fitted_to():
    rng = np.random.default_rng(0)

    def draw(count):
        features = np.abs(rng.standard_normal((count, 4))) * [0, 1e-3, 5e-3, 5.0] + [1, 0, 0, 0]
        errors = np.abs(rng.standard_normal(count)) * (features @ [1e-3, 1.0, 0.3, 2e-4])
        return features, errors

    learned = draw(2000)
    *weights, far = fitted_guard(*learned)
    features, errors = draw(2000)
    assert 0.89 < np.mean(errors <= features @ weights) < 0.95  # 0.92
    large = features[:, 3] > np.median(features[:, 3])
    for kind in (large, ~large):
        assert 0.86 < np.mean((errors <= features @ weights)[kind]) < 0.97
    assert min(weights) >= 0 and weights[1] > 0
    assert np.mean(learned[0][:, 3] <= far) == pytest.approx(0.99, abs=1e-3)


def test_float16_weights_answer_alike_and_stand_still_without_a_force(mirrored, tmp_path):
    cell, model, files = mirrored
    learned = load_constitutive(files["npz"])[1]
    path = tmp_path / "half.tflite"
    write_constitutive(path, export_constitutive(cell, model, "float16"), model.arrays() | learned)
    half = ConstitutiveSurrogate(path, 0.25)
    assert not half.step(np.zeros((NODES, 3))).any()
    half.reset()
    wanted = coordinates(ConstitutiveSurrogate(files["tflite"]))
    np.testing.assert_allclose(coordinates(half), wanted, atol=2e-3 * np.abs(wanted).max())
    with pytest.raises(InputError, match="not one of"):
        export_constitutive(cell, model, "int4")


def test_a_tissue_far_from_the_datas_is_flagged(mirrored):
    surrogate = ConstitutiveSurrogate(mirrored[2]["tflite"], 0.25)
    law = surrogate.model.law
    surrogate.set_material(K=2 * law.K)
    surrogate.step(np.zeros((NODES, 3)))
    assert "far from the data's" in surrogate.guard.reason
    surrogate.set_material(K=1.05 * law.K)
    surrogate.step(np.zeros((NODES, 3)))
    assert not surrogate.flagged
