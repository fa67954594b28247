"""What the rolling body carries: point masses and rigid bodies that move inside it.

Each gives at one instant a :class:`Carried` value: where its masses are, how they move
relative to the body, and by how much a unit of each coordinate moves them. The
mechanics needs nothing else.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.small_linear import components
from ..validation.checks import FieldError, dimension, positive
from ..validation.user_functions import (
    UserFunction,
    as_time,
    check_output,
    check_rotation,
)
from .abstract_supported import AbstractSupported
from .bodies import Matrix, Vector, checked_inertia
from .carried import Carried, turning_of
from .coordinate_functions import Apart, apart_of, functions_of, moved, rates_of


class _Driven(AbstractSupported):
    """What both kinds share: functions of their coordinates, force and potential."""

    mass: eqx.AbstractVar[Array]
    position: eqx.AbstractVar[UserFunction]
    force: eqx.AbstractVar[UserFunction | None]
    potential: eqx.AbstractVar[UserFunction | None]
    parameters: eqx.AbstractVar[Any]

    def generalized_force(
        self, t: Array, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
    ) -> Float[Array, " n"] | None:
        """``Q_s`` of the user's force [J per unit of alpha]."""
        if self.force is None:
            return None
        arguments = jnp.concatenate([as_time(t)[None], alpha, alpha_dot])
        return self.force(arguments, self.parameters)

    def potential_energy(self, alpha: Float[Array, " n"]) -> Float[Array, ""] | None:
        """The user's potential [J]."""
        if self.potential is None:
            return None
        return self.potential(alpha, self.parameters)

    @property
    def does_work(self) -> bool:
        """Whether the user gave a force."""
        return self.force is not None


class PointMasses(_Driven):
    """Point masses whose places in the body are functions of coordinates alpha.

    Attributes:
        mass: [kg], shape (k,).
        position: The user's function alpha -> (k, 3) [m], body axes.
        force: The user's generalized forces, or None.
        potential: The user's potential energy, or None.
        parameters: Tree of numbers that all of these take last, or None.
        count: Number of coordinates n.
    """

    mass: Float[Array, " k"]
    position: UserFunction
    force: UserFunction | None
    potential: UserFunction | None
    parameters: Any
    count: int = eqx.field(static=True)

    def __init__(
        self,
        mass: Vector,
        position: Callable[..., Any],
        force: Callable[..., Any] | None = None,
        potential: Callable[..., Any] | None = None,
        parameters: Any = None,
        coordinates: int | None = None,
    ):
        """Make point masses.

        Args:
            mass: [kg], shape (k,), positive; one number for a single mass.
            position: ``position(alpha)`` or ``position(alpha, parameters)`` with alpha
                of shape (n,) -> (k, 3) [m], from the body origin, body axes; written
                with jax.numpy and twice differentiable.
            force: ``force(t, alpha, alpha_dot)`` (then parameters) -> (n,),
                generalized forces of springs, dampers and motors [J per unit of
                alpha]; left out, none. Loads of the scene, such as gravity, are not
                to be repeated in it.
            potential: ``potential(alpha)`` (then parameters) -> energy of springs [J];
                its forces are added, and it counts in the energy.
            parameters: Tree of numbers that the functions depend on; differentiable.
            coordinates: n; left out, it is found from the functions.

        Raises:
            FieldError: masses that are not positive, functions whose shapes do not
                fit, a number of coordinates that cannot be found.
        """
        one: Any = mass
        if dimension(one) == 0 and not isinstance(one, (str, bool, type(None))):
            mass = [one]
        self.mass = positive("PointMasses.mass", mass, (None,), "masses in kg, (k,)")
        shapes = {"position": (self.mass.shape[0], 3)}
        given = {"position": position, "force": force, "potential": potential}
        made = functions_of("PointMasses", given, shapes, parameters, coordinates)
        self.count, self.parameters = made.count, made.parameters
        self.position = made.functions["position"]
        self.force = made.functions["force"]
        self.potential = made.functions["potential"]

    @property
    def apart(self) -> Apart | None:
        """How its coordinates are shared out among its masses; None: they are not.

        Read off its position's program, each time: a part may get another one.
        """
        return apart_of(self.position, self.parameters, self.mass.shape[0], self.count)

    def carried(
        self, t: Array, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
    ) -> Carried:
        """The masses at one instant; the positions are differentiated here, once."""
        del t
        position = self.position.of(self.parameters)
        place, velocity, bias, partials = moved(position, alpha, alpha_dot)
        return Carried(
            self.mass, place.T, velocity.T, bias.T, tuple(p.T for p in partials)
        )

    def carried_apart(
        self,
        apart: Apart | None,
        t: Array,
        alpha: Float[Array, " n"],
        alpha_dot: Float[Array, " n"],
    ) -> Carried:
        """The same, with a column for each mass's first, second, ... coordinate."""
        if apart is None:
            return self.carried(t, alpha, alpha_dot)
        position = self.position.of(self.parameters)
        place, velocity, bias = rates_of(position, alpha, alpha_dot)
        partials = apart.partials(position, alpha)
        return Carried(self.mass, place.T, velocity.T, bias.T, partials)


