"""Momenta that a rolling scene may keep, and what they are measured by."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics import observables
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene
from ..geometry.small_linear import cross, dot, matvec
from .independent_coordinates import body_length

# What is kept in one scene or another; which of them is, states decide. The first that
# will do are taken.
MOMENTA = (
    "moment about the contact z",
    "moment about the contact's normal",
    "Jellett's integral",  # of a ball: the moment along the arm from its mass centre
    "Routh's integral",  # of a ball of revolution
    "moment about the body's axis",
    "square of the moment about the contact",
    "angular velocity about the normal",
    "momentum x",
    "momentum y",
    "momentum z",
    "angular momentum z",
)


# Of the energy and of each of these: powers of mass, length and rate in its unit.
_UNITS = np.array(
    [
        (1, 2, 2),
        *((1, 2, 1), (1, 2, 1), (1, 3, 1), (1, 2, 1), (1, 2, 1), (2, 4, 2)),
        *((0, 0, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 2, 1)),
    ]
)


def units(scene: Scene, rate: float) -> np.ndarray:
    """What energy and momenta of the motion are measured by, shape (12,).

    All of its numbers are told beside these, so that none depends on units.
    """
    mass = float(scene.body.mass) or 1.0
    own = np.array([mass, body_length(scene), rate])
    return np.prod(own**_UNITS, axis=1)


def momenta(scene: Scene, t: Array, state: Any) -> Float[Array, "11"]:
    """Those of ``MOMENTA`` at a state."""
    body, contact = scene.body, contact_of(scene, t, state)
    moment = observables.contact_angular_momentum(scene, t, state)
    own = matvec(contact.rotation.T, moment)
    arm = contact.body_point - body.center_of_mass
    A, C = body.inertia[0, 0], body.inertia[2, 2]
    routh = A * C + body.mass * dot(arm, matvec(body.inertia, arm))
    P = observables.momentum(scene, t, state)
    about = moment + cross(contact.place, P)
    parts = (
        *(moment[2], dot(own, contact.normal), dot(own, arm)),
        *(contact.angular_velocity[2] * jnp.sqrt(routh), own[2], dot(own, own)),
        *(dot(contact.angular_velocity, contact.normal), *P, about[2]),
    )
    return jnp.stack(parts)
