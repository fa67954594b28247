"""Coordinates of a parameter in which every step leads to a possible body.

A parameter is ``value(z)`` for unconstrained numbers ``z``: positive ones by their
logarithm, inertias by the second moments of a density, quaternions by small rotations.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.rotations import multiply

# A value is at its coordinates where these give it to this share of its size: far above
# the rounding of any of the maps, far below what anyone would measure.
_SAME = 1e-9


class AbstractTransform(eqx.Module):
    """A parameter by unconstrained coordinates.

    Attributes:
        reference: The value that was given.
    """

    reference: Array

    @abc.abstractmethod
    def value(self, z: Float[Array, " k"]) -> Array:
        """The parameter at coordinates z, in its own shape."""

    @abc.abstractmethod
    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Coordinates z of ``value(z)``, shape (k,); anything for other values."""

    def start(self) -> np.ndarray:
        """Coordinates of the value that was given, shape (k,)."""
        return self.inverse(np.asarray(self.reference, float))

    def coordinates(self, value: np.ndarray) -> np.ndarray:
        """Coordinates of a value, in its shape [its unit], shape (k,).

        NaN where it has none: a negative length, an inertia of no body.
        """
        with np.errstate(all="ignore"):
            z = self.inverse(value)
            back = self.value(jnp.asarray(z))
            share = max(_SAME, 64.0 * float(np.finfo(np.dtype(back.dtype)).eps))
            away: np.ndarray = np.abs(np.asarray(back) - value)
            size = float(np.max(np.abs(value), initial=0.0))
        same = np.isfinite(z).all() and np.all(away <= share * size)
        return z if same else np.full_like(z, np.nan)

    def scale(self) -> np.ndarray:
        """Size of each coordinate, for what is said relative to it, shape (k,)."""
        return np.ones_like(self.start())

    def logarithms(self) -> np.ndarray:
        """What gives the logarithms of sizes from the coordinates, shape (n, k)."""
        return np.zeros((0, self.start().size))

    def unit(self, shown: np.ndarray) -> float:
        """What changes of the named numbers are told relative to [their unit].

        The largest of them, or the size of the coordinates: of numbers that may be zero
        next to nothing is left but noise.
        """
        return max(float(np.abs(shown).max()), float(self.scale().max()))

    def shown(self, value: Array) -> Array:
        """Independent numbers of a value, which names of a covariance stand for."""
        return jnp.ravel(value)

    def changed(self, change: Float[Array, " n"]) -> Array:
        """The given value with its named numbers changed, shape that of the value."""
        return self.reference + jnp.reshape(change, self.reference.shape)

    def independent(self, value: Array) -> Array:
        """Numbers of a value that a prior is of."""
        return self.shown(value)

    def deviations(self, deviation: Array) -> Array:
        """Standard deviations of them, from those of the entries."""
        return self.shown(deviation)

    def labels(self) -> tuple[str, ...]:
        """Names of these numbers, behind the parameter's own."""
        return entries(np.shape(self.value(jnp.asarray(self.start()))))


def entries(shape: tuple[int, ...]) -> tuple[str, ...]:
    """Indices of the entries of an array, as a path has them."""
    if not shape:
        return ("",)
    every = np.ndindex(*shape)
    return tuple("".join(f"[{i}]" for i in index) for index in every)


def size_of(value: Array) -> float:
    """The largest number of an array, without its sign; 1 where all are zero."""
    return float(np.max(np.abs(np.asarray(value, float)), initial=0.0)) or 1.0


class Plain(AbstractTransform):
    """Numbers as they are."""

    def value(self, z: Float[Array, " k"]) -> Array:
        """The numbers."""
        return jnp.reshape(z, self.reference.shape)

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """The numbers."""
        return np.ravel(value)

    def scale(self) -> np.ndarray:
        """The largest of them; 1 where all are zero."""
        return np.full_like(self.start(), size_of(self.reference))