class SupportedBody(_Driven):
    """A rigid body carried inside, with coordinates alpha of its own.

    Attributes:
        mass: [kg].
        inertia: About its own mass centre, its own axes [kg m^2], shape (3, 3).
        position: The user's function alpha -> (3,) [m], body axes: its mass centre.
        rotation: The user's function alpha -> (3, 3), its axes to body axes.
        force: The user's generalized forces, or None.
        potential: The user's potential energy, or None.
        parameters: Tree of numbers that all of these take last, or None.
        count: Number of coordinates n.

    Source: docs/theory.md, (4.4), for positions and rotations that may both depend on
    every coordinate.
    """

    mass: Float[Array, ""]
    inertia: Float[Array, "3 3"]
    position: UserFunction
    rotation: UserFunction
    force: UserFunction | None
    potential: UserFunction | None
    parameters: Any
    count: int = eqx.field(static=True)

    def __init__(
        self,
        mass: ArrayLike,
        inertia: Matrix,
        position: Callable[..., Any],
        rotation: Callable[..., Any],
        force: Callable[..., Any] | None = None,
        potential: Callable[..., Any] | None = None,
        parameters: Any = None,
        coordinates: int | None = None,
    ):
        """Make a carried body.

        Args:
            mass: The mass [kg], positive.
            inertia: The 3 x 3 tensor about its own mass centre, its own axes [kg m^2].
            position: ``position(alpha)`` (then parameters) -> its mass centre [m],
                (3,), from the rolling body's origin, body axes.
            rotation: ``rotation(alpha)`` (then parameters) -> (3, 3), the rotation from
                its own axes to body axes [1].
            force: ``force(t, alpha, alpha_dot)`` (then parameters) -> (n,),
                generalized forces [J per unit of alpha]; left out, none.
            potential: ``potential(alpha)`` (then parameters) -> energy of springs [J];
                its forces are added, and it counts in the energy.
            parameters: Tree of numbers that the functions depend on; differentiable.
            coordinates: n; left out, it is found from the functions.

        Raises:
            FieldError: numbers that no body can have, functions whose shapes do not
                fit, a number of coordinates that cannot be found.
        """
        self.mass = positive("SupportedBody.mass", mass, (), "the mass in kg")
        self.inertia = checked_inertia("SupportedBody.inertia", inertia)
        shapes = {"position": (3,), "rotation": (3, 3)}
        given = {
            "position": position,
            "rotation": rotation,
            "force": force,
            "potential": potential,
        }
        made = functions_of("SupportedBody", given, shapes, parameters, coordinates)
        self.count, self.parameters = made.count, made.parameters
        self.position = made.functions["position"]
        self.rotation = made.functions["rotation"]
        check_rotation(
            "SupportedBody.rotation",
            self.rotation.of(self.parameters),
            np.outer([0.0, 0.3, -1.1], 1.0 + 0.4 * np.arange(made.count)),
            "its own axes on body axes",
        )
        self.force = made.functions["force"]
        self.potential = made.functions["potential"]

    def carried(
        self, t: Array, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
    ) -> Carried:
        """The body at one instant."""
        del t
        position = self.position.of(self.parameters)
        place, velocity, bias, partials = moved(position, alpha, alpha_dot)
        turned = moved(self.rotation.of(self.parameters), alpha, alpha_dot)
        return Carried(
            self.mass[None],
            place[:, None],
            velocity[:, None],
            bias[:, None],
            tuple(p[:, None] for p in partials),
            (turning_of(self.inertia, *turned),),
        )


