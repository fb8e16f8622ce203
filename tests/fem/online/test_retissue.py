"""Another tissue at run time against models that were made for it."""

import dataclasses

import numpy as np
import pytest

import fem
from fem.errors import InputError
from fem.online.reduced import ReducedStepper
from fem.online.retissue import with_tissue
from fem.reduced.volumetric import volumetric_share


@pytest.fixture(scope="module")
def learned(block, tissue, whole_model):
    """Of a model without a learned step."""
    N = {f"N{b}": np.zeros((len(one.M), 9), "float32") for b, one in enumerate(whole_model.blocks)}
    share = volumetric_share(whole_model, block, tissue)
    return {"gain": np.ones(whole_model.modes, "float32")} | N | share


def answers(model, mesh, size=0.2):
    """(frames, N, 3) mm of a push that is held."""
    force = np.zeros(mesh.points.shape, "float32")
    force[np.flatnonzero(mesh.loaded)[5:9]] = [0.3 * size / 4, 0.1 * size / 4, -size / 4]
    stepper = ReducedStepper(model, 0.5, tolerance=1e-6, most=60)
    return np.array([stepper.step(force) for _ in range(4)])


@pytest.mark.parametrize(
    "change",
    [{"nu": 0.35}, {"nu": 0.45, "mu": 300.0}, {"prony": ((0.3, 2.0),)}, {"prony": ()}],
)
def test_it_is_the_model_that_is_made_for_that_tissue(
    block, tissue, whole_model, reduce_wholly, learned, change
):
    other = dataclasses.replace(tissue, **change)
    model, _ = with_tissue(whole_model, learned, other.mu, other.K, other.prony)
    wanted, found = answers(reduce_wholly(block, other), block), answers(model, block)
    assert np.linalg.norm(found - answers(whole_model, block)) > 1e-2 * np.linalg.norm(wanted)
    np.testing.assert_allclose(found, wanted, atol=2e-4 * np.abs(wanted).max())
    assert model.law.K == pytest.approx(other.K) and model.law.prony == other.prony


def test_a_common_factor_divides_what_a_force_does(block, tissue, whole_model, learned):
    model, _ = with_tissue(whole_model, learned, 2 * tissue.mu, 2 * tissue.K)
    wanted = answers(whole_model, block, 0.2)
    np.testing.assert_allclose(answers(model, block, 0.4), wanted, atol=1e-6 * np.abs(wanted).max())


def test_what_does_not_hold_is_refused(block, tissue, whole_model, learned, reduce_wholly):
    with pytest.raises(InputError, match="does not say"):
        with_tissue(whole_model, {}, K=3000.0)
    for mu, K in ((-1.0, None), (None, np.nan), (400.0, 100.0)):
        with pytest.raises(InputError, match="must be"):
            with_tissue(whole_model, learned, mu, K)
    with pytest.raises(InputError, match="for all of the tissue"):
        with_tissue(whole_model, learned, mu=np.full(8, 400.0))
    with pytest.raises(InputError, match="flows"):
        with_tissue(whole_model, learned, prony=((0.6, 1.0), (0.5, 2.0)))
    ogden = reduce_wholly(block, fem.Ogden(((40.0, 8.0), (-60.0, -4.0)), 0.45, 1000.0))
    with pytest.raises(InputError, match="neo-Hookean"):
        with_tissue(ogden, {}, mu=300.0)
