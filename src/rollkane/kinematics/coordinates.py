"""Pole-free coordinates: the state of a rolling body, and its rates.

Orientation by a quaternion of any length, angular velocity on body axes, contact points
by coordinates without poles. There are more numbers than degrees of freedom, but the
pose is an output of the contact, so none of the spare ones can open a gap.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.rotations import quaternion_rates
from ..geometry.small_linear import cross, dot, matvec
from ..geometry.surfaces import AbstractSurface
from ..validation.shown import described
from .base_motion import BaseKinematics
from .contact import Contact, flight, rolling_contact


class Accelerations(NamedTuple):
    """What the forces determine of a motion, on BODY axes.

    Attributes:
        angular: ``w'`` [rad/s^2].
        alpha: ``alpha''`` [unit of alpha / s^2], shape (n,).
        point: Of a body that slips, of its point at the contact along the surface; in
            flight, of its origin [m/s^2]; None: it rolls.
        supported: Rates of the states of bodies that roll on this one.
    """

    angular: Float[Array, "3"]
    alpha: Float[Array, " n"]
    point: Float[Array, "3"] | None
    supported: tuple[Any, ...] = ()


class Pair(NamedTuple):
    """Two surfaces, and how they may move over each other.

    Attributes:
        body: The body's surface.
        base: The base's.
        moving: Gives how the base moves; None: it is at rest.
        without_spin: Whether the body does not turn about the normal.
    """

    body: AbstractSurface
    base: AbstractSurface
    moving: Callable[[], BaseKinematics | None]
    without_spin: bool


class AbstractState(eqx.Module):
    """Coordinates and velocities of a body, of one kind."""

    touches: ClassVar[bool] = True  # its body is in contact
    slips: ClassVar[bool] = False
    in_charts: ClassVar[bool] = False

    def __repr__(self) -> str:
        """Its numbers, with units; angular velocities on BODY axes."""
        return described(self)

    @abc.abstractmethod
    def contact(self, pair: Pair) -> Contact:
        """Its contact, or what stands for one."""

    def rates(
        self,
        contact: Contact,
        angular_acceleration: Float[Array, "3"],
        alpha_ddot: Float[Array, " n"],
        point_acceleration: Float[Array, "3"] | None = None,
        supported: tuple[Any, ...] = (),
    ) -> Self:
        """Rates of every number of a state, as a state.

        Args:
            contact: Its contact, with the rates of the contact coordinates.
            angular_acceleration: ``w'``, BODY axes [rad/s^2].
            alpha_ddot: [unit of alpha / s^2].
            point_acceleration: As ``point`` of :class:`Accelerations`.
            supported: As of :class:`Accelerations`.
        """
        known = angular_acceleration, alpha_ddot, point_acceleration, supported
        return self._rates(contact, Accelerations(*known))

    @abc.abstractmethod
    def _rates(self, contact: Contact, known: Accelerations) -> Self:
        """Rates of every number, from the accelerations."""


class State(AbstractState):
    """State of a rolling body in pole-free coordinates.

    It has spare numbers where it holds the contact on the body: a run keeps both
    contacts, and turns a body that does not fit them. To turn a start, place it anew.

    Attributes:
        orientation: Quaternion, scalar first, body to fixed axes, of any length [1].
        angular_velocity: Absolute, on BODY axes [rad/s], shape (3,).
        contact_on_base: Coordinates of the contact point on the base: a pair, a
            direction or a point, as the surface has it, shape (k,).
        contact_on_body: Likewise on the body; shape (0,) where the contact point
            follows from the normal.
        alpha: Coordinates of what the body supports, shape (n,).
        alpha_dot: Their rates, shape (n,).
        supported: A state for each body that rolls on this one, relative to it.
    """

    orientation: Float[Array, "4"]
    angular_velocity: Float[Array, "3"]
    contact_on_base: Float[Array, " k"]
    contact_on_body: Float[Array, " m"]
    alpha: Float[Array, " n"]
    alpha_dot: Float[Array, " n"]
    supported: tuple["State", ...] = eqx.field(default=(), kw_only=True)

    def contact(self, pair: Pair) -> Contact:
        """Its contact."""
        return self._contact(pair, None)

    def _contact(self, pair: Pair, slip: Float[Array, "3"] | None) -> Contact:
        return rolling_contact(
            pair.body,
            pair.base,
            self.orientation,
            self.angular_velocity,
            self.contact_on_base,
            self.contact_on_body,
            pair.moving(),
            slip,
            without_spin=pair.without_spin,
        )

    def _rates(self, contact: Contact, known: Accelerations) -> Self:
        """Rates of a state that rolls.

        What of the state's velocities the contact does not allow, and so leaves out,
        goes along with the normal, so that it stays out.
        """
        return type(self)(**self._turning(contact, known))

    def _turning(self, contact: Contact, known: Accelerations) -> dict[str, Any]:
        """Rates of what every kind has, by name."""
        angular_acceleration = known.angular
        if contact.spare_spin is not None:
            N, w = contact.normal, contact.angular_velocity
            assert contact.normal_rate is not None
            along = contact.spare_spin * (contact.normal_rate - cross(w, N))
            angular_acceleration = angular_acceleration + along
        return {
            "orientation": quaternion_rates(self.orientation, contact.angular_velocity),
            "angular_velocity": angular_acceleration,
            "contact_on_base": contact.base_rates,
            "contact_on_body": contact.body_rates,
            "alpha": self.alpha_dot,
            "alpha_dot": known.alpha,
            "supported": known.supported,
        }


def shared_parts(state: State) -> dict[str, Any]:
    """What every kind of ``State`` has, by name."""
    return {f.name: getattr(state, f.name) for f in dataclasses.fields(State)}


class SlidingState(State):
    """State of a body that slips, too.

    Attributes:
        orientation: As in ``State`` [1], shape (4,).
        angular_velocity: On BODY axes [rad/s], shape (3,).
        contact_on_base: Contact point on the base, shape (k,).
        contact_on_body: On the body, shape (m,).
        alpha: Coordinates of what the body supports, shape (n,).
        alpha_dot: Their rates, shape (n,).
        supported: A state for each body that rolls on this one, relative to it.
        slip: ``U``, velocity of the body's material point at the contact over the
            base, FIXED axes [m/s], shape (3,).
    """

    slip: Float[Array, "3"]

    slips: ClassVar[bool] = True

    def contact(self, pair: Pair) -> Contact:
        """Its contact, about whose normal it may turn, on rubber too."""
        return self._contact(pair._replace(without_spin=False), self.slip)

    def _rates(self, contact: Contact, known: Accelerations) -> Self:
        """Rates of a state that slips.

        Source: docs/theory.md, (7.2); the slip stays on the surface as it turns.
        """
        slip, rate = contact.slip, contact.normal_rate
        assert slip is not None
        assert rate is not None
        assert known.point is not None
        change = known.point - contact.normal * dot(slip, rate)
        assert contact.spare_slip is not None
        change = change + contact.spare_slip * rate
        moved = matvec(contact.rotation, change)
        return type(self)(**self._turning(contact, known), slip=moved)


class FlyingState(State):
    """State of a body in flight.

    Attributes:
        orientation: As in ``State`` [1], shape (4,).
        angular_velocity: On BODY axes [rad/s], shape (3,).
        contact_on_base: Where the base is nearest, shape (k,); of a run in which
            nothing lands, where it was as the flight began.
        contact_on_body: Where the body is nearest, shape (m,); likewise.
        alpha: Coordinates of what the body supports, shape (n,).
        alpha_dot: Their rates, shape (n,).
        supported: A state for each body that rolls on this one, relative to it.
        position: Body origin, FIXED axes [m], shape (3,).
        velocity: Of the body origin, FIXED axes [m/s], shape (3,).
    """

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]

    touches: ClassVar[bool] = False

    def contact(self, pair: Pair) -> Contact:
        """What stands for a contact: its point is the body origin."""
        del pair
        where = self.orientation, self.angular_velocity, self.position, self.velocity
        return flight(*where)

    def _rates(self, contact: Contact, known: Accelerations) -> Self:
        """Rates of a state in flight."""
        assert known.point is not None
        still: dict[str, Any] = {
            "contact_on_base": jnp.zeros_like(self.contact_on_base),
            "contact_on_body": jnp.zeros_like(self.contact_on_body),
        }
        return type(self)(
            **(self._turning(contact, known) | still),
            position=self.velocity,
            velocity=matvec(contact.rotation, known.point),
        )


def pack(state: eqx.Module) -> Float[Array, " y"]:
    """All numbers of a state in one array: what XLA's loops carry fastest."""
    parts = [jnp.atleast_1d(leaf) for leaf in jax.tree.leaves(state)]
    return jnp.concatenate([part for part in parts if part.shape[0]])


def unpack(y: Float[Array, "*T y"], like: Any) -> Any:
    """The state whose numbers are ``y``, with the sizes of ``like``."""
    leaves, tree = cast(tuple[list[Array], Any], jax.tree.flatten(like))
    parts: list[Array] = []
    start = 0
    for leaf in leaves:
        if leaf.ndim:
            parts.append(y[..., start : start + leaf.shape[0]])
            start += leaf.shape[0]
        else:
            parts.append(y[..., start])
            start += 1
    return jax.tree.unflatten(tree, parts)
