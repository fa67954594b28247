"""Pole-free coordinates: the state of a rolling body, and its rates.

Orientation by a quaternion of any length, angular velocity on body axes, contact points
by coordinates without poles. There are more numbers than degrees of freedom, but the
pose is an output of the contact, so none of the spare ones can open a gap.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.rotations import quaternion_rates
from ..geometry.small_linear import cross, dot, matvec
from ..geometry.surfaces import AbstractSurface
from .base_motion import BaseKinematics
from .contact import Contact, flight, rolling_contact


class State(eqx.Module):
    """State of a rolling body in pole-free coordinates.

    Attributes:
        orientation: Quaternion, scalar first, body to fixed axes, of any length [1].
        angular_velocity: Absolute, on BODY axes [rad/s], shape (3,).
        contact_on_base: Coordinates of the contact point on the base: a pair, a
            direction or a point, as the surface has it, shape (k,).
        contact_on_body: Likewise on the body; shape (0,) where the contact point
            follows from the normal.
        alpha: Coordinates of what the body supports, shape (n,).
        alpha_dot: Their rates, shape (n,).
    """

    orientation: Float[Array, "4"]
    angular_velocity: Float[Array, "3"]
    contact_on_base: Float[Array, " k"]
    contact_on_body: Float[Array, " m"]
    alpha: Float[Array, " n"]
    alpha_dot: Float[Array, " n"]

    touches: ClassVar[bool] = True  # its body is in contact
    slips: ClassVar[bool] = False
    in_charts: ClassVar[bool] = False

    def contact(
        self,
        body: AbstractSurface,
        base: AbstractSurface,
        moving: Callable[[], BaseKinematics | None],
        without_spin: bool,
    ) -> Contact:
        """Its contact.

        Args:
            body: The body's surface.
            base: The base's.
            moving: Gives how the base moves; None: it is at rest.
            without_spin: Whether the body does not turn about the normal.
        """
        return self._contact(body, base, moving(), None, without_spin)

    def _contact(
        self,
        body: AbstractSurface,
        base: AbstractSurface,
        moving: BaseKinematics | None,
        slip: Float[Array, "3"] | None,
        without_spin: bool,
    ) -> Contact:
        return rolling_contact(
            body,
            base,
            self.orientation,
            self.angular_velocity,
            self.contact_on_base,
            self.contact_on_body,
            moving,
            slip,
            without_spin=without_spin,
        )

    def rates(
        self,
        contact: Contact,
        angular_acceleration: Float[Array, "3"],
        alpha_ddot: Float[Array, " n"],
        point_acceleration: Float[Array, "3"] | None = None,
    ) -> "State":
        """Rates of every number of a state, as a state.

        Args:
            contact: Its contact, with the rates of the contact coordinates.
            angular_acceleration: ``w'``, BODY axes [rad/s^2].
            alpha_ddot: [unit of alpha / s^2].
            point_acceleration: None; a state that slips or flies has one.

        What of the state's velocities the contact does not allow, and so leaves out,
        goes along with the normal, so that it stays out.
        """
        del point_acceleration
        if contact.spare_spin is not None:
            N, w = contact.normal, contact.angular_velocity
            assert contact.normal_rate is not None
            along = contact.spare_spin * (contact.normal_rate - cross(w, N))
            angular_acceleration = angular_acceleration + along
        return State(
            orientation=quaternion_rates(self.orientation, contact.angular_velocity),
            angular_velocity=angular_acceleration,
            contact_on_base=contact.base_rates,
            contact_on_body=contact.body_rates,
            alpha=self.alpha_dot,
            alpha_dot=alpha_ddot,
        )


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
        slip: ``U``, velocity of the body's material point at the contact over the
            base, FIXED axes [m/s], shape (3,).
    """

    slip: Float[Array, "3"]

    slips: ClassVar[bool] = True

    def contact(
        self,
        body: AbstractSurface,
        base: AbstractSurface,
        moving: Callable[[], BaseKinematics | None],
        without_spin: bool,
    ) -> Contact:
        """Its contact; see :meth:`State.contact`."""
        return self._contact(body, base, moving(), self.slip, without_spin)

    def rates(
        self,
        contact: Contact,
        angular_acceleration: Float[Array, "3"],
        alpha_ddot: Float[Array, " n"],
        point_acceleration: Float[Array, "3"] | None = None,
    ) -> "SlidingState":
        """Rates of every number of a state, as a state.

        Args:
            contact: Its contact, with the rates of the contact coordinates.
            angular_acceleration: ``w'``, BODY axes [rad/s^2].
            alpha_ddot: [unit of alpha / s^2].
            point_acceleration: Along the surface, BODY axes [m/s^2].

        Source: docs/theory.md, (7.2); the slip stays on the surface as it turns.
        """
        rolling = super().rates(contact, angular_acceleration, alpha_ddot)
        slip, rate = contact.slip, contact.normal_rate
        assert slip is not None
        assert rate is not None
        assert point_acceleration is not None
        change = point_acceleration - contact.normal * dot(slip, rate)
        assert contact.spare_slip is not None
        change = change + contact.spare_slip * rate
        moved = matvec(contact.rotation, change)
        return SlidingState(**shared_parts(rolling), slip=moved)


class FlyingState(State):
    """State of a body in flight.

    Attributes:
        orientation: As in ``State`` [1], shape (4,).
        angular_velocity: On BODY axes [rad/s], shape (3,).
        contact_on_base: Where the base is nearest, shape (k,).
        contact_on_body: Where the body is nearest, shape (m,).
        alpha: Coordinates of what the body supports, shape (n,).
        alpha_dot: Their rates, shape (n,).
        position: Body origin, FIXED axes [m], shape (3,).
        velocity: Of the body origin, FIXED axes [m/s], shape (3,).
    """

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]

    touches: ClassVar[bool] = False

    def contact(
        self,
        body: AbstractSurface,
        base: AbstractSurface,
        moving: Callable[[], BaseKinematics | None],
        without_spin: bool,
    ) -> Contact:
        """What stands for a contact: its point is the body origin."""
        del body, base, moving, without_spin
        where = self.orientation, self.angular_velocity, self.position, self.velocity
        return flight(*where)

    def rates(
        self,
        contact: Contact,
        angular_acceleration: Float[Array, "3"],
        alpha_ddot: Float[Array, " n"],
        point_acceleration: Float[Array, "3"] | None = None,
    ) -> "FlyingState":
        """Rates of every number of a state, as a state.

        Args:
            contact: What stands for a contact: its point is the body origin.
            angular_acceleration: ``w'``, BODY axes [rad/s^2].
            alpha_ddot: [unit of alpha / s^2].
            point_acceleration: Of the body origin, BODY axes [m/s^2].
        """
        turning = super().rates(contact, angular_acceleration, alpha_ddot)
        assert point_acceleration is not None
        still = {
            "contact_on_base": jnp.zeros_like(self.contact_on_base),
            "contact_on_body": jnp.zeros_like(self.contact_on_body),
        }
        return FlyingState(
            **(shared_parts(turning) | still),
            position=self.velocity,
            velocity=matvec(contact.rotation, point_acceleration),
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
