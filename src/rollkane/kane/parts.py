"""Parts of a mechanical system, and loads on them, as Kane's method takes them."""

from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
from jaxtyping import Array

from ..dynamics.bodies import checked_inertia
from ..validation.checks import FieldError, is_traced, positive
from ..validation.user_functions import GivenFunction

# Wraps one: its field for errors, the function, the shape of its value if it is known.
Wrap: TypeAlias = Callable[[str, Any, tuple[int, ...] | None], GivenFunction]


class Particle(eqx.Module):
    """A point mass.

    Attributes:
        mass: [kg], a number or a function of the system's parameters.
        velocity: Function of (t, q, u) -> (3,) [m/s], FIXED axes.
    """

    mass: Any
    velocity: Any


class RigidBody(eqx.Module):
    """A rigid body.

    Attributes:
        mass: [kg], a number or a function of the system's parameters.
        inertia: About its mass centre, on axes fixed in it [kg m^2], shape (3, 3), or
            a function of the system's parameters.
        velocity: Of its mass centre, function of (t, q, u) -> (3,) [m/s].
        angular_velocity: Function of (t, q, u) -> (3,) [rad/s], on ITS OWN axes.
        own_axes: Whether ``velocity`` is on the body's own axes, too; else on fixed.
    """

    mass: Any
    inertia: Any
    velocity: Any
    angular_velocity: Any
    own_axes: bool = eqx.field(static=True, default=False)


class Load(eqx.Module):
    """A force with the velocity of its point of action, or a torque with what it turns.

    Both are on the same axes, whichever.

    Attributes:
        velocity: Of the point, or angular velocity of the body: function of (t, q, u)
            -> (3,) [m/s] or [rad/s].
        load: Function of (t, q, u) -> (3,) [N] or [N m].
    """

    velocity: Any
    load: Any


def checked_part(
    field: str, part: object, motion: Wrap, parameters: Any
) -> Particle | RigidBody:
    """A part with its functions wrapped, by ``motion``."""
    if not isinstance(part, (Particle, RigidBody)):
        raise FieldError(
            field, part, "is no part of a system", "give Particle or RigidBody"
        )
    mass = _number(f"{field}.mass", part.mass, _mass, (), parameters)
    velocity = motion(f"{field}.velocity", part.velocity, (3,))
    if isinstance(part, Particle):
        return Particle(mass, velocity)
    turning = motion(f"{field}.angular_velocity", part.angular_velocity, (3,))
    inertia = _number(f"{field}.inertia", part.inertia, _inertia, (3, 3), parameters)
    return RigidBody(mass, inertia, velocity, turning, part.own_axes)


def _number(
    field: str,
    given: Any,
    checked: Callable[[str, Any], Array],
    shape: tuple[int, ...],
    parameters: Any,
) -> Any:
    """A mass or an inertia, or the function of the parameters that gives it."""
    if not callable(given):
        return checked(field, given)
    if isinstance(given, GivenFunction):  # of a system without contacts
        return given
    meaning = "(parameters)"
    of = GivenFunction(field, given, shape, (parameters,), None, meaning)
    now = checked(field, of(parameters, None))
    if is_traced(now):  # what is known was refused, or can be
        of = _Spoilt(of, now - now)
        of = GivenFunction(field, of, shape, (parameters,), None, meaning)
    return of


class _Spoilt(eqx.Module):
    """A function of the parameters, NaN where its value at the start cannot be."""

    function: GivenFunction
    _nothing: Array

    def __call__(self, parameters: Any) -> Array:
        return self.function(parameters, None) + self._nothing


def _mass(field: str, given: Any) -> Array:
    return positive(field, given, (), "the mass in kg")


def _inertia(field: str, given: Any) -> Array:
    return checked_inertia(field, given, thin=True)


def checked_load(field: str, load: object, motion: Wrap) -> Load:
    """A load with its functions wrapped, by ``motion``."""
    if not isinstance(load, Load):
        raise FieldError(
            field, load, "is no load", "give Load(velocity, force) or Load(w, torque)"
        )
    return Load(
        motion(f"{field}.velocity", load.velocity, (3,)),
        motion(f"{field}.load", load.load, (3,)),
    )
