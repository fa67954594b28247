"""A body and what it carries as masses and rigid bodies, by their definitions alone.

Where they are, how they move with coordinates and time, and the inertia that an impulse
meets. Of rollkane only the parts are made here that its scenes take.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

from .outputs_alone import CENTER, INERTIA, MASS


class Item(NamedTuple):
    """A point mass or a rigid body.

    Attributes:
        mass: [kg].
        inertia: About its mass centre, its own axes [kg m^2]; None: a point mass.
        place: ``place(alpha, t)`` of its mass centre [m], the carrier's axes.
        rotation: ``rotation(alpha, t)``, its own to the carrier's axes.
    """

    mass: float
    inertia: np.ndarray | None
    place: Callable
    rotation: Callable | None


class Kind(NamedTuple):
    """A part of a scene: as rollkane has it, and as its items.

    Attributes:
        part: For ``Scene.supported``.
        items: Its masses.
        count: Number of its coordinates.
        force: ``force(alpha, alpha_dot)``, generalized, of springs and dampers.
    """

    part: Any
    items: tuple[Item, ...]
    count: int = 0
    force: Callable | None = None


FIRST_AXIS, SECOND_AXIS = np.array([0.3, -0.5, 0.8]), np.array([0.2, 0.9, 0.1])
SMALL = np.array([[0.004, 0.0005, 0], [0.0005, 0.006, -0.0003], [0, -0.0003, 0.005]])


def skew(w):
    """Matrix of ``w x``."""
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def turned(axis, angle):
    """Rodrigues' formula."""
    K = jnp.asarray(skew(axis / np.linalg.norm(axis)))
    return jnp.eye(3) + jnp.sin(angle) * K + (1 - jnp.cos(angle)) * K @ K


def _on_curve(a):
    along = a[0] * jnp.asarray(FIRST_AXIS) + 0.3 * a[0] ** 2 * jnp.asarray(SECOND_AXIS)
    return jnp.asarray([0.02, -0.03, 0.01]) + along


def _coupled(a):
    one = jnp.stack([0.1 * jnp.sin(a[0]), 0.05 * a[1], -0.1 * jnp.cos(a[0])])
    turn = jnp.stack([jnp.cos(a[1]), jnp.sin(a[1] + a[0])])
    return jnp.stack([one, jnp.stack([0.02 * a[1] + 0.05, *(0.08 * turn)])])


def _hung(a):
    arm = turned(SECOND_AXIS, a[0]) @ jnp.asarray([0.0, 0.03, -0.1])
    return jnp.asarray([0.05, 0.0, 0.02]) + arm


def _hung_axes(a):
    return turned(SECOND_AXIS, a[0]) @ turned(FIRST_AXIS, 0.4)


def _spring() -> Kind:
    """A mass on a spring along a curve."""
    potential = lambda a: 20.0 * a[0] ** 2 + 5.0 * a[0] ** 4
    part = rk.PointMasses(0.4, lambda a: _on_curve(a)[None], potential=potential)
    item = Item(0.4, None, lambda a, t: _on_curve(a), None)
    force = lambda a, d: -jnp.stack([40.0 * a[0] + 20.0 * a[0] ** 3])
    return Kind(part, (item,), 1, force)


def _two() -> Kind:
    """Two masses, each by both of two coordinates, with springs and dampers."""
    force = lambda a, d: -0.02 * d - 0.5 * a
    part = rk.PointMasses(
        [0.3, 0.2], _coupled, lambda t, a, d: force(a, d), None, None, 2
    )
    place = lambda k: lambda a, t: _coupled(a)[k]
    items = tuple(Item(m, None, place(k), None) for k, m in enumerate((0.3, 0.2)))
    return Kind(part, items, 2, force)


def _pendulum() -> Kind:
    """A rigid body that swings, damped."""
    force = lambda a, d: -0.01 * d
    part = rk.SupportedBody(0.5, SMALL, _hung, _hung_axes, lambda t, a, d: force(a, d))
    item = Item(0.5, SMALL, lambda a, t: _hung(a), lambda a, t: _hung_axes(a))
    return Kind(part, (item,), 1, force)


def _driven() -> Kind:
    """A mass that is moved as it is prescribed."""
    motion = lambda t: jnp.stack([0.08 * jnp.sin(7.0 * t)])
    mass = rk.PointMasses(0.4, lambda a: _on_curve(a)[None])
    item = Item(0.4, None, lambda a, t: _on_curve(motion(t)), None)
    return Kind(rk.Prescribed(mass, motion), (item,))


