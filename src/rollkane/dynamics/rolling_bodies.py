"""Bodies that roll on, or in, the body that carries them: nested to any depth.

What such a body is to its carrier is what any supported part is: masses with
velocities that are affine in quasi-velocities of its own. These are its angular
velocity relative to the carrier, in place of rates of coordinates.
"""

from collections.abc import Callable, Sequence
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.rotations import rotation_matrix, tangent_pair
from ..geometry.small_linear import components, dot, matmul, matvec, norm
from ..geometry.surfaces import AbstractSurface
from ..kinematics.contact import Contact
from ..kinematics.coordinates import SlidingState, State, shared_parts
from ..validation.checks import FieldError, is_traced, real
from ..validation.user_functions import GivenFunction, as_floats
from .abstract_supported import (
    AbstractRollingPart,
    AbstractSupported,
    rates_of_rolling,
    rolling_parts,
)
from .bodies import Body, Vector
from .carried import Carried, Pairing, Turning, rolling_with
from .placement import place
from .rolling import contact_of
from .scene import Base, Rolling, Scene


class RollingBody(AbstractRollingPart):
    """A rigid body that rolls without slipping on a surface fixed in its carrier.

    Inside of it or outside, with parts of its own that may roll in turn. Its motion is
    a :class:`State` relative to the carrier: ``State.supported`` of the carrier holds
    one for each rolling body, in their order. In it "base" and "fixed axes" are those
    of the surface: ``orientation`` turns the body's axes to the surface's, and
    ``angular_velocity`` is relative to the carrier, on the BODY's own axes.

    Attributes:
        body: The body that rolls.
        on: Surface of the carrier on which it rolls, on axes of its own.
        supported: What the body carries in turn.
        contact: ``Rolling()`` or ``RubberRolling()``.
        position: Origin of the surface's axes in the carrier [m], carrier axes, shape
            (3,); None: the carrier's origin.
        rotation: Unit quaternion, scalar first, surface to carrier axes [1], shape
            (4,); None: the same axes.
        torque: The user's function, or None.
        parameters: Numbers that it depends on.
        count: Number of its quasi-velocities: 3 of its own (2 without spin), and those
            of what it carries.

    Source: docs/theory.md, (4.6) to (4.8).
    """

    body: Body
    on: AbstractSurface
    supported: tuple[AbstractSupported, ...]
    contact: Rolling
    position: Float[Array, "3"] | None
    rotation: Float[Array, "4"] | None
    torque: Any
    parameters: Any
    count: int = eqx.field(static=True)

    def __init__(
        self,
        body: Body,
        on: AbstractSurface,
        supported: Any = (),
        contact: Rolling | None = None,
        position: Vector | None = None,
        rotation: Any = None,
        torque: Callable[..., Any] | None = None,
        parameters: Any = None,
    ):
        """Make a body that rolls on its carrier.

        Args:
            body: The body that rolls.
            on: Surface on which it rolls, fixed in the carrier; its normal points out
                of the carrier's material (a cavity: ``inside=True``).
            supported: What the body carries in turn: any parts that a scene may have.
            contact: ``Rolling()`` when left out, or ``RubberRolling()``: without spin
                about the normal, relative to the carrier.
            position: Origin of the surface's axes [m], carrier axes.
            rotation: Unit quaternion, scalar first, surface to carrier axes [1].
            torque: ``torque(t, state)`` (then parameters) -> (3,), torque of a drive
                in the carrier on the body [N m], BODY axes, of the time [s] and the
                body's ``State``; the carrier feels its opposite.
            parameters: Tree of numbers for the function, differentiable.

        Raises:
            FieldError: parts of another kind, a contact law that does not roll,
                numbers that are no rotation.
        """
        contact = Rolling() if contact is None else contact
        if not isinstance(cast(object, contact), Rolling):
            remedy = "give Rolling() or RubberRolling()"
            raise FieldError("RollingBody.contact", contact, "does not roll", remedy)
        try:
            pair = Scene(body, Base(on), supported, (), contact)
        except FieldError as error:
            raise _of_rolling_body(error) from error
        self.body, self.on, self.supported = body, on, pair.supported
        self.contact = contact
        self.position = self.rotation = None
        if position is not None:
            meaning = "three lengths in metres, carrier axes"
            self.position = real("RollingBody.position", position, (3,), meaning)
        if rotation is not None:
            self.rotation = _unit("RollingBody.rotation", rotation)
        self.parameters = as_floats(parameters)
        own = 2 if contact.without_spin else 3
        self.count = own + sum(part.count for part in pair.supported)
        self.torque = None
        if torque is not None:
            example = jnp.zeros(()), example_state(pair)
            field, meaning = "RollingBody.torque", "(t, state)"
            self.torque = GivenFunction(
                field, torque, (3,), example, self.parameters, meaning
            )

    @property
    def scene(self) -> Scene:
        """The pair alone: this body on the carrier's surface, without loads.

        Its "fixed axes" are the surface's.
        """
        return Scene(self.body, Base(self.on), self.supported, (), self.contact)

    def place(self, *arguments: Any, **options: Any) -> State:
        """Its state relative to the carrier: :func:`rollkane.place` in its ``scene``.

        With the orientation relative to the surface's axes, the angular velocity
        relative to the carrier, on the surface's axes, and the contact point on these.

        Args:
            *arguments: As of ``rollkane.place`` after the scene.
            **options: As of ``rollkane.place``.

        Raises:
            FieldError: as ``rollkane.place``.
        """
        return place(self.scene, *arguments, **options)

    def pairing(self, t: Array, state: State, parts: Sequence[Carried]) -> Pairing:
        """How it touches its carrier.

        Args:
            t: Time [s].
            state: Its own.
            parts: What moves with it, itself first.

        Source: docs/theory.md, (4.8) where it does not spin.
        """
        contact = contact_of(self.scene, t, state)
        rotation, place = contact.rotation, contact.base_point
        if self.rotation is not None:
            to_carrier = rotation_matrix(self.rotation)
            rotation, place = matmul(to_carrier, rotation), matvec(to_carrier, place)
        if self.position is not None:
            place = self.position + place
        axes, turn_bias = self.axes(contact), None
        if self.contact.without_spin:
            N, rate = contact.normal, contact.normal_rate
            assert rate is not None
            turn_bias = -dot(contact.angular_velocity, rate) * N
        masses = sum(part.mass.shape[0] for part in parts)
        inner = tuple(part.pairing for part in parts if part.pairing is not None)
        return Pairing(
            contact, rotation, place, axes, turn_bias, masses, self.rotation, inner
        )

    def carried(self, t: Array, alpha: Any, alpha_dot: Any) -> Carried:
        """Everything that moves with it, at one instant, on the CARRIER's axes.

        Args:
            t: Time [s].
            alpha: Its ``State``.
            alpha_dot: Not used: the state has its quasi-velocities.

        Source: docs/theory.md, (4.6), (4.7).
        """
        del alpha_dot
        state: State = alpha
        parts = [_alone(self.body)]
        parts += [part.carried(t, *own) for part, *own in self.scene.shares(state)]
        return rolling_with(self.pairing(t, state, parts), parts)

    def velocities(self, t: Array, state: State) -> list[Array]:
        """Its quasi-velocities, and those of what it carries.

        Args:
            t: Time [s].
            state: Its own.
        """
        contact = contact_of(self.scene, t, state)
        u = contact.angular_velocity
        found = [dot(e, u) for e in self.axes(contact)]
        found += components(state.alpha_dot)
        bodies = rolling_parts(self.supported)
        for part, own in zip(bodies, state.supported, strict=True):
            found += part.velocities(t, own)
        return found

    def axes(self, contact: Contact) -> tuple[Array, ...]:
        """Along which its relative angular velocity may be, its own axes.

        Args:
            contact: Of the pair.
        """
        if self.contact.without_spin:
            return tangent_pair(contact.normal)
        return tuple(jnp.eye(3, dtype=contact.normal.dtype))

    def rates(
        self, state: State, pairing: Pairing, accelerations: Sequence[Array]
    ) -> State:
        """Rates of its state.

        Args:
            state: Its own.
            pairing: Its contact.
            accelerations: Of its quasi-velocities, and of those of what it carries.
        """
        own, n = len(pairing.axes), state.alpha_dot.shape[0]
        parts = [e * x for e, x in zip(pairing.axes, accelerations[:own], strict=True)]
        turn = sum(parts[1:], parts[0])
        if pairing.turn_bias is not None:
            turn = turn + pairing.turn_bias
        alpha_ddot = jnp.stack(accelerations[own : own + n]) if n else state.alpha_dot
        inner = rates_of_rolling(
            self.supported, state.supported, pairing.inner, accelerations[own + n :]
        )
        return state.rates(pairing.contact, turn, alpha_ddot, supported=inner)

    def generalized_force(self, t: Array, alpha: Any, alpha_dot: Any) -> None:
        """None: see :meth:`applied`, which needs the contact."""
        del t, alpha, alpha_dot

    def applied(
        self, t: Array, alpha: Any, alpha_dot: Array, pairing: Pairing | None = None
    ) -> list[Array] | None:
        """The torque along its own axes, and the forces of what it carries.

        Args:
            t: Time [s].
            alpha: Its ``State``.
            alpha_dot: Not used.
            pairing: Its contact.
        """
        del alpha_dot
        assert pairing is not None
        state, inner = cast(State, alpha), iter(pairing.inner)
        torque = None
        if self.torque is not None:
            torque = self.torque(t, state, self.parameters)
        zero = jnp.zeros_like(state.angular_velocity[0])
        forces = [zero if torque is None else dot(torque, e) for e in pairing.axes]
        anything = torque is not None
        for part, own, rates in self.scene.shares(state):
            rolls = isinstance(part, AbstractRollingPart)
            force = part.applied(t, own, rates, next(inner) if rolls else None)
            anything = anything or force is not None
            forces += [zero] * part.count if force is None else force
        return forces if anything else None

    def drive_power(self, t: Array, alpha: Any, alpha_dot: Array) -> Array | None:
        """Power of its torque, and of what it carries [W]; None: none.

        Args:
            t: Time [s].
            alpha: Its ``State``.
            alpha_dot: Not used.
        """
        del alpha_dot
        state = cast(State, alpha)
        powers = [part.drive_power(t, *own) for part, *own in self.scene.shares(state)]
        if self.torque is not None:
            torque = self.torque(t, state, self.parameters)
            u = contact_of(self.scene, t, state).angular_velocity
            powers.append(dot(torque, u))
        given = [power for power in powers if power is not None]
        return sum(given[1:], given[0]) if given else None

    def potential_energy(self, alpha: Any) -> Float[Array, ""] | None:
        """Of the springs of what it carries [J]; None: there are none."""
        listed = self.scene.shares(cast(State, alpha))
        stored = [part.potential_energy(own) for part, own, _ in listed]
        given = [energy for energy in stored if energy is not None]
        return sum(given[1:], given[0]) if given else None

    @property
    def does_work(self) -> bool:
        """Whether it is driven, or something that it carries is."""
        return self.torque is not None or any(p.does_work for p in self.supported)


