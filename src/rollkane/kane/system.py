"""A mechanical system in the terms of Kane's method: coordinates, speeds, parts, loads.

Every function of the user's takes ``(t, q, u)``, then the parameters if it wants them:
time [s], generalized coordinates and generalized speeds. Velocities are affine in the
speeds; nothing is derived by hand, partial velocities and accelerations are theirs.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..bodies import checked_inertia
from ..checks import FieldError, positive
from ..user_function import UserFunction, accepts, check_output


class MotionFunction(eqx.Module):
    """A user's function of ``(t, q, u)`` with a value of known shape."""

    function: UserFunction

    def __init__(self, field: str, function: Callable, shape, sizes, parameters: Any):
        """Wrap it; refused if it does not give ``shape``.

        Args:
            field: Name used in errors.
            function: The user's.
            shape: Of its value.
            sizes: Number of coordinates and of speeds.
            parameters: Tree of numbers that it depends on, or None.

        Raises:
            FieldError: no function, or one of another shape or signature.
        """
        if not callable(function):
            raise FieldError(
                field,
                function,
                "must be a function",
                "give a function of (t, q, u), and of the parameters if it needs them",
            )
        takes = parameters is not None and accepts(function, 4)
        if not takes and not accepts(function, 3):
            raise FieldError(
                field,
                function,
                "has a signature that does not fit",
                "let it take (t, q, u), and then the parameters if there are any",
            )
        coordinates, speeds = sizes
        spread = _Spread(function, coordinates, speeds, takes)
        count = 1 + sum(sizes)
        own = parameters if takes else None
        self.function = UserFunction(field, spread, count, own, of_array=True)
        check_output(field, self.function, jnp.zeros(count), shape)

    def __call__(self, t, q, u) -> Array:
        """Its value."""
        return self.function(jnp.concatenate([jnp.reshape(t, (1,)), q, u]))


class _Spread(eqx.Module):
    """A function of (t, q, u) as one of a single array."""

    function: Any
    n: int = eqx.field(static=True)
    m: int = eqx.field(static=True)
    takes: bool = eqx.field(static=True)

    @property
    def __name__(self) -> str:
        return getattr(self.function, "__name__", type(self.function).__name__)

    def __call__(self, x, parameters=None):
        extra = (parameters,) if self.takes else ()
        value = self.function(x[0], x[1 : 1 + self.n], x[1 + self.n :], *extra)
        if isinstance(value, (tuple, list)):
            value = jnp.stack([jnp.asarray(v, x.dtype) for v in value])
        return value


class Particle(eqx.Module):
    """A point mass.

    Attributes:
        mass: [kg].
        velocity: Function of (t, q, u) -> (3,) [m/s], FIXED axes.
    """

    mass: Any
    velocity: Any


