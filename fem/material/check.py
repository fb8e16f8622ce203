"""Whether a law of a user's own is one: energy, stress and tangent that fit together."""

from collections.abc import Callable

import numpy as np

from fem.errors import InputError
from fem.material.base import STEP, Hyperelastic, check_density, check_prony, wave_modulus

CONSISTENT = 1e-5  # of the largest stress, by which a law's stress may miss its energy's slope
AT_REST = 1e-8  # of the wave modulus, that a law's stress and energy may be at rest
SAMPLED = 16  # cells of which a law with one value a cell is checked


def check_law(material: Hyperelastic, n_cells: int) -> None:
    """Raise InputError unless the law is fit for a mesh of `n_cells` cells, and say what is wrong.

    At rest stress and energy vanish (to 1e-8 of the wave modulus). At random states near rest the
    stress is the slope of the energy, the tangent that of the stress (central differences, to 1e-5
    of the largest), and P F^T is symmetric: the energy does not change with a rotation.
    """
    name = type(material).__name__
    if not isinstance(material, Hyperelastic):
        raise InputError(f"material {name} must derive from fem.material.Hyperelastic")
    if not hasattr(material, "density"):
        raise InputError(f"material {name} has no density in kg/m3; give it one")
    check_density(np.asarray(material.density))
    check_prony(material.prony)
    law = material.of_cells(np.unique(np.linspace(0, n_cells - 1, SAMPLED).astype(int)), n_cells)
    n = min(n_cells, SAMPLED)
    rest = np.tile(np.eye(3)[:, :, None, None], (1, 1, 1, n))
    F = np.eye(3)[:, :, None, None] + np.random.default_rng(0).normal(0, 0.1, (3, 3, 5, n))
    for method, shape in (("energy", (5, n)), ("stress", F.shape), ("tangent", (3, 3, *F.shape))):
        _check_layout(law, method, F, shape)
    modulus = np.asarray(wave_modulus(law))
    if not (np.isfinite(modulus).all() and (modulus > 0).all()):
        raise InputError(
            f"material {name}: dP_11/dF_11 at rest is {modulus.min():.3g} Pa; it must be positive"
        )
    for method in ("stress", "energy"):
        left = np.abs(getattr(law, method)(rest) / modulus).max()
        if not left <= AT_REST:
            raise InputError(
                f"material {name}: {method} must vanish at rest (F = I); it is {left:.2g} times"
                " the wave modulus"
            )
    P, A = np.array(law.stress(F)), law.tangent(F)
    _check_equal(name, "stress is not the derivative of energy", P, slope(law.energy, F))
    _check_equal(name, "tangent is not the derivative of stress", A, Hyperelastic.tangent(law, F))
    moment = np.einsum("ijqe,kjqe->ikqe", P, F)
    _check_equal(name, "energy changes with a rotation", moment, moment.swapaxes(0, 1))


def slope(energy: Callable[[np.ndarray], np.ndarray], F: np.ndarray) -> np.ndarray:
    """dW/dF (3, 3, ...) of a function W(F), by central differences."""
    out = np.empty(F.shape)
    for i, j in np.ndindex(3, 3):
        shift = np.zeros(F.shape)
        shift[i, j] = STEP
        out[i, j] = (np.array(energy(F + shift)) - energy(F - shift)) / (2 * STEP)
    return out


def _check_layout(law, method, F, shape):
    name = type(law).__name__
    try:
        result = np.shape(getattr(law, method)(F))
    except NotImplementedError:
        raise InputError(f"material {name} has no {method}(F); give it one") from None
    except (ValueError, IndexError, TypeError) as error:
        raise InputError(
            f"material {name}: {method}(F) fails for F of shape {F.shape}: {error}"
        ) from None
    if result != shape:
        raise InputError(
            f"material {name}: {method}(F) has shape {result} for F of shape {F.shape}; it must be"
            f" {shape}"
        )


def _check_equal(name, what, actual, expected):
    size, error = np.abs(expected).max(), np.abs(actual - expected).max()
    if not error <= CONSISTENT * size:
        raise InputError(
            f"material {name}: {what}; at random states they differ by up to {error:.3g} Pa where"
            f" {size:.3g} Pa is the largest; give both of one law"
        )