def example_state(scene: Scene) -> State:
    """A state of the right shapes for a scene in contact, of no meaning."""
    n = scene.coordinate_count
    body = scene.body.surface.coordinate_count
    state = State(
        orientation=jnp.eye(4)[0],
        angular_velocity=jnp.zeros(3),
        contact_on_base=jnp.zeros(scene.base.surface.coordinate_count),
        contact_on_body=jnp.zeros(body if scene.has_contact_coordinates else 0),
        alpha=jnp.zeros(n),
        alpha_dot=jnp.zeros(n),
        supported=tuple(example_state(p.scene) for p in rolling_parts(scene.supported)),
    )
    if scene.contact.slips:
        return SlidingState(**shared_parts(state), slip=jnp.zeros(3))
    return state


def _alone(body: Body) -> Carried:
    """The rolling body itself, at rest on its own axes."""
    still = jnp.zeros_like(body.center_of_mass)
    turning = Turning(jnp.eye(3, dtype=still.dtype), body.inertia, still, still, ())
    return Carried(
        mass=body.mass[None],
        place=body.center_of_mass[:, None],
        velocity=still[:, None],
        bias=still[:, None],
        partials=(),
        turnings=(turning,),
    )


def _unit(field: str, value: Any) -> Array:
    """A unit quaternion; refused where its length is known to be another."""
    q = real(field, value, (4,), "a unit quaternion, scalar first")
    if not is_traced(q) and abs(np.linalg.norm(np.asarray(q)) - 1.0) > 1e-6:
        remedy = "divide it by its length"
        raise FieldError(field, value, "is no unit quaternion", remedy)
    return q / norm(q)


def _of_rolling_body(error: FieldError) -> FieldError:
    """The error of a pair, by the names of a rolling body."""
    names = {"Scene.body": "body", "Base.surface": "on"}
    last = names.get(error.field, error.field.removeprefix("Scene."))
    return FieldError(f"RollingBody.{last}", error.value, error.problem, error.remedy)
