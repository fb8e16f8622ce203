"""What a constitutive law is, and what follows from it.

A law of a user's own is a class that derives from Hyperelastic and gives `energy` and `stress`:

    class Gent(Hyperelastic):
        def energy(self, F): ...
        def stress(self, F, out=None): ...

Everything else is derived: the tangent by differences, the moduli at rest from the tangent. Where
a class gives a new stress or energy, what it would inherit from another law is derived again too.
"""

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fem.errors import InputError
from fem.ranges import Range, check_fields, shown

if TYPE_CHECKING:
    import scipy.sparse

# ranges of parameters, see fem.ranges
MODULUS, TERM = (1e-3, 1e13, "Pa"), (-1e13, 1e13, "Pa")
NU, DENSITY = (0, 0.5), (1e-6, 1e9, "kg/m3")
PRONY = Range(1e-300, 1), Range(1e-9, 1e12, "s")
STEP = 6e-6  # of a central difference: the cube root of float64's rounding


class Hyperelastic:
    """A law with a stored energy W(F), in the layout of the solver's kernel.

        W(F),   P = dW/dF,   A = dP/dF

    F (3, 3, ...) deformation gradients, such as (3, 3, Q, E) for Q points in E cells; W (...) in
    J/m3; P (3, 3, ...) and A (3, 3, 3, 3, ...) in Pa, A[i, J, k, L] = dP_iJ / dF_kL. `out`, if
    given, is filled and returned. Parameters are scalars or one value a cell, (E,).

    density: kg/m3, one value or one a cell; prony: ((g, tau s), ...), empty for elastic:

        S(t) = int G(t - s) dS_e(s),   G(t) = 1 - sum g_k + sum g_k exp(-t / tau_k),   S_e = F^-1 P

    A law with a term K/2 (J - 1)^2 in W names its modulus `K`, Pa: the element "mean_dilatation"
    needs it, see `volumetric_modulus`.
    """

    density: float | np.ndarray
    K: Any
    prony: tuple[tuple[float, float], ...] = ()

    def __init_subclass__(cls, **options):
        """A class with a stress or energy of its own does not inherit what belongs to another's."""
        super().__init_subclass__(**options)
        own = vars(cls).keys() | vars(cls).get("__annotations__", {}).keys()
        if own & {"stress", "energy"}:
            for name in {"tangent", "scaled"} - own:
                setattr(cls, name, vars(Hyperelastic)[name])

    def energy(self, F: np.ndarray) -> np.ndarray:
        """W in J/m3 for F (3, 3, ...); inf where J <= 0."""
        raise NotImplementedError

    def stress(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """P in Pa for F (3, 3, ...)."""
        raise NotImplementedError

    def tangent(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """dP/dF in Pa for F (3, 3, ...), by central differences of the stress."""
        F = np.array(F, float)
        A: Any = out
        for k, L in np.ndindex(3, 3):
            middle = F[k, L].copy()
            F[k, L] = middle + STEP
            ahead = np.array(self.stress(F))
            F[k, L] = middle - STEP
            column = (ahead - self.stress(F)) / (2 * STEP)
            F[k, L] = middle
            A = np.empty((3, 3, 3, 3, *column.shape[2:])) if A is None else A
            A[:, :, k, L] = column
        return A

    def elastic(self) -> "Hyperelastic":
        """The same law without Prony terms."""
        twin = copy.copy(self)
        object.__setattr__(twin, "prony", ())
        return twin

    def scaled(self, factor: float) -> "Hyperelastic":
        """The law whose energy and stresses are `factor` times these."""
        return Scaled(self, factor)

    def of_cells(self, cells: slice | np.ndarray, n_cells: int) -> "Hyperelastic":
        """The law of some of a mesh's `n_cells` cells: parameters with one value a cell are cut.

        Raises InputError for a parameter with another number of values.
        """
        return _changed(self, lambda values: values[cells], n_cells)

    def averaged(self, weights: "scipy.sparse.csr_matrix") -> "Hyperelastic":
        """The law of cells whose parameters are means over those of others: weights (M, E), with
        rows that add up to 1."""
        return _changed(self, lambda values: weights @ values, weights.shape[1])

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and _key(self) == _key(other)

    def __hash__(self) -> int:
        return hash(_key(self))


class Scaled(Hyperelastic):
    """`factor` times the energy and stresses of `law`, for a law whose parameters are not known."""

    def __init__(self, law: Hyperelastic, factor: float) -> None:
        self.law, self.factor = law, factor
        self.density, self.prony = law.density, law.prony
        K = volumetric_modulus(law)
        self.K = None if K is None else factor * K
        if hasattr(law, "nu"):
            self.nu = law.nu

    def energy(self, F: np.ndarray) -> np.ndarray:
        return self.factor * self.law.energy(F)

    def stress(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        return np.multiply(self.factor, self.law.stress(F), out=out)

    def tangent(self, F: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        return np.multiply(self.factor, self.law.tangent(F), out=out)


def _changed(law, change, n_cells):
    """`law` with `change(values)` for each parameter that has one value a cell."""
    twin = copy.copy(law)
    for name, value in vars(law).items():
        object.__setattr__(twin, name, _change(value, change, n_cells, name))
    return twin


def _change(value, change, n_cells, name):
    """`change(value)` if it is one value a cell, or of what it holds."""
    if isinstance(value, Hyperelastic):
        return _changed(value, change, n_cells)
    if isinstance(value, tuple):
        return tuple(_change(item, change, n_cells, name) for item in value)
    if not isinstance(value, np.ndarray) or value.ndim == 0:
        return value
    if value.shape != (n_cells,):
        raise InputError(
            f"material.{name} has shape {value.shape}; give one value, or one for each of the"
            f" {n_cells} cells"
        )
    return change(value)


def _key(value):
    """What makes two laws equal, arrays included."""
    if isinstance(value, Hyperelastic):
        return type(value), tuple((name, _key(item)) for name, item in vars(value).items())
    if isinstance(value, tuple):
        return tuple(map(_key, value))
    return (value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def _at_rest(material: Hyperelastic) -> np.ndarray:
    """The tangent at rest, (3, 3, 3, 3) or (3, 3, 3, 3, E)."""
    A = material.tangent(np.eye(3)[:, :, None, None])[..., 0, :]
    return A[..., 0] if A.shape[-1] == 1 else A


def _plain(value):
    return float(value) if np.ndim(value) == 0 else value


def wave_modulus(material: Hyperelastic) -> float | np.ndarray:
    """dP_11/dF_11 at rest in Pa: dilatational waves run at its root over the density; one value or
    one a cell."""
    return _plain(_at_rest(material)[0, 0, 0, 0])


def shear_modulus(material: Hyperelastic) -> float | np.ndarray:
    """dP_12/dF_12 at rest in Pa; one value or one a cell."""
    return _plain(_at_rest(material)[0, 1, 0, 1])


def effective_poisson_ratio(material: Hyperelastic) -> float | np.ndarray:
    """The Poisson ratio of small strains: L / (2 (L + mu)), L = dP_11/dF_22 and mu = dP_12/dF_12 at
    rest."""
    A = _at_rest(material)
    lame = A[0, 0, 1, 1]
    return _plain(lame / (2 * (lame + A[0, 1, 0, 1])))


def poisson_ratio(material: Hyperelastic) -> float | np.ndarray:
    """The parameter `nu` if the law has one, else its effective Poisson ratio at rest."""
    return material.nu if hasattr(material, "nu") else effective_poisson_ratio(material)


def volumetric_modulus(material: Hyperelastic) -> float | np.ndarray | None:
    """K of the term K/2 (J - 1)^2 in the law's energy; None if it names none, or inherits the K of
    another energy than its own."""
    if "K" in vars(material):
        return material.K
    for cls in type(material).__mro__:
        if "K" in vars(cls):
            return material.K
        if "energy" in vars(cls):
            return None
    return None


def bulk_modulus(mu: float | np.ndarray, nu: float | np.ndarray) -> float | np.ndarray:
    """K = 2 mu (1 + nu) / (3 (1 - 2 nu)) in Pa."""
    return 2 * mu * (1 + nu) / (3 * (1 - 2 * nu))


def acoustic_stiffness(tangent: np.ndarray) -> np.ndarray:
    """The largest ||A[:, J, :, J]|| over the axes J, (...) in Pa: what sets the stable step."""
    squares = [np.square(tangent[:, J, :, J]).sum(axis=(0, 1)) for J in range(3)]
    return np.sqrt(np.maximum.reduce(squares))


def parameter(value: float | Sequence[float] | np.ndarray) -> float | np.ndarray:
    """A parameter as one float, or as an array of one a cell. Raises InputError for what is
    neither."""
    try:
        array = np.array(value, float)
    except (ValueError, TypeError):
        array = np.empty((0, 0))
    if array.ndim > 1:
        raise InputError(
            f"material parameter {shown(value)} must be a number, or one number a cell"
        )
    return array if array.ndim else float(array)


def require(name: str, value: float | np.ndarray, holds: bool | np.ndarray, message: str) -> None:
    """Raise InputError "material.<name> = <value> <message>" unless `holds`, for every cell."""
    if not np.all(holds):
        wrong = np.ravel(value)[~np.ravel(holds)][0]
        raise InputError(f"material.{name} = {wrong} {message}")


def check_parameters(law: Any, *names: str) -> None:
    """Store the parameters `names`, nu, density and prony of a frozen dataclass as floats, arrays
    of one a cell and tuples; raise InputError for values that no tissue has."""
    for name in (*names, "nu", "density"):
        object.__setattr__(law, name, parameter(getattr(law, name)))
    object.__setattr__(law, "prony", pairs("prony", law.prony))
    check_fields(law, "material")
    require(
        "nu",
        law.nu,
        (0 <= law.nu) & (law.nu < 0.5),
        "must be at least 0 and below 0.5; for nearly incompressible tissue take 0.499",
    )
    check_density(law.density)
    check_prony(law.prony)


def pairs(name: str, value: Any) -> tuple[tuple[Any, float], ...]:
    """`value` as pairs of a parameter and a number. Raises InputError for anything else."""
    try:
        return tuple((parameter(first), float(second)) for first, second in value)
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"material.{name} = {shown(value)} must be a list of pairs of numbers"
        ) from None


def check_density(density: float | np.ndarray) -> None:
    """Raise InputError unless the density is positive."""
    require(
        "density",
        density,
        (0 < density) & (density < np.inf),
        "kg/m3 must be positive; water has 1000",
    )


def check_prony(prony: tuple[tuple[float, float], ...]) -> None:
    """Raise InputError unless all (g, tau) are positive and the g add up to less than 1."""
    for g, tau in prony:
        if not (0 < g < np.inf and 0 < tau < np.inf):
            raise InputError(
                f"material.prony has (g, tau) = ({g}, {tau}); both must be positive (leave the pair"
                " out to switch it off)"
            )
    if sum(g for g, _ in prony) >= 1:
        raise InputError(
            f"material.prony weights add up to {sum(g for g, _ in prony):g}; below 1 the tissue"
            " stays a solid"
        )
