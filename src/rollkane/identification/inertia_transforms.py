"""Coordinates of an inertia: second moments of a density, by a Cholesky factor."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from .transforms import AbstractTransform

# Below this ratio of second moments a body counts as flat: its thickness is 1e-4 of its
# size, and adds 1e-8 to its moments of inertia.
FLAT = 1e-8
# Of an inertia's named entries: moments first
_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
RATIOS = {"ratios": "full", "diagonal ratios": "diagonal"}
FORMS = ("full", "diagonal", "scale", *RATIOS)


class AbstractInertia(AbstractTransform):
    """An inertia ``I = tr(S) 1 - S`` by the second moments S of a density.

    S is positive semidefinite for every z, so that I is positive definite and no
    principal moment exceeds the sum of the others.
    """

    @abc.abstractmethod
    def second_moments(self, z: Float[Array, " k"]) -> Float[Array, "3 3"]:
        """S [kg m^2], of density times products of coordinates."""

    def value(self, z: Float[Array, " k"]) -> Float[Array, "3 3"]:
        """The inertia about the mass centre [kg m^2]."""
        S = self.second_moments(z)
        return jnp.trace(S) * jnp.eye(3, dtype=S.dtype) - S

    def unit(self, shown: np.ndarray) -> float:
        """The largest moment: its coordinates have no unit."""
        return float(shown.max())

    def shown(self, value: Array) -> Array:
        """Moments, then entries off the diagonal."""
        return value[_ROWS, _COLUMNS]

    def changed(self, change: Float[Array, " n"]) -> Float[Array, "3 3"]:
        """The inertia with named entries changed; it stays symmetric."""
        rows, columns = _ROWS[: change.shape[0]], _COLUMNS[: change.shape[0]]
        added = jnp.zeros_like(self.reference).at[rows, columns].set(change)
        mirrored = jnp.where(jnp.eye(3, dtype=bool), 0.0, added.T)
        return self.reference + added + mirrored

    def labels(self) -> tuple[str, ...]:
        """Axes of the entries."""
        return (".xx", ".yy", ".zz", ".xy", ".xz", ".yz")


class FullInertia(AbstractInertia):
    """Six numbers: ``S = L L^T``, L lower triangular with logarithms on its diagonal.

    Off the diagonal, in units of the diagonal's geometric mean of row and column.
    """

    def second_moments(self, z: Float[Array, " 6"]) -> Float[Array, "3 3"]:
        """S [kg m^2]."""
        return _product(z, 3)

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Of the Cholesky factor."""
        return _factor(second_moments_of(value))

    def logarithms(self) -> np.ndarray:
        """Of squares of L's diagonal."""
        return 2.0 * np.eye(6)[:3]


class FlatInertia(AbstractInertia):
    """Three numbers of a body without thickness, in a plane that stays.

    Its largest moment is the sum of the others, where S has no Cholesky factor.

    Attributes:
        reference: Inertia [kg m^2].
        plane: Two unit vectors in the body's plane, shape (3, 2).
    """

    plane: Array

    def second_moments(self, z: Float[Array, " 3"]) -> Float[Array, "3 3"]:
        """S [kg m^2]."""
        return self.plane @ _product(z, 2) @ self.plane.T

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Of the Cholesky factor in the plane."""
        plane = np.asarray(self.plane)
        return _factor(plane.T @ second_moments_of(value) @ plane)

    def logarithms(self) -> np.ndarray:
        """Of squares of L's diagonal."""
        return 2.0 * np.eye(3)[:2]