class Positive(AbstractTransform):
    """Positive numbers, by their logarithms."""

    def value(self, z: Float[Array, " k"]) -> Array:
        """The numbers."""
        return jnp.reshape(jnp.exp(z), self.reference.shape)

    def logarithms(self) -> np.ndarray:
        """All."""
        return np.eye(self.reference.size)

    def unit(self, shown: np.ndarray) -> float:
        """The largest of them: never zero, and its logarithm has no unit."""
        return float(shown.max())

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Their logarithms."""
        return np.log(np.ravel(value))


class Scaled(AbstractTransform):
    """An array by one positive factor: its ratios stay."""

    def value(self, z: Float[Array, " 1"]) -> Array:
        """The array."""
        return self.reference * jnp.exp(z[0])

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """The logarithm of the factor: zero of the array that was given."""
        known = np.asarray(self.reference, float)
        return np.log(np.array([np.sum(value * known) / np.sum(known * known)]))

    def logarithms(self) -> np.ndarray:
        """The factor's."""
        return np.eye(1)

    def shown(self, value: Array) -> Array:
        """The factor."""
        return (jnp.sum(value * self.reference) / jnp.sum(self.reference**2))[None]

    def changed(self, change: Float[Array, " 1"]) -> Array:
        """The array with its factor changed from 1."""
        return self.reference * (1.0 + change[0])

    def deviations(self, deviation: Array) -> Array:
        """Of the factor: the entries' deviations agree with it in their mean square."""
        return jnp.sqrt(jnp.sum(deviation**2) / jnp.sum(self.reference**2))[None]

    def labels(self) -> tuple[str, ...]:
        """That it is a factor."""
        return (" (factor)",)


class Rotated(AbstractTransform):
    """A unit quaternion, by a small rotation about fixed axes [rad]."""

    def value(self, z: Float[Array, " 3"]) -> Float[Array, "4"]:
        """The quaternion: ``exp(z / 2)`` times the one that was given."""
        size = jnp.sum(z * z)
        # cos and sin(x)/x of x = |z| / 2 are functions of its square, smooth at zero
        small = size < 1e-8  # what the series leave out is below 1e-16 / 384
        angle = 0.5 * jnp.sqrt(jnp.where(small, 1.0, size))
        real = jnp.where(small, 1.0 - size / 8.0, jnp.cos(angle))
        share = jnp.where(
            small,
            0.5 - size / 48.0,
            0.5 * jnp.sin(angle) / jnp.where(small, 1.0, angle),
        )
        return multiply(jnp.concatenate([real[None], share * z]), self.reference)

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """The rotation from the quaternion that was given, by pi at most."""
        real, *vector = np.asarray(self._turned(self.independent(jnp.asarray(value))))
        size = float(np.linalg.norm(vector))
        # without a rotation the vector is zero, whatever it is multiplied by
        return np.array(vector) * (2.0 * np.arctan2(size, real) / (size or 1.0))

    def coordinates(self, value: np.ndarray) -> np.ndarray:
        """Of either of the two quaternions of a rotation."""
        return super().coordinates(np.asarray(self.independent(jnp.asarray(value))))

    def shown(self, value: Array) -> Array:
        """Twice the vector part of the rotation from the given quaternion [rad]."""
        return 2.0 * self._turned(value)[1:]

    def changed(self, change: Float[Array, " 3"]) -> Float[Array, "4"]:
        """The quaternion rotated about fixed axes [rad]."""
        return self.value(change)

    def independent(self, value: Array) -> Array:
        """The four entries, of the sign that is nearer to the one given."""
        return jnp.where(value @ self.reference < 0.0, -value, value)

    def deviations(self, deviation: Array) -> Array:
        """Of the entries."""
        return deviation

    def labels(self) -> tuple[str, ...]:
        """Fixed axes."""
        return (" about x", " about y", " about z")

    def _turned(self, value: Array) -> Float[Array, "4"]:
        """The quaternion of the rotation from the one that was given."""
        back = self.reference * jnp.array([1.0, -1.0, -1.0, -1.0])
        return multiply(value, back) / jnp.sum(self.reference**2)