class RigidBody(eqx.Module):
    """A rigid body.

    Attributes:
        mass: [kg].
        inertia: About its mass centre, on axes fixed in it [kg m^2], shape (3, 3).
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


class KaneSystem(eqx.Module):
    """A system of particles and bodies, with generalized coordinates and speeds.

    Attributes:
        kinematics: ``q' = Y(t, q) u + Z(t, q)``, function of (t, q, u).
        parts: Particles and bodies.
        loads: Forces and torques.
        generalized_forces: Function of (t, q, u) -> (speeds + auxiliary,), added to
            F_r; None for none.
        constraints: Velocity constraints, function of (t, q, u) -> (m,), affine in u;
            None for none.
        configuration: Constraints of the coordinates, function of (t, q, u), which
            does not look at u; None for none. The motion keeps them by the velocity
            constraints; linearization and starts need them.
        coordinates: Number of generalized coordinates.
        speeds: Number of generalized speeds, dependent ones included.
        dependent: Which speeds the constraints determine.
        dependent_coordinates: Which coordinates the configuration constraints do.
        auxiliary: How many speeds at the end are auxiliary: they are zero, and their
            equations give the reactions against them.
    """

    kinematics: MotionFunction
    parts: tuple[Particle | RigidBody, ...]
    loads: tuple[Load, ...]
    generalized_forces: MotionFunction | None
    constraints: MotionFunction | None
    configuration: MotionFunction | None
    coordinates: int = eqx.field(static=True)
    speeds: int = eqx.field(static=True)
    dependent: tuple[int, ...] = eqx.field(static=True)
    dependent_coordinates: tuple[int, ...] = eqx.field(static=True)
    auxiliary: int = eqx.field(static=True)

    def __init__(
        self,
        coordinates: int,
        speeds: int,
        kinematics: Callable,
        parts=(),
        loads=(),
        constraints: Callable | None = None,
        dependent=(),
        configuration: Callable | None = None,
        dependent_coordinates=(),
        auxiliary: int = 0,
        generalized_forces: Callable | None = None,
        parameters: Any = None,
    ):
        """Make a system.

        Args:
            coordinates: How many generalized coordinates q there are.
            speeds: How many generalized speeds u, dependent ones included, auxiliary
                ones not.
            kinematics: ``kinematics(t, q, u)`` -> q', shape (coordinates,).
            parts: ``Particle`` and ``RigidBody``.
            loads: ``Load``: forces and torques that do work on some motion.
            constraints: ``constraints(t, q, u)`` -> what has to be zero, affine in u.
            dependent: Numbers of the speeds that the constraints determine, as many as
                there are constraints.
            configuration: ``configuration(t, q)`` -> what has to be zero; its rate must
                be among the constraints.
            dependent_coordinates: Numbers of the coordinates that it determines.
            auxiliary: Number of auxiliary speeds; every function gets them behind the
                others.
            generalized_forces: Function of (t, q, u) -> one force for each speed [J per
                unit of the integral of the speed], the auxiliary ones last: what is
                easier said in coordinates than by points (springs, dampers, motors).
            parameters: Tree of numbers; given to each function that takes a fourth
                argument. To differentiate by them, make the system inside.

        Raises:
            FieldError: shapes that do not fit, dependent speeds that are not there,
                masses or inertias that no body can have.
        """
        self.coordinates, self.speeds = coordinates, speeds
        self.auxiliary = auxiliary
        sizes = (coordinates, speeds + auxiliary)

        def motion(field, function, shape):
            return MotionFunction(field, function, shape, sizes, parameters)

        field = "KaneSystem.kinematics"
        self.kinematics = motion(field, kinematics, (coordinates,))
        self.parts = tuple(
            _checked_part(f"KaneSystem.parts[{k}]", part, motion)
            for k, part in enumerate(parts)
        )
        self.loads = tuple(
            _checked_load(f"KaneSystem.loads[{k}]", load, motion)
            for k, load in enumerate(loads)
        )
        self.generalized_forces = None
        if generalized_forces is not None:
            field = "KaneSystem.generalized_forces"
            self.generalized_forces = motion(field, generalized_forces, (sizes[1],))
        self.dependent = _chosen("dependent", dependent, speeds)
        self.constraints = _bound(
            motion, "constraints", constraints, "dependent", self.dependent
        )
        self.dependent_coordinates = _chosen(
            "dependent_coordinates", dependent_coordinates, coordinates
        )
        of_q = None
        if configuration is not None:
            given = configuration
            of_q = lambda t, q, u, *p: given(t, q, *p)
            if parameters is None or not accepts(given, 3):
                of_q = lambda t, q, u: given(t, q)
        self.configuration = _bound(
            motion,
            "configuration",
            of_q,
            "dependent_coordinates",
            self.dependent_coordinates,
        )

    @property
    def independent(self) -> tuple[int, ...]:
        """Numbers of the independent speeds."""
        return tuple(k for k in range(self.speeds) if k not in self.dependent)

    @property
    def independent_coordinates(self) -> tuple[int, ...]:
        """Numbers of the independent coordinates."""
        bound = self.dependent_coordinates
        return tuple(k for k in range(self.coordinates) if k not in bound)


class KaneState(eqx.Module):
    """State of a system.

    Attributes:
        q: Generalized coordinates, shape (n,).
        u: INDEPENDENT generalized speeds, shape (m,).
    """

    q: Float[Array, " n"]
    u: Float[Array, " m"]


def _checked_part(field: str, part, motion) -> Particle | RigidBody:
    if not isinstance(part, (Particle, RigidBody)):
        raise FieldError(
            field, part, "is no part of a system", "give Particle or RigidBody"
        )
    mass = positive(f"{field}.mass", part.mass, (), "the mass in kg")
    velocity = motion(f"{field}.velocity", part.velocity, (3,))
    if isinstance(part, Particle):
        return Particle(mass, velocity)
    turning = motion(f"{field}.angular_velocity", part.angular_velocity, (3,))
    inertia = checked_inertia(f"{field}.inertia", part.inertia, thin=True)
    return RigidBody(mass, inertia, velocity, turning, part.own_axes)


def _checked_load(field: str, load, motion) -> Load:
    if not isinstance(load, Load):
        raise FieldError(
            field, load, "is no load", "give Load(velocity, force) or Load(w, torque)"
        )
    return Load(
        motion(f"{field}.velocity", load.velocity, (3,)),
        motion(f"{field}.load", load.load, (3,)),
    )


def _chosen(name: str, numbers, count: int) -> tuple[int, ...]:
    """Different numbers of speeds or coordinates."""
    chosen = tuple(int(k) for k in numbers)
    if len(set(chosen)) != len(chosen) or not all(0 <= k < count for k in chosen):
        raise FieldError(
            f"KaneSystem.{name}",
            numbers,
            "must be different numbers of those that there are",
            f"give numbers from 0 to {count - 1}",
        )
    return chosen


def _bound(motion, name: str, function, of: str, chosen) -> MotionFunction | None:
    """Constraints, one for each number that they determine."""
    if function is None and chosen:
        raise FieldError(
            f"KaneSystem.{of}",
            chosen,
            "are not determined by anything",
            f"give {name}(t, q, ...), one for each",
        )
    if function is None:
        return None
    return motion(f"KaneSystem.{name}", function, (len(chosen),))