class DiagonalInertia(AbstractInertia):
    """Principal axes along the body's: a number for each axis that it extends along.

    Attributes:
        reference: Inertia [kg m^2].
        extended: Axes along which it has a thickness: the others' second moments, of
            which no motion tells, stay zero.
    """

    extended: tuple[int, ...] = eqx.field(static=True)

    def second_moments(self, z: Float[Array, " k"]) -> Float[Array, "3 3"]:
        """S [kg m^2]."""
        return jnp.diag(
            jnp.zeros(3, z.dtype).at[np.array(self.extended)].set(jnp.exp(z))
        )

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Logarithms of second moments."""
        return np.log(np.diag(second_moments_of(value))[list(self.extended)])

    def logarithms(self) -> np.ndarray:
        """All."""
        return np.eye(len(self.extended))

    def shown(self, value: Array) -> Array:
        """The moments."""
        return jnp.diag(value)

    def labels(self) -> tuple[str, ...]:
        """Axes of the moments."""
        return (".xx", ".yy", ".zz")


class InertiaRatios(AbstractInertia):
    """An inertia whose trace stays: what motion without known forces can show.

    Attributes:
        reference: Inertia [kg m^2].
        free: Its coordinates, of which one direction multiplies it.
        begin: Those of the value that was given, shape (k,).
        across: Directions across that one, shape (k, k - 1).
    """

    free: AbstractInertia
    begin: Array
    across: Array

    def second_moments(self, z: Float[Array, " k"]) -> Float[Array, "3 3"]:
        """S [kg m^2]."""
        S = self.free.second_moments(self.begin + self.across @ z)
        return S * (0.5 * jnp.trace(self.reference) / jnp.trace(S))

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Without what multiplies it: zero of the value that was given."""
        away = self.free.inverse(value) - np.asarray(self.begin)
        return away @ np.asarray(self.across)

    def logarithms(self) -> np.ndarray:
        """As without the condition."""
        return self.free.logarithms() @ np.asarray(self.across)

    def shown(self, value: Array) -> Array:
        """As without the condition."""
        return self.free.shown(value)

    def labels(self) -> tuple[str, ...]:
        """As without the condition."""
        return self.free.labels()


def second_moments_of(inertia: Any) -> np.ndarray:
    """S of an inertia [kg m^2], shape (3, 3)."""
    inertia = np.asarray(inertia, float)
    return 0.5 * np.trace(inertia) * np.eye(3) - 0.5 * (inertia + inertia.T)


def inertia_transform(field: str, inertia: Array, form: str | None) -> AbstractInertia:
    """The coordinates that an inertia's start allows.

    Args:
        field: Name used in the error.
        inertia: [kg m^2], shape (3, 3).
        form: ``"diagonal"``, or ``"full"`` (also None), or ratios of these.

    Raises:
        FieldError: a diagonal form of an inertia that is not diagonal.
    """
    if form in RATIOS:
        free = inertia_transform(field, inertia, RATIOS[form])
        begin = free.start()
        # the logarithms grow alike where the inertia is multiplied
        _, _, rows = np.linalg.svd(free.logarithms().sum(axis=0, keepdims=True))
        parts = (jnp.asarray(x, inertia.dtype) for x in (begin, rows[1:].T))
        return InertiaRatios(inertia, free, *parts)
    known = np.asarray(inertia, float)
    if form == "diagonal":
        off = known - np.diag(np.diag(known))
        if np.any(np.abs(off) > 1e-12 * np.max(np.abs(known))):
            remedy = "leave form out, or start from principal axes along the body's"
            raise FieldError(field, known, "is not diagonal", remedy)
        along = np.diag(second_moments_of(known))
        _check_possible(field, known, along)
        thick = np.flatnonzero(along > FLAT * np.max(along))
        return DiagonalInertia(inertia, tuple(map(int, thick)))
    moments, axes = np.linalg.eigh(second_moments_of(known))
    _check_possible(field, known, moments)
    if moments[1] <= FLAT * moments[2]:
        remedy = 'keep its ratios: form="scale"'
        raise FieldError(field, known, "is of a body without any width", remedy)
    if moments[0] <= FLAT * moments[2]:
        return FlatInertia(inertia, jnp.asarray(axes[:, 1:], inertia.dtype))
    return FullInertia(inertia)


def _check_possible(field: str, inertia: np.ndarray, moments: np.ndarray) -> None:
    """Refuse second moments below zero."""
    if np.min(moments) < -FLAT * np.max(moments):
        problem = "violates the triangle inequality, which no distribution of mass can"
        remedy = "start from a possible body's inertia"
        raise FieldError(field, inertia, problem, remedy)


def _product(z: Float[Array, " k"], size: int) -> Float[Array, "n n"]:
    """``L L^T`` of logarithms on the diagonal, and ratios below it."""
    diagonal = jnp.exp(z[:size])
    rows, columns = np.tril_indices(size, -1)
    below = z[size:] * jnp.sqrt(diagonal[rows] * diagonal[columns])
    L = jnp.diag(diagonal).at[rows, columns].set(below)
    return L @ L.T


def _factor(S: np.ndarray) -> np.ndarray:
    """The coordinates of :func:`_product`; NaN of what is not positive definite."""
    try:
        L: np.ndarray = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return np.nan * _factor(np.eye(S.shape[0]))
    diagonal = np.diag(L)
    rows, columns = np.tril_indices(S.shape[0], -1)
    below = L[rows, columns] / np.sqrt(diagonal[rows] * diagonal[columns])
    return np.concatenate([np.log(diagonal), below])
