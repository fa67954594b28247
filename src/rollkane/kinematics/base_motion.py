"""Motion of the base: functions of time, a steady turn, and their values at an instant.

The contact needs the base's pose, velocity and acceleration at a time; all three come
from one evaluation (:class:`BaseKinematics`), and what does not move is None, so that a
base that only shakes has no rotation in its program, and one that only turns no
translation.
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..codegen.compile_effort import stays_as_it_is
from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matmul,
    matvec,
    matvec_transposed,
)
from ..validation.checks import FieldError, checked_kinks, real, refuse
from ..validation.remembered import remembered
from ..validation.user_functions import (
    UserFunction,
    as_floats,
    as_time,
    check_output,
    check_rotation,
)


class BaseKinematics(eqx.Module):
    """Pose, velocity and acceleration of the base at one instant; None stands for zero.

    Attributes:
        position: ``r_Oc``, base origin [m], fixed axes, shape (3,).
        rotation: ``A_c``, base to fixed axes [1], shape (3, 3); None: axes agree.
        velocity: Of the base origin [m/s], fixed axes, shape (3,).
        acceleration: Of the base origin [m/s^2], fixed axes, shape (3,).
        angular_velocity: ``(p_c, q_c, r_c)`` [rad/s], BASE axes, shape (3,).
        angular_acceleration: Its rate [rad/s^2], BASE axes, shape (3,).

    Source: [A] (1.2); docs/theory.md, (1.5).
    """

    position: Float[Array, "3"] | None = None
    rotation: Float[Array, "3 3"] | None = None
    velocity: Float[Array, "3"] | None = None
    acceleration: Float[Array, "3"] | None = None
    angular_velocity: Float[Array, "3"] | None = None
    angular_acceleration: Float[Array, "3"] | None = None

    def to_fixed(self, vector: Float[Array, "3"]) -> Float[Array, "3"]:
        """A vector on base axes, on fixed axes."""
        return vector if self.rotation is None else matvec(self.rotation, vector)

    def to_base(self, vector: Float[Array, "3"]) -> Float[Array, "3"]:
        """A vector on fixed axes, on base axes."""
        if self.rotation is None:
            return vector
        return matvec_transposed(self.rotation, vector)

    def placed(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Fixed axes [m] of a point given on base axes from the base origin [m]."""
        point = self.to_fixed(point)
        return point if self.position is None else self.position + point

    def on_base(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Base axes, from the base origin [m], of a point on fixed axes [m]."""
        return self.to_base(point - (0.0 if self.position is None else self.position))

    @property
    def origin_velocity(self) -> Float[Array, "3"] | None:
        """``(k_c, l_c, m_c)``, of the base origin [m/s], BASE axes ([A] (1.2))."""
        return None if self.velocity is None else self.to_base(self.velocity)

    def velocity_at(self, point: Float[Array, "3"]) -> Float[Array, "3"] | None:
        """``(f_1, f_2, f_3)``, of the base's material point [m/s], BASE axes.

        Args:
            point: ``rho_c`` [m], base axes.

        Source: [A] (1.3), ``f = A_c^T v_Oc + w_c x rho_c``.
        """
        spin = self.angular_velocity
        return _sum(self.origin_velocity, None if spin is None else cross(spin, point))

    def acceleration_at(self, point: Float[Array, "3"]) -> Float[Array, "3"] | None:
        """``a_b``, acceleration of the base's material point [m/s^2], BASE axes.

        Source: docs/theory.md, (1.6), ``a_Oc + w_c' x rho_c + w_c x (w_c x rho_c)``.
        """
        spin, change = self.angular_velocity, self.angular_acceleration
        return _sum(
            None if self.acceleration is None else self.to_base(self.acceleration),
            None if change is None else cross(change, point),
            None if spin is None else cross(spin, cross(spin, point)),
        )


def _sum(*terms: Array | None) -> Array | None:
    total = None
    for term in terms:
        if term is not None:
            total = term if total is None else total + term
    return total


# How many numbers steps stay away from a time at which a function of a user's jumps:
# that one may divide (floor(t / h)) and subtract before it looks, a rounding each, and
# the time itself is a product (k h) of one
BESIDE_JUMPS = 4


class AbstractBaseMotion(eqx.Module):
    """How a base moves in time."""

    turns_steadily: ClassVar[bool] = False  # about its own z axis, and nothing else

    @abc.abstractmethod
    def at(self, t: Float[Array, ""]) -> BaseKinematics:
        """Pose, velocity and acceleration at a time [s]."""

    @property
    def kinks(self) -> Float[Array, " k"] | None:
        """Times [s] at which a derivative of the motion jumps; None for none.

        The integrator ends a step on each, so that its order is kept.
        """
        return None

    @property
    def kept_away(self) -> int:
        """How many numbers before each kink steps end, and begin behind it.

        For an acceleration, or a derivative of it, that may jump there; 0: they end on
        the kink.
        """
        return 0

    @property
    def span(self) -> tuple[Array, Array] | None:
        """First and last time [s] at which the motion is known; None for all."""
        return None

    def for_runs(self) -> "AbstractBaseMotion":
        """The same motion as a run takes it: with what is computed once, ahead of it.

        Its numbers are as many arrays, in the same order, each bad where the one of
        this motion is.
        """
        return self


@remembered(stays_as_it_is)
def _made_ready(model: Any) -> Any:
    """A model with its motions as runs take them; None where they are so already."""
    leaves, tree = cast(
        "tuple[list[Any], Any]", jax.tree.flatten(model, is_leaf=_is_motion)
    )
    ready = [x.for_runs() if _is_motion(x) else x for x in leaves]
    same = all(a is b for a, b in zip(leaves, ready, strict=True))
    return None if same else jax.tree.unflatten(tree, ready)


def _is_motion(x: Any) -> bool:
    return isinstance(x, AbstractBaseMotion)


def ready_for_runs(model: Any) -> Any:
    """A model, such as a scene, with its motions of bases as runs take them."""
    ready = _made_ready(model)
    return model if ready is None else ready


class BaseMotion(AbstractBaseMotion):
    """A motion by functions of time; their derivatives are automatic.

    Attributes:
        position: Base origin as a function of time [m], or None.
        rotation: Base to fixed axes as a function of time [1], or None.
        parameters: Tree of numbers that both take last, or None.
        given_kinks: Times at which a derivative jumps [s], or None.
    """

    position: UserFunction | None
    rotation: UserFunction | None
    parameters: Any
    given_kinks: Float[Array, " k"] | None

    def __init__(
        self,
        position: Callable[..., Any] | None = None,
        rotation: Callable[..., Any] | None = None,
        parameters: Any = None,
        kinks: Any = None,
    ):
        """Make a motion.

        Args:
            position: ``position(t)`` or ``position(t, parameters)`` -> (3,) [m], fixed
                axes, the place of the base origin; left out, it stays at the origin.
            rotation: ``rotation(t)`` or ``rotation(t, parameters)`` -> (3, 3), the
                rotation from base axes to fixed axes [1]; left out, the axes agree.
            parameters: Tree of numbers that both depend on; differentiable.
            kinks: Times [s] at which an acceleration or its rate jumps, shape (k,);
                steps end before each and begin behind it. They must not depend on what
                you differentiate by.

        Raises:
            FieldError: neither function, one of another shape or signature, a rotation
                that is not a rotation.

        Both are written with jax.numpy and twice differentiable.
        """
        if position is None and rotation is None:
            raise FieldError(
                "BaseMotion.position",
                None,
                "and BaseMotion.rotation are both missing",
                "give a function of time, or Base(surface, motion=None) for a base "
                "at rest",
            )
        self.position = self.rotation = None
        self.parameters = as_floats(parameters)
        given = self.parameters
        if position is not None:
            field = "BaseMotion.position"
            self.position = UserFunction(field, position, 1, given, shared=True)
            check_output(field, _of_time(self.position, given), (), (3,))
        if rotation is not None:
            field = "BaseMotion.rotation"
            self.rotation = UserFunction(field, rotation, 1, given, shared=True)
            check_output(field, _of_time(self.rotation, given), (), (3, 3))
            check_rotation(
                field,
                _of_time(self.rotation, given),
                np.array([0.0, 1e-3, 0.1, 0.7, 3.1, 17.0, 101.0]),
                "the base axes on fixed axes",
            )
        self.given_kinks = checked_kinks("BaseMotion.kinks", kinks)

    @property
    def kinks(self) -> Float[Array, " k"] | None:
        """Times at which a derivative jumps [s]."""
        return self.given_kinks

    @property
    def kept_away(self) -> int:
        """So many that functions of a user's are beside the jump, too."""
        return BESIDE_JUMPS

    def at(self, t: Float[Array, ""]) -> BaseKinematics:
        """Pose, velocity and acceleration at a time [s], by nested derivatives."""
        t = as_time(t)
        place = turn = (None, None, None)
        spin = change = None
        if self.position is not None:
            place = _twice(_of_time(self.position, self.parameters), t)
        if self.rotation is not None:
            turn = _twice(_of_time(self.rotation, self.parameters), t)
            spin, change = _turning(*turn)
        return BaseKinematics(place[0], turn[0], place[1], place[2], spin, change)


def _of_time(function: UserFunction, parameters: Any) -> Callable[[Array], Array]:
    """A user's function as one of a scalar, with an array for a nested sequence."""

    def value(t: Array) -> Array:
        # the user's, which may be a sequence
        result: Any = function(t[None], parameters)
        if isinstance(result, (tuple, list)):
            result = jnp.asarray(result, jnp.result_type(t))
        return result

    value.__name__ = function.__name__
    return value


def _twice(function: Callable[[Array], Array], t: Array) -> tuple[Array, Array, Array]:
    """A function of time with its first and second derivative."""
    one = jnp.ones_like(t)

    def once(t: Array) -> tuple[Array, Array]:
        return jax.jvp(function, (t,), (one,))

    (value, rate), (_, second) = jax.jvp(once, (t,), (one,))
    return value, rate, second


def _turning(
    A: Float[Array, "3 3"], A_dot: Float[Array, "3 3"], A_ddot: Float[Array, "3 3"]
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Angular velocity and acceleration on base axes from a rotation's derivatives.

    ``A^T A' = skew(w)`` and ``A^T A'' = skew(w') + skew(w)^2``.
    """
    columns = components(A.T)

    def entry(rates: Array, i: int, j: int) -> Array:
        return dot(columns[i], rates[:, j])

    w = [entry(A_dot, 2, 1), entry(A_dot, 0, 2), entry(A_dot, 1, 0)]
    w_dot = [
        entry(A_ddot, 2, 1) - w[1] * w[2],
        entry(A_ddot, 0, 2) - w[2] * w[0],
        entry(A_ddot, 1, 0) - w[0] * w[1],
    ]
    return jnp.stack(w), jnp.stack(w_dot)


class Spin(AbstractBaseMotion):
    """A steady turn about the base's own z axis.

    Attributes:
        rate: [rad/s], positive from x to y.
        orientation: Quaternion of the base axes at t = 0, scalar first, base to fixed
            [1], shape (4,); None: they agree with the fixed axes then.
        position: Base origin [m], fixed axes, shape (3,); None: the fixed origin.
    """

    turns_steadily: ClassVar[bool] = True
    rate: Float[Array, ""]
    orientation: Float[Array, "4"] | None
    position: Float[Array, "3"] | None

    def __init__(self, rate: ArrayLike, orientation: Any = None, position: Any = None):
        """Make a turntable.

        Args:
            rate: The angular velocity [rad/s]. Positive from the base's x axis to its y
                axis.
            orientation: Quaternion of the base axes at t = 0, scalar first, base to
                fixed axes [1], shape (4,): a tilted turntable turns about its own
                tilted axis. Left out, they agree with the fixed axes at t = 0.
            position: Three lengths: the base origin in fixed axes [m]. Left out, the
                fixed origin.

        Raises:
            FieldError: numbers of another shape, a quaternion of length zero.
        """
        self.rate = real("Spin.rate", rate, (), "an angular velocity in rad/s")
        self.orientation = self.position = None
        if orientation is not None:
            field = "Spin.orientation"
            self.orientation = refuse(
                real(field, orientation, (4,), "a unit quaternion, scalar first"),
                lambda q: ~(abs((q * q).sum() - 1.0) < 1e-3),
                field,
                "must be a quaternion of unit length",
                "divide it by its length; scalar first, base to fixed axes",
            )
        if position is not None:
            meaning = "three lengths in metres"
            self.position = real("Spin.position", position, (3,), meaning)

    def at(self, t: Float[Array, ""]) -> BaseKinematics:
        """Pose and angular velocity at a time [s]."""
        t = as_time(t)
        c, s = jnp.cos(self.rate * t), jnp.sin(self.rate * t)
        zero, one = jnp.zeros_like(c), jnp.ones_like(c)
        rotation = jnp.stack(
            [
                jnp.stack([c, -s, zero]),
                jnp.stack([s, c, zero]),
                jnp.stack([zero, zero, one]),
            ]
        )
        if self.orientation is not None:
            rotation = matmul(rotation_matrix(self.orientation), rotation)
        rate = self.rate * one  # of the dtype and shape of time
        return BaseKinematics(
            position=self.position,
            rotation=rotation,
            angular_velocity=jnp.stack([zero, zero, rate]),
        )