class Prescribed(AbstractSupported):
    """Something carried whose coordinates are given functions of time.

    Attributes:
        supported: What is carried.
        motion: The user's function t -> alpha, (n,).
        count: 0: no coordinate is left to be found.
    """

    supported: PointMasses | SupportedBody
    motion: UserFunction
    count: int = eqx.field(static=True)

    def __init__(
        self,
        supported: PointMasses | SupportedBody,
        motion: Callable[..., Any],
        parameters: Any = None,
    ):
        """Prescribe a motion.

        Args:
            supported: ``PointMasses`` or ``SupportedBody``; its force is whatever the
                motion needs, and its own is not used.
            motion: ``motion(t)`` (then parameters) -> alpha, shape (n,), of the time
                t [s]; twice differentiable.
            parameters: Tree of numbers that it depends on; differentiable.

        Raises:
            FieldError: something else, or a motion of another shape.
        """
        if not isinstance(cast(object, supported), (PointMasses, SupportedBody)):
            raise FieldError(
                "Prescribed.supported",
                supported,
                "must be PointMasses or a SupportedBody",
                "give what moves, then its motion",
            )
        self.supported, self.count = supported, 0
        field = "Prescribed.motion"
        self.motion = UserFunction(field, motion, 1, parameters)
        check_output(field, self.motion, (1,), (supported.count,))

    @property
    def part(self) -> PointMasses | SupportedBody:
        """What is carried."""
        return self.supported

    def carried(
        self, t: Array, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
    ) -> Carried:
        """The masses at one instant, without coordinates."""
        del alpha, alpha_dot
        t = as_time(t)

        def rate(t: Float[Array, ""]) -> tuple[Array, Array]:
            motion: Callable[[Array], Array] = lambda t: self.motion(t[None])
            return jax.jvp(motion, (t,), (jnp.ones_like(t),))

        (alpha, alpha_dot), (_, second) = jax.jvp(rate, (t,), (jnp.ones_like(t),))
        own = self.supported.carried(t, alpha, alpha_dot)
        pushes = components(second)
        turnings = tuple(
            dataclasses.replace(
                turning,
                bias=_pushed(turning.bias, turning.partials, pushes),
                partials=(),
                driven=turning.velocity,
            )
            for turning in own.turnings
        )
        bias = _pushed(own.bias, own.partials, pushes)
        velocity = own.velocity
        return Carried(
            own.mass, own.place, velocity, bias, (), turnings, driven=velocity
        )

    def generalized_force(
        self, t: Array, alpha: Float[Array, " n"], alpha_dot: Float[Array, " n"]
    ) -> None:
        """None: the drive gives whatever force the motion needs."""
        del t, alpha, alpha_dot

    def potential_energy(self, alpha: Float[Array, " n"]) -> None:
        """None: what the drive stores is not counted."""
        del alpha

    @property
    def does_work(self) -> bool:
        """True: the drive does."""
        return True


def _pushed(
    bias: Array, partials: tuple[Array, ...], accelerations: list[Array]
) -> Array:
    """Bias with prescribed accelerations of the coordinates."""
    for partial, acceleration in zip(partials, accelerations, strict=True):
        bias = bias + partial * acceleration
    return bias


def total(vectors: Float[Array, "3 k"]) -> Float[Array, "3"]:
    """Sum over the masses; unrolled where they are few."""
    columns = components(vectors.T) if vectors.shape[1] <= 8 else None
    if columns is None:
        return jnp.sum(vectors, axis=1)
    return sum(columns[1:], columns[0])
