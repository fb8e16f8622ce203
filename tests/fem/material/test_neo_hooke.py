"""The neo-Hookean law against closed forms, and the values that it refuses."""

import numpy as np
import pytest

from fem.errors import InputError
from fem.material.base import effective_poisson_ratio, shear_modulus, wave_modulus
from fem.material.neo_hooke import NeoHooke

TISSUE = NeoHooke(mu=400.0, nu=0.42, density=1000.0)


def assert_close(actual, expected, tolerance=1e-10):
    """Largest difference relative to the largest expected stress."""
    assert np.abs(actual - expected).max() <= tolerance * np.abs(expected).max()


def diagonal(*entries):
    """(3, 3, n) deformation gradients with three stretches each."""
    stretches = np.stack(np.broadcast_arrays(*entries))
    return stretches[None] * np.eye(3)[:, :, None]


@pytest.mark.parametrize("case", ["uniaxial", "confined", "shear", "volumetric", "random"])
def test_stress_equals_the_closed_form(case, reference):
    """P = mu F + (K (J - 1) - mu/J) cof F in uniaxial, confined, shear, volumetric and random
    deformation, to 1e-10."""
    ref = reference("ref2_homogeneous_closed_form")
    layout = (1, 2, 0)
    if case == "uniaxial":
        F = diagonal(ref["uni_stretch"], ref["uni_lateral"], ref["uni_lateral"])
        P = ref["uni_P"].transpose(layout)
    elif case == "confined":
        F, P = diagonal(ref["conf_stretch"], 1.0, 1.0), ref["conf_P"].transpose(layout)
    elif case == "shear":
        F, P = np.tile(np.eye(3)[:, :, None], 21), ref["shear_P"].transpose(layout)
        F[0, 1] = ref["shear_gamma"]
    elif case == "volumetric":
        F, P = diagonal(*3 * [ref["vol_stretch"]]), diagonal(*3 * [ref["vol_P"]])
    else:
        F, P = ref["rand_F"].transpose(layout), ref["rand_P"].transpose(layout)
    assert_close(TISSUE.stress(F), P)


def test_small_strain_moduli():
    """mu is the shear modulus, K takes the place of the Lame lambda, and K + 2 mu is the confined
    modulus."""
    e = 1e-7
    P = TISSUE.stress(np.eye(3) + e * np.array([[1, 0.5, 0], [0, 0, 0], [0, 0, 0]]))
    assert P[0, 0] / e == pytest.approx(TISSUE.K + 2 * TISSUE.mu, rel=1e-5)
    assert P[1, 1] / e == pytest.approx(TISSUE.K, rel=1e-5)
    assert P[0, 1] / e == pytest.approx(0.5 * TISSUE.mu, rel=1e-5)
    assert wave_modulus(TISSUE) == pytest.approx(TISSUE.K + 2 * TISSUE.mu, rel=1e-14)
    assert shear_modulus(TISSUE) == TISSUE.mu


def test_moduli_of_the_paper():
    """K = 2 mu (1 + nu) / (3 (1 - 2 nu)) = 2366.7 Pa, waves at 1.78 m/s, and an effective Poisson
    ratio of 0.4277."""
    assert TISSUE.K == pytest.approx(2366.7, abs=0.05)
    assert np.sqrt(wave_modulus(TISSUE) / TISSUE.density) == pytest.approx(1.78, abs=0.005)
    assert effective_poisson_ratio(TISSUE) == pytest.approx(0.4277, abs=5e-5)


def test_effective_poisson_ratio_is_that_of_a_small_uniaxial_test(reference):
    """The lateral contraction of the closed-form uniaxial test tends to 0.4277 at small stretch."""
    ref = reference("ref2_homogeneous_closed_form")
    # 0.95 and 1.05: the mean cancels the quadratic part
    near = np.argsort(np.abs(ref["uni_stretch"] - 1))[1:3]
    ratio = -(ref["uni_lateral"][near] - 1) / (ref["uni_stretch"][near] - 1)
    assert ratio.mean() == pytest.approx(0.4277, abs=2e-3)


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
        ({"prony": ((-0.1, 1.0),)}, r"prony\[0\] = \[-0.1, 1.0\]"),
        ({"prony": ((0.1, 0.0),)}, r"prony\[0\] = \[0.1, 0.0\]"),
        ({"prony": ((0.0, 1.0),)}, "leave the row out"),
        ({"prony": ((0.6, 1.0), (0.4, 2.0))}, "add up to 1"),
        ({"mu": [400.0, -3.0]}, r"mu\[1\] = -3.0"),
    ],
)
def test_impossible_materials_are_refused(change, named):
    """A value outside its range is an InputError that names the value."""
    with pytest.raises(InputError, match=named):
        NeoHooke(**({"mu": 400.0, "nu": 0.42, "density": 1000.0} | change))
