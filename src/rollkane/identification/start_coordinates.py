"""Coordinates of a start's numbers of which some are spare, without these.

The length of a direction, what lifts a point off its surface, what a contact does not
let a velocity be: nothing shows them, and what is left has errors.
"""

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics.abstract_supported import rolling_parts
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene
from ..geometry.rotations import tangent_pair
from ..geometry.small_linear import matvec
from ..geometry.surfaces import AbstractSurface, Implicit
from . import paths
from .parameters import Model
from .transforms import AbstractTransform, size_of

# Newton steps onto a surface, whose error is squared by each: 0.1 of the way to the
# surface's curvature becomes a rounding in five.
_STEPS = 6


class Directions(AbstractTransform):
    """Numbers of which parts are directions: these by a turn [rad], to unit length.

    Attributes:
        reference: The numbers.
        parts: First of each direction and one behind its last: pairs or triples.
    """

    parts: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def value(self, z: Float[Array, " k"]) -> Float[Array, " n"]:
        """The numbers, with directions turned by z along their tangents."""
        found = self.reference
        others = np.setdiff1d(np.arange(found.size), self._turned())
        taken = len(others)
        found = found.at[others].set(z[:taken])
        for first, last in self.parts:
            u, across = _tangents(self.reference[first:last])
            own = z[taken : taken + across.shape[1]]
            taken += across.shape[1]
            size = jnp.sum(own * own)
            small = size < 1e-8  # what the series leave out is below 1e-16 / 24
            angle = jnp.sqrt(jnp.where(small, 1.0, size))
            along = jnp.where(small, 1.0 - size / 2.0, jnp.cos(angle))
            share = jnp.where(small, 1.0 - size / 6.0, jnp.sin(angle) / angle)
            turned = along * u + share * (across @ own)
            found = found.at[first:last].set(turned)
        return found

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """The turns from the directions that were given, by pi at most."""
        parts = [np.delete(value, self._turned())]
        for first, last in self.parts:
            u, across = map(np.asarray, _tangents(self.reference[first:last]))
            away = value[first:last] @ across
            size = float(np.linalg.norm(away))
            # without a turn it is zero, whatever it is multiplied by
            angle = np.arctan2(size, value[first:last] @ u)
            parts.append(away * (angle / (size or 1.0)))
        return np.concatenate(parts)

    def _turned(self) -> np.ndarray:
        """Which numbers are of a direction."""
        return np.concatenate([np.arange(*part) for part in self.parts])


class OnSurface(AbstractTransform):
    """A point of an implicit surface, by a way along its tangents [m].

    It is the point of the surface above or below that of the tangent plane.

    Attributes:
        reference: The point, shape (3,).
        surface: The surface, as it was given.
    """

    surface: Implicit

    def value(self, z: Float[Array, "2"]) -> Float[Array, "3"]:
        """The point [m]."""
        normal, across = self._plane()
        p = self.reference + across @ z
        for _ in range(_STEPS):
            level, slope = jax.value_and_grad(self.surface.f)(p)
            p = p - normal * (level / jnp.sum(slope * normal))
        return p

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """The way along the tangents."""
        away: np.ndarray = value - np.asarray(self.reference)
        return away @ np.asarray(self._plane()[1])

    def scale(self) -> np.ndarray:
        """The largest of its numbers."""
        return np.full(2, size_of(self.reference))

    def _plane(self) -> tuple[Array, Array]:
        """Normal and tangents of the surface where the point was given."""
        return _tangents(cast(Array, jax.grad(self.surface.f)(self.reference)))


class Across(AbstractTransform):
    """A vector without its part along a normal, which stays.

    Attributes:
        reference: The vector.
        normal: Unit vector.
    """

    normal: Float[Array, "3"]

    def value(self, z: Float[Array, "2"]) -> Float[Array, "3"]:
        """The vector [its unit]."""
        return self.reference + _tangents(self.normal)[1] @ z

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """The way across the normal."""
        away: np.ndarray = value - np.asarray(self.reference)
        return away @ np.asarray(_tangents(self.normal)[1])

    def coordinates(self, value: np.ndarray) -> np.ndarray:
        """Of any vector: a run leaves out what is along the normal."""
        return self.inverse(value)

    def scale(self) -> np.ndarray:
        """The largest of its numbers."""
        return np.full(2, size_of(self.reference))


def start_transform(
    model: Model, keys: paths.Keys, value: Array
) -> AbstractTransform | None:
    """The coordinates of numbers of a start with spare ones; None: of any others.

    Args:
        model: The model.
        keys: Of the numbers in the model.
        value: What the model has there.
    """
    if keys[0] != "start":
        return None
    scene, state, keys = model.scene, model.start, keys[1:]
    while keys[0] == "supported":
        part = int(keys[1])
        scene = rolling_parts(scene.supported)[part].scene
        state, keys = state.supported[part], keys[2:]
    if keys == ("contact_on_base",):
        return _of_contact(scene.base.surface, value)
    if keys == ("contact_on_body",):
        return _of_contact(scene.body.surface, value)
    return _of_velocity(scene, model.time, state, keys)


def _of_contact(surface: AbstractSurface, value: Array) -> AbstractTransform | None:
    """Coordinates of contact coordinates on a surface."""
    if isinstance(surface, Implicit):
        return OnSurface(surface.settled(value), surface)
    return Directions(value, surface.directions) if surface.directions else None


def _of_velocity(
    scene: Scene, t: Array, state: Any, keys: paths.Keys
) -> AbstractTransform | None:
    """Of a slip, and of an angular velocity on rubber: across the normal."""
    if not state.touches:
        return None
    if keys == ("slip",):
        contact = contact_of(scene, t, state)
        to_fixed = contact.rotation
        assert contact.slip is not None
        normal = matvec(to_fixed, contact.normal)
        return Across(matvec(to_fixed, contact.slip), normal)
    if keys == ("angular_velocity",) and scene.contact.without_spin and not state.slips:
        contact = contact_of(scene, t, state)
        return Across(contact.angular_velocity, contact.normal)
    return None


def _tangents(u: Float[Array, " n"]) -> tuple[Float[Array, " n"], Array]:
    """Unit vector along a pair or a triple, and its tangents, shape (n, n - 1)."""
    u = u / jnp.sqrt(jnp.sum(u * u))
    if u.size == 2:
        return u, jnp.stack([-u[1], u[0]])[:, None]
    return u, jnp.stack(tangent_pair(u), axis=1)
