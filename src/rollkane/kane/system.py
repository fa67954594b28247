"""A mechanical system in the terms of Kane's method: coordinates, speeds, parts, loads.

Every function of the user's takes ``(t, q, u)``, then the parameters if it wants them:
time [s], generalized coordinates and generalized speeds; it returns an array, or a
list of numbers. Velocities are affine in the
speeds; nothing is derived by hand, partial velocities and accelerations are theirs.
"""

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..validation.checks import FieldError, checked_kinks
from ..validation.user_functions import GivenFunction, as_floats, numbers_of
from .parts import Load, Particle, RigidBody, checked_load, checked_part
from .system_arguments import (
    bound_by,
    chosen_numbers,
    counts_of,
    in_a_row,
    names_of_rows,
    one_each,
    refuse_no_rows,
)

# What a user gives for numbers: one, an array, sequences of them.
Numbers: TypeAlias = ArrayLike | Sequence[Any]
# A function of the user's of (t, q, u), and of the parameters if it takes them.
Motion: TypeAlias = Callable[..., Any]


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
            constraints, among which their rates have to be; starts fulfil them, and
            linearization follows them.
        coordinates: Number of generalized coordinates.
        speeds: Number of generalized speeds, dependent ones included.
        dependent: Which speeds the constraints determine.
        dependent_coordinates: Which coordinates the configuration constraints do.
        auxiliary: How many speeds at the end are auxiliary: they are zero, and their
            equations give the reactions against them.
        projection: Function of (t, q, u) -> (n,): the coordinates on the configuration
            that are nearest to q; None: a motion's coordinates are not projected.
        implied: What follows from constraints and configuration, function of (t, q, u)
            -> (k,); a motion ends where it is not zero. None for none.
        implied_names: Of its rows, for errors and reasons.
        by_multipliers: Whether the constraints act by multipliers: no speeds are
            chosen as dependent, and all are in the state.
        parameters: Numbers that the functions depend on.
        shared: What several functions need, evaluated once; None for none.
        kinks: Times at which functions of time jump [s]; None: none are known.
        side: Of a motion's system, one over the least determinant that the constraints
            may have of the dependent speeds, with its sign, and over the least lengths
            of their rows; None: of no motion.
    """

    kinematics: GivenFunction
    parts: tuple[Particle | RigidBody, ...]
    loads: tuple[Load, ...]
    generalized_forces: GivenFunction | None
    constraints: GivenFunction | None
    configuration: GivenFunction | None
    projection: GivenFunction | None
    implied: GivenFunction | None
    parameters: Any
    shared: GivenFunction | None
    kinks: Float[Array, " k"] | None
    side: Float[Array, " r"] | None
    coordinates: int = eqx.field(static=True)
    speeds: int = eqx.field(static=True)
    dependent: tuple[int, ...] = eqx.field(static=True)
    dependent_coordinates: tuple[int, ...] = eqx.field(static=True)
    auxiliary: int = eqx.field(static=True)
    by_multipliers: bool = eqx.field(static=True)
    implied_names: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        coordinates: int,
        speeds: int,
        kinematics: Motion,
        parts: Iterable[Particle | RigidBody] = (),
        loads: Iterable[Load] = (),
        constraints: Motion | None = None,
        dependent: Iterable[int] | None = (),
        configuration: Motion | None = None,
        dependent_coordinates: Iterable[int] = (),
        auxiliary: int = 0,
        generalized_forces: Motion | None = None,
        parameters: Any = None,
        shared: Motion | None = None,
        projection: Motion | None = None,
        implied: Motion | None = None,
        implied_names: Iterable[str] = (),
        kinks: Any = None,
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
                there are constraints. None: none are chosen, and the constraints act
                by multipliers, so that a motion may pass where a choice would fail; the
                state then has all speeds, of a start the nearest (by their energy) that
                the constraints allow.
            configuration: ``configuration(t, q, u)`` -> what has to be zero, without
                using u; its rate must be among the constraints. ``simulate`` and
                ``linearize`` see to both.
            dependent_coordinates: Numbers of the coordinates that it determines.
            auxiliary: Number of auxiliary speeds; every function gets them behind the
                others. A constraint that names one keeps holding while it moves, by the
                dependent speeds; one that does not, gives way (see ``reactions``).
            generalized_forces: Function of (t, q, u) -> one force for each speed [J per
                unit of the integral of the speed], the auxiliary ones last: what is
                easier said in coordinates than by points (springs, dampers, motors).
            parameters: Tree of numbers; given to each function that takes a fourth
                argument (None without), and to masses and inertias that are functions.
                A number of theirs that is also given to a part as it is stays behind
                where the parameters are varied.
            shared: Function of (t, q, u, parameters) -> what several of the others
                need (rotations, a contact): evaluated once, and given to them in
                place of the parameters.
            projection: ``projection(t, q, u)`` -> the coordinates that fulfil the
                configuration next to q; without using u, and q itself where q does.
            implied: ``implied(t, q, u)`` -> constraints of coordinates and of
                speeds that were left out, as they follow from the others: where they no
                longer do, a motion ends with ``Code.NO_LONGER_REDUNDANT``.
            implied_names: What they are called, one each.
            kinks: Times [s] at which a load or another function of time jumps or
                begins, shape (k,): steps end before each and begin behind it, so that
                no pulse is missed. They must not depend on what you differentiate by.

        Raises:
            FieldError: shapes that do not fit, dependent speeds that are not there,
                masses or inertias that no body can have, a configuration that looks at
                the speeds.
        """
        sizes = counts_of(coordinates=coordinates, speeds=speeds, auxiliary=auxiliary)
        self.coordinates, self.speeds, self.auxiliary = sizes
        self.parameters = as_floats(parameters)
        self.kinks, self.side = checked_kinks("KaneSystem.kinks", kinks), None
        example = (jnp.zeros(()), jnp.zeros(coordinates), jnp.zeros(speeds + auxiliary))
        more, source = self.parameters, "parameters"
        self.shared = None
        if shared is not None:
            self.shared = GivenFunction(
                "KaneSystem.shared", shared, None, example, more, "(t, q, u)"
            )
            more = cast(Any, eqx.filter_eval_shape(self.shared, *example, more))
            source = "shared"

        def motion(
            field: str, function: Any, shape: tuple[int, ...] | None
        ) -> GivenFunction:
            arguments = example, more, "(t, q, u)", source
            return GivenFunction(field, function, shape, *arguments)

        self.kinematics = motion("KaneSystem.kinematics", kinematics, (coordinates,))
        self.parts = tuple(
            checked_part(f"KaneSystem.parts[{k}]", part, motion, self.parameters)
            for k, part in enumerate(in_a_row("KaneSystem.parts", parts))
        )
        self.loads = tuple(
            checked_load(f"KaneSystem.loads[{k}]", load, motion)
            for k, load in enumerate(in_a_row("KaneSystem.loads", loads))
        )
        self.generalized_forces = None
        if generalized_forces is not None:
            field, size = "KaneSystem.generalized_forces", example[2].shape
            self.generalized_forces = motion(field, generalized_forces, size)
        self.by_multipliers = dependent is None
        self.dependent = chosen_numbers("KaneSystem.dependent", dependent, speeds)
        if constraints is not None and self.by_multipliers:
            self.constraints = motion("KaneSystem.constraints", constraints, None)
        else:
            self.constraints = bound_by(
                motion, "constraints", constraints, "dependent", self.dependent
            )
        self.dependent_coordinates = chosen_numbers(
            "KaneSystem.dependent_coordinates", dependent_coordinates, coordinates
        )
        self.configuration = bound_by(
            motion,
            "configuration",
            configuration,
            "dependent_coordinates",
            self.dependent_coordinates,
        )
        self.projection = None
        if projection is not None:
            field = "KaneSystem.projection"
            self.projection = motion(field, projection, (coordinates,))
        self.implied_names = names_of_rows(implied_names)
        self.implied = one_each(
            motion, "implied", implied, "implied_names", self.implied_names
        )
        _refuse_rows(self, (constraints, configuration), *example)

    def more(self, t: Array, q: Array, u: Array) -> Any:
        """What the functions get behind (t, q, u)."""
        if self.shared is None:
            return self.parameters
        return self.shared(t, q, u, self.parameters)

    def at(self, function: GivenFunction, t: Array, q: Array, u: Array) -> Array:
        """The value of one of its functions."""
        return function(t, q, u, self.more(t, q, u))

    def number(self, given: Any) -> Array:
        """A mass or an inertia of a part, whichever way it is given."""
        if not isinstance(given, GivenFunction):
            return given
        return given(self.parameters, None)

    @property
    def constraint_count(self) -> int:
        """How many velocity constraints there are, whatever they determine."""
        if self.constraints is None:
            return 0
        bound = functools.partial(self.at, self.constraints)
        sizes = (), (self.coordinates,), (self.speeds + self.auxiliary,)
        return jax.eval_shape(bound, *(numbers_of(size) for size in sizes)).shape[0]

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
        q: Generalized coordinates [m] or [rad], as the system has them, shape (n,).
        u: INDEPENDENT generalized speeds [m/s] or [rad/s], shape (m,).
    """

    q: Float[Array, " n"]
    u: Float[Array, " m"]


def _refuse_rows(
    system: KaneSystem, rows: tuple[Any, Any], t: Array, q: Array, u: Array
) -> None:
    """Refuse constraints without a row, and a configuration that looks at speeds."""
    constraints, given = rows
    if system.constraints is not None:
        refuse_no_rows(system.constraint_count, constraints)
    wrapped = system.configuration
    if wrapped is None:
        return
    try:
        looks = _depends(lambda u: system.at(wrapped, t, q, u), u)
    except Exception as error:
        raise FieldError(
            "KaneSystem.configuration",
            given,
            f"cannot be mapped by JAX ({error})",
            "write it by jax.numpy operations",
        ) from error
    if looks:
        raise FieldError(
            "KaneSystem.configuration",
            given,
            "looks at the speeds u",
            "write it in t and q alone, and what is said of speeds into constraints "
            "(`shared` must not hand it coordinates and speeds in one array)",
        )


def _depends(function: Callable[[Array], Any], argument: Array) -> bool:
    """Whether a value is computed from an argument, found by tracing.

    A map over the argument knows what it maps: in a program that holds others, too, and
    where a derivative would vanish by chance.
    """
    mapped: list[bool] = []

    @jax.custom_batching.custom_vmap
    def seen(value: Any) -> Any:
        return value

    @seen.def_vmap
    def _(size: int, batched: list[bool], value: Any) -> tuple[Any, bool]:
        del size
        mapped.append(batched[0])
        return value, batched[0]

    def looked_at(x: Array) -> Any:
        return seen(function(x))

    some = jax.ShapeDtypeStruct((2, *argument.shape), argument.dtype)
    jax.eval_shape(jax.vmap(looked_at), some)
    return any(mapped)