def _rotor() -> Kind:
    """A rigid body that is turned as it is prescribed."""
    motion = lambda t: jnp.stack([5.0 * t + jnp.sin(t)])
    body = rk.SupportedBody(0.5, SMALL, _hung, _hung_axes)
    place = lambda a, t: _hung(motion(t))
    item = Item(0.5, SMALL, place, lambda a, t: _hung_axes(motion(t)))
    return Kind(rk.Prescribed(body, motion), (item,))


KINDS: dict[str, Callable[[], Kind]] = {
    "spring": _spring,
    "two": _two,
    "pendulum": _pendulum,
    "driven": _driven,
    "rotor": _rotor,
}


class Seen(NamedTuple):
    """An item at some times, on the carrier's axes.

    Attributes:
        place: [m].
        slopes: Derivatives of it by the coordinates.
        rotation: Its own to the carrier's axes.
        spin: Relative to the carrier [rad/s].
        turns: Derivatives of the spin by the rates of the coordinates.
    """

    place: np.ndarray
    slopes: np.ndarray
    rotation: np.ndarray
    spin: np.ndarray
    turns: np.ndarray


class System:
    """A body with what it carries."""

    def __init__(self, names: Sequence[str] = ()):
        """Put it together of kinds, by their names."""
        made = [KINDS[name]() for name in names]
        self.parts = tuple(kind.part for kind in made)
        first = np.cumsum([0, *(kind.count for kind in made)])
        own = [slice(*ends) for ends in itertools.pairwise(first)]
        eye = lambda a, t: jnp.eye(3)
        self.items = [Item(MASS, INERTIA, lambda a, t: jnp.asarray(CENTER), eye)]
        for kind, where in zip(made, own, strict=True):
            self.items += [_of_own(item, where) for item in kind.items]
        self.count, self.mass = int(first[-1]), sum(item.mass for item in self.items)
        pairs = [(k.force, w) for k, w in zip(made, own, strict=True) if k.force]
        self._force = jax.jit(
            lambda a, d: jnp.concatenate([f(a[w], d[w]) for f, w in pairs])
        )
        self._seen = jax.jit(jax.vmap(lambda *at: [_seen(x, *at) for x in self.items]))

    def force(self, alpha: np.ndarray, alpha_dot: np.ndarray) -> np.ndarray:
        """Generalized, of what is carried."""
        return np.asarray(self._force(alpha, alpha_dot)) if self.count else np.zeros(0)

    def at(self, t: Any, alpha: np.ndarray, alpha_dot: np.ndarray) -> list[Seen]:
        """All items, at times."""
        return jax.tree.map(np.asarray, self._seen(jnp.asarray(t), alpha, alpha_dot))

    def inertia(self, seen: list[Seen], R: np.ndarray) -> np.ndarray:
        """Of the velocity of the carrier's origin, its spin and the coordinates' rates.

        Args:
            seen: Items at one time.
            R: The carrier's to fixed axes.
        """
        M = np.zeros((6 + self.count, 6 + self.count))
        for item, x in zip(self.items, seen, strict=True):
            J = np.hstack([np.eye(3), -skew(R @ x.place), R @ x.slopes])
            M += item.mass * J.T @ J
            if item.inertia is not None:
                K = np.hstack([np.zeros((3, 3)), np.eye(3), R @ x.turns])
                M += K.T @ _turned_inertia(item.inertia, R @ x.rotation) @ K
        return M


def _turned_inertia(inertia, A):
    return A @ inertia @ A.T


def _of_own(item: Item, where: slice) -> Item:
    """An item of its own coordinates, as one of all."""
    place, rotation = item.place, item.rotation
    own = lambda a, t: place(a[where], t)
    turn = None if rotation is None else lambda a, t: rotation(a[where], t)
    return item._replace(place=own, rotation=turn)


def _seen(item: Item, t, alpha, alpha_dot) -> Seen:
    slopes = jax.jacfwd(item.place)(alpha, t)
    still = jnp.zeros((3, alpha.shape[0]))
    if item.rotation is None:
        parts = jnp.eye(3), jnp.zeros(3), still
        return Seen(item.place(alpha, t), slopes, *parts)
    rates = alpha_dot, jnp.ones_like(t)
    R, R_dot = jax.jvp(item.rotation, (alpha, t), rates)
    by_alpha = jax.jacfwd(item.rotation)(alpha, t)
    columns = [_axial(by_alpha[:, :, s] @ R.T) for s in range(alpha.shape[0])]
    turns = jnp.stack(columns, axis=1) if columns else still
    return Seen(item.place(alpha, t), slopes, R, _axial(R_dot @ R.T), turns)


def _axial(S):
    return jnp.stack([S[2, 1], S[0, 2], S[1, 0]])
