"""From a dataset to a reduced model: the points, the fit, and the command."""

import numpy as np
import pytest

import fem
from fem.errors import InputError
from fem.online.indicator import ErrorIndicator
from fem.online.reduced import ReducedStepper
from fem.reduce import main
from fem.reduced.build import Choice, held_out, learned
from fem.reduced.build import reduce as reduce_dataset
from fem.reduced.cubature import choose
from fem.reduced.fit import Normal
from fem.reduced.judge import judge
from fem.reduced.reduction import Body
from fem.solver.quasistatic import QuasiStatic


def test_points_are_found_that_alone_make_up_the_sum():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(80, 300)).astype("float32")
    weights = np.zeros(300)
    weights[[5, 50, 120, 200]] = 1.0, 2.0, 0.5, 3.0
    which, found, residual = choose(columns, columns @ weights, 16)
    assert residual < 1e-5 and (found > 0).all()
    strong = {int(j): w for j, w in zip(which, found, strict=True) if w > 1e-3}
    assert strong == pytest.approx({5: 1.0, 50: 2.0, 120: 0.5, 200: 3.0}, rel=1e-4)


def test_weights_stay_positive_where_the_best_sum_has_negative_ones():
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(40, 30)).astype("float32")
    target = columns @ rng.normal(size=30)
    _, weights, residual = choose(columns, target, 30)
    scipy_nnls = pytest.importorskip("scipy.optimize").nnls(columns, target)[1]
    assert (weights > 0).all()
    assert residual * np.linalg.norm(target) == pytest.approx(scipy_nnls, rel=0.05)


def test_the_fit_goes_from_the_data_to_the_start_as_the_ridge_grows():
    rng = np.random.default_rng(2)
    z, M = rng.normal(size=(200, 8)), rng.normal(size=(3, 8))
    start = rng.normal(size=(3, 8))
    normal = Normal(8, 3)
    normal.add(z, z @ M.T)
    assert np.allclose(normal.solve(start, 6, 1e-6), M, atol=1e-4)
    assert np.allclose(normal.solve(start, 6, 1e9), start, atol=1e-4)


@pytest.fixture(scope="module")
def built(tiny_dataset, tmp_path_factory):
    """The tiny dataset and a model of it."""
    import os

    folder = tmp_path_factory.mktemp("cache")
    before = os.environ.get("UNET_FEM_CACHE")
    os.environ["UNET_FEM_CACHE"] = str(folder)
    try:
        dataset = fem.open_dataset(tiny_dataset)
        yield dataset, *reduce_dataset(dataset, Choice(modes=8, inputs=6, points=40))
    finally:
        os.environ.pop("UNET_FEM_CACHE")
        if before:
            os.environ["UNET_FEM_CACHE"] = before


def test_a_model_of_two_interactions_answers_them(built):
    dataset, model, verdicts = built
    assert model.modes == 8 and model.points <= 40 and verdicts.keys() == {"usual"}
    own = judge(ReducedStepper(model), dataset, learned(dataset, 0))
    assert own.error < 0.05
    model.check(dataset.mesh_digest)


def test_other_frames_are_judged_by_quasi_static_runs(built):
    dataset, model, _ = built
    verdict = judge(ReducedStepper(model), dataset, [("train", 1)], interval=0.1)
    assert 0 < verdict.error < 0.1


def test_the_error_of_a_force_that_no_mode_has_seen_is_estimated(built):
    dataset, model, _ = built
    mesh, stepper, indicator = dataset.fem_mesh, ReducedStepper(model), ErrorIndicator(model)
    seen = dataset.sequence("train", 1)
    for force in seen.force[1:]:
        indicator(force, stepper.step(force, 0.2), 0.2)
    usual = indicator.missing
    force = np.zeros((mesh.n_nodes, 3), "float32")
    pushed = np.unique(model.force)
    force[pushed, 2] = 1e-2 * (-1.0) ** np.arange(len(pushed))
    solver = QuasiStatic(mesh, dataset.material)
    solver.advance(0.01, lambda t: 1e-3 * force.T.astype(float))
    for one in (stepper, indicator):
        one.reset()
    answer = stepper.step(force, 0.01)
    estimate = indicator(force, answer, 0.01)
    error = np.linalg.norm(answer - 1e3 * solver.u.T)
    assert usual < 0.3 < 1 < indicator.missing and not indicator.carried
    assert estimate == pytest.approx(error, rel=0.1)


def test_of_forces_elsewhere_nothing_is_known(built):
    dataset, model, _ = built
    mesh, indicator = dataset.fem_mesh, ErrorIndicator(model)
    force = np.zeros((mesh.n_nodes, 3), "float32")
    force[np.setdiff1d(np.flatnonzero(~mesh.fixed), model.force)[0], 2] = -0.1
    assert indicator(force, np.zeros_like(force), 0.2) == np.inf
    assert indicator.missing == np.inf and not indicator.carried


def test_what_is_learned_from_is_not_judged_by(tiny_dataset):
    dataset = fem.open_dataset(tiny_dataset)
    assert learned(dataset, 0) == [("train", 1), ("train", 2)]
    assert held_out(dataset, 0) == {"usual": [("validation", 1)]}
    with pytest.raises(InputError, match="hard = 1, and"):
        learned(dataset, 1)


@pytest.mark.parametrize(
    "choice, words",
    [({"modes": 0}, "modes = 0"), ({"inputs": 400}, "inputs = 400"), ({"hard": -1}, "hard = -1")],
)
def test_choices_that_mean_nothing_are_refused(choice, words):
    with pytest.raises(InputError, match=words):
        Choice(**choice)


def test_a_law_that_no_file_can_name_is_refused(block):
    class Clay(fem.NeoHooke):
        pass

    with pytest.raises(InputError, match="Clay"):
        Body(block, Clay(400.0, 0.42, 1000.0))


def test_the_command_writes_a_file_and_says_how_good_it_is(
    tiny_dataset, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("UNET_FEM_CACHE", str(tmp_path))
    out = tmp_path / "model.npz"
    words = [str(tiny_dataset), "--out", str(out), "--modes", "8", "--inputs", "6"]
    main([*words, "--points", "40"])
    said = capsys.readouterr().out
    assert "judged by" in said and "usual" in said and "8 modes, 40 points" in said
    ReducedStepper.open(out).step(np.zeros((5, 5, 3, 3)), 0.2)
    with pytest.raises(SystemExit):
        main(words)
    assert "exists already" in capsys.readouterr().err
    main([str(tiny_dataset), "--judge", str(out)])
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 2 and said[1].startswith("hard")  # its only test is
