"""Pole-free coordinates: the state of a rolling body, and its rates.

Orientation by a quaternion of any length, angular velocity on body axes, contact points
by coordinates without poles. There are more numbers than degrees of freedom, but the
pose is an output of the contact, so none of the spare ones can open a gap.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .contact import Contact
from .rotations import quaternion_rates


class State(eqx.Module):
    """State of a rolling body in pole-free coordinates.

    Attributes:
        orientation: Quaternion, scalar first, body to fixed axes, of any length [1].
        angular_velocity: Relative to the base, on BODY axes [rad/s], shape (3,).
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


def state_rates(
    state: State,
    contact: Contact,
    angular_acceleration: Float[Array, "3"],
    alpha_ddot: Float[Array, " n"],
) -> State:
    """Rates of every number of a state, as a state.

    Args:
        state: Where the body is.
        contact: Its contact, with the rates of the contact coordinates.
        angular_acceleration: BODY axes [rad/s^2].
        alpha_ddot: [unit of alpha / s^2].
    """
    return State(
        orientation=quaternion_rates(state.orientation, state.angular_velocity),
        angular_velocity=angular_acceleration,
        contact_on_base=contact.base_rates,
        contact_on_body=contact.body_rates,
        alpha=state.alpha_dot,
        alpha_dot=alpha_ddot,
    )


def pack(state: State) -> Float[Array, " y"]:
    """All numbers of a state in one array: what XLA's loops carry fastest."""
    parts = (
        state.orientation,
        state.angular_velocity,
        state.contact_on_base,
        state.contact_on_body,
        state.alpha,
        state.alpha_dot,
    )
    return jnp.concatenate([part for part in parts if part.shape[-1]], axis=-1)


def unpack(y: Float[Array, "*T y"], like: State) -> State:
    """The state whose numbers are ``y``, with the sizes of ``like``."""
    sizes = [
        part.shape[-1]
        for part in (
            like.orientation,
            like.angular_velocity,
            like.contact_on_base,
            like.contact_on_body,
            like.alpha,
            like.alpha_dot,
        )
    ]
    parts, start = [], 0
    for size in sizes:
        parts.append(y[..., start : start + size])
        start += size
    return State(*parts)
