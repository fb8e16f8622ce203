"""The constitutive law against closed forms, and the values that it refuses."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.material.neo_hooke import Material

TISSUE = Material(mu=400.0, nu=0.42, density=1000.0)
PAPER = ((0.12, 330.0), (0.8, 11.0))


def assert_close(actual, expected, tolerance=1e-10):
    """Largest difference relative to the largest expected stress."""
    assert np.abs(actual - expected).max() <= tolerance * np.abs(expected).max()


def diagonal(*entries):
    """(n, 3, 3) deformation gradients with three stretches each."""
    return np.stack(np.broadcast_arrays(*entries), axis=-1)[..., None] * np.eye(3)


@pytest.mark.parametrize("case", ["uniaxial", "confined", "shear", "volumetric", "random"])
def test_stress_equals_the_closed_form(case, reference):
    """P = mu F + (K (J - 1) - mu/J) cof F in uniaxial, confined, shear, volumetric and random
    deformation, to 1e-10."""
    ref = reference("ref2_homogeneous_closed_form")
    if case == "uniaxial":
        F, P = diagonal(ref["uni_stretch"], ref["uni_lateral"], ref["uni_lateral"]), ref["uni_P"]
    elif case == "confined":
        F, P = diagonal(ref["conf_stretch"], 1.0, 1.0), ref["conf_P"]
    elif case == "shear":
        F, P = np.tile(np.eye(3), (21, 1, 1)), ref["shear_P"]
        F[:, 0, 1] = ref["shear_gamma"]
    elif case == "volumetric":
        F, P = diagonal(*3 * [ref["vol_stretch"]]), ref["vol_P"][:, None, None] * np.eye(3)
    else:
        F, P = ref["rand_F"], ref["rand_P"]
    assert_close(TISSUE.stress(F), P)


def test_stress_is_the_gradient_of_the_energy():
    """P = dW/dF by central differences."""
    F = np.eye(3) + np.random.default_rng(0).normal(scale=0.2, size=(20, 3, 3))
    F = F[np.linalg.det(F) > 0.3]
    P, step = np.empty_like(F), 1e-6
    for i in range(3):
        for j in range(3):
            shift = np.zeros((3, 3))
            shift[i, j] = step
            P[:, i, j] = (TISSUE.energy(F + shift) - TISSUE.energy(F - shift)) / (2 * step)
    assert_close(TISSUE.stress(F), P, 1e-8)


def test_small_strain_moduli():
    """mu is the shear modulus, K takes the place of the Lame lambda, and K + 2 mu is the confined
    modulus."""
    e = 1e-7
    P = TISSUE.stress(np.eye(3) + e * np.array([[1, 0.5, 0], [0, 0, 0], [0, 0, 0]]))
    assert P[0, 0] / e == pytest.approx(TISSUE.K + 2 * TISSUE.mu, rel=1e-5)
    assert P[1, 1] / e == pytest.approx(TISSUE.K, rel=1e-5)
    assert P[0, 1] / e == pytest.approx(0.5 * TISSUE.mu, rel=1e-5)
    assert TISSUE.p_modulus == TISSUE.K + 2 * TISSUE.mu


def test_moduli_of_the_paper():
    """K = 2 mu (1 + nu) / (3 (1 - 2 nu)) = 2366.7 Pa, waves at 1.78 m/s, and an effective Poisson
    ratio of 0.4277."""
    assert TISSUE.K == pytest.approx(2366.7, abs=0.05)
    assert np.sqrt(TISSUE.p_modulus / TISSUE.density) == pytest.approx(1.78, abs=0.005)
    assert TISSUE.K / (2 * (TISSUE.K + TISSUE.mu)) == pytest.approx(0.4277, abs=5e-5)


def test_effective_poisson_ratio_is_that_of_a_small_uniaxial_test(reference):
    """The lateral contraction of the closed-form uniaxial test tends to 0.4277 at small stretch."""
    ref = reference("ref2_homogeneous_closed_form")
    near = np.argsort(np.abs(ref["uni_stretch"] - 1))[
        1:3
    ]  # 0.95 and 1.05: the mean cancels the quadratic part
    ratio = -(ref["uni_lateral"][near] - 1) / (ref["uni_stretch"][near] - 1)
    assert ratio.mean() == pytest.approx(0.4277, abs=2e-3)


def test_energy_is_infinite_where_the_tissue_is_inverted():
    """W is zero at rest, positive elsewhere and infinite for J <= 0."""
    assert TISSUE.energy(np.eye(3)) == 0
    assert TISSUE.energy(np.diag([1.1, 1, 1])) > 0
    assert np.isinf(TISSUE.energy(np.array([np.diag([-1, 1, 1]), np.diag([0, 1, 1])]))).all()


def test_relaxation_function(reference):
    """G(0) = 1, G(t) is that of the reference, G(infinity) = 1 - sum g, and without Prony terms G =
    1."""
    ref = reference("ref3_qlv_one_element")
    material = Material(400.0, 0.42, 1000.0, PAPER)
    assert material.relaxation(0.0) == 1
    assert np.allclose(material.relaxation(ref["t"]), ref["G"], rtol=1e-12)
    assert material.relaxation(1e9) == pytest.approx(0.08, rel=1e-12)
    assert np.array_equal(TISSUE.relaxation([0.0, 1e9]), [1, 1])


@pytest.mark.parametrize(
    "change, named",
    [
        ({"mu": 0.0}, "mu = 0.0"),
        ({"mu": float("nan")}, "mu = nan"),
        ({"nu": -0.1}, "nu = -0.1"),
        ({"nu": 0.5}, "nu = 0.5"),
        ({"nu": 0.7}, "nu = 0.7"),
        ({"density": -1.0}, "density = -1.0"),
        ({"density": float("inf")}, "density = inf"),
        ({"prony": ((-0.1, 1.0),)}, r"\(-0.1, 1.0\)"),
        ({"prony": ((0.1, 0.0),)}, r"\(0.1, 0.0\)"),
        ({"prony": ((0.0, 1.0),)}, "leave the pair out"),
        ({"prony": ((0.6, 1.0), (0.4, 2.0))}, "add up to 1"),
    ],
)
def test_impossible_materials_are_refused(change, named):
    """A value outside its range is an InputError that names the value."""
    with pytest.raises(InputError, match=named):
        Material(**({"mu": 400.0, "nu": 0.42, "density": 1000.0} | change))
