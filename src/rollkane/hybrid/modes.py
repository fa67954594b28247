"""What a contact may do in a run that changes: roll, slip, fly; and its states."""

import dataclasses
import enum
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ..dynamics.directed_friction import DirectedFriction
from ..dynamics.scene import Flying, Rolling, RubberRolling, Scene, Slipping, under
from ..dynamics.slip_onset import onset_of
from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import matvec_transposed
from ..kinematics.coordinates import FlyingState, SlidingState, State, shared_parts
from ..validation.checks import (
    FieldError,
    flag,
    is_traced,
    not_negative,
    positive,
    refuse,
    whole,
)


class Mode(enum.IntEnum):
    """What the contact does: values of ``Trajectory.mode`` and of ``Switches``.

    Whole numbers, which arrays are compared with; ``Mode(2).name`` is ``"FLYING"``.
    """

    ROLLING = 0
    SLIPPING = 1
    FLYING = 2


IMPACT_LAWS = ("energetic", "newton")


class Modes(eqx.Module):
    """How a run may change between rolling, slipping and flight.

    An output at which N < 0 lifts off, the first one included, shows the state before:
    the contact, and the force that would have to pull.

    Attributes:
        friction: Coefficient of sliding friction [1]; None: the body never slips.
        static_friction: Of sticking [1]; None: the same, see :attr:`sticking`.
        lifts: Whether the contact ends where it would have to pull.
        restitution: Of a landing [1]; None: nothing lands.
        rest_speed: Slower rebounds stay in contact [m/s].
        impact: Law of restitution, ``"energetic"`` or ``"newton"``.
        switches: How many changes are kept; a run with more ends.
    """

    friction: Float[Array, ""] | None
    static_friction: Float[Array, ""] | None
    restitution: Float[Array, ""] | None
    rest_speed: Float[Array, ""]
    lifts: bool = eqx.field(static=True)
    switches: int = eqx.field(static=True)
    impact: str = eqx.field(static=True)

    def __init__(
        self,
        friction: ArrayLike | None = None,
        static_friction: ArrayLike | None = None,
        lifts: bool = True,
        restitution: ArrayLike | None = None,
        rest_speed: ArrayLike = 1e-3,
        switches: int = 64,
        impact: str = "energetic",
    ):
        """Make a choice.

        Args:
            friction: The coefficient of sliding friction [1], 0 or more; left out, the
                body never slips. A run ends with ``Code.PAINLEVE`` where it can then
                neither roll on nor leave.
            static_friction: That of sticking [1], friction or more; left out, the same.
            lifts: Whether the contact ends where it would have to pull. Where it does
                not, friction goes with the size of the normal force: derivatives behind
                such a place are known to the root of the tolerance.
            restitution: That of a landing [1], from 0 to 1; left out, nothing lands.
                None can give energy.
            rest_speed: The speed below which a rebound stays in contact [m/s],
                positive. So ever smaller ones come to their end. What rises no
                higher than the gap rounds stays, too: 4 mm/s of a ball of 0.1 m in
                single precision, 2e-7 m/s in double.
            switches: How many changes are kept, 1 or more. A run with more ends.
            impact: What the restitution is of: the energy of compression, or the normal
                velocity. ``"energetic"`` (Stronge): its square is the share of the work
                of compression that is given back; sliding and
                sticking follow the growing impulse (Routh), which pushes, lies in the
                friction cone and takes energy whatever the body. ``"newton"``: the
                ratio of the normal velocities, friction acting along the slip before
                the impact; a run ends with ``Code.INCONSISTENT_IMPACT`` where that
                would pull, turn the slip against its friction, or add energy. Of a ball
                whose mass centre is in its middle both are the same.

        Raises:
            FieldError: negative numbers, a restitution above one, sticking that holds
                less than sliding, an unknown law.
        """
        self.friction = self.static_friction = self.restitution = None
        unit = "without unit"
        if friction is not None:
            self.friction = not_negative("Modes.friction", friction, unit)
        elif static_friction is not None:
            raise FieldError(
                "Modes.static_friction",
                static_friction,
                "is of no use without friction: the body never slips",
                "give friction=, too",
            )
        if self.friction is not None and static_friction is not None:
            static = not_negative("Modes.static_friction", static_friction, unit)
            self.static_friction = refuse(
                static,
                static < self.friction,
                "Modes.static_friction",
                "is below that of sliding: a contact that grips would slip at once",
                "give as much as friction, or more",
            )
        if restitution is not None:
            self.restitution = refuse(
                not_negative("Modes.restitution", restitution, unit),
                lambda e: ~(e <= 1.0),
                "Modes.restitution",
                "must not be above 1: a rebound would give energy",
                "give a number from 0 (plastic) to 1 (elastic)",
            )
        self.rest_speed = positive("Modes.rest_speed", rest_speed, (), "a speed in m/s")
        self.lifts = flag("Modes.lifts", lifts)
        remedy = "give how many changes are to be kept"
        self.switches = whole("Modes.switches", switches, 1, remedy)
        if impact not in IMPACT_LAWS:
            known = f"use one of {IMPACT_LAWS}"
            raise FieldError("Modes.impact", impact, "is not known", known)
        self.impact = impact

    @property
    def sticking(self) -> Float[Array, ""] | None:
        """The coefficient of sticking [1]: that of sliding where none of its own is."""
        # no copy of that: what varies the one number varies both
        return self.friction if self.static_friction is None else self.static_friction

    @property
    def does_work(self) -> bool:
        """Whether slips or landings may take energy."""
        return self.friction is not None or self.restitution is not None


class HybridScene(Scene):
    """A scene whose contact may change between rolling, slipping and flight.

    Its contact law is how it rolls, where it rolls.

    Attributes:
        modes: How the contact may change.
    """

    modes: Modes

    def __init__(self, scene: Scene, modes: Modes):
        """Make one of a scene.

        Args:
            scene: Of one contact law; one that slips rolls by ``Rolling()``.
            modes: How the contact may change.
        """
        for field in dataclasses.fields(Scene):
            setattr(self, field.name, getattr(scene, field.name))
        if not isinstance(scene.contact, Rolling):
            self.contact = Rolling()
        self.modes = modes

    @property
    def does_work(self) -> bool:
        """Whether anything but the base's motion may change the energy."""
        return super().does_work or self.modes.does_work

    @property
    def in_modes(self) -> "Scenes":
        """It as it rolls, where the contact may end or not, and as it flies."""
        law = self.contact
        if self.modes.lifts:
            law = _RubberThatLifts() if law.without_spin else _RollingThatLifts()
        kept = tuple(load for load in self.loads if not load.needs_contact)
        return Scenes(under(self, law), under(self, Flying(), kept))


def modes_of(scene: Scene) -> Modes | None:
    """How a scene's contact may change; None: it does not."""
    return scene.modes if isinstance(scene, HybridScene) else None


def in_one_law(scene: Scene) -> Scene:
    """A scene whose contact does not change: as it rolls, where its modes are lost."""
    if not isinstance(scene, HybridScene):
        return scene
    found = object.__new__(Scene)
    for field in dataclasses.fields(Scene):
        object.__setattr__(found, field.name, getattr(scene, field.name))
    return found


class Scenes(NamedTuple):
    """A scene in every mode."""

    rolling: Scene
    flying: Scene


class _RollingThatLifts(Rolling):
    """Rolling, in a run that ends the contact where it would pull."""

    @property
    def one_sided(self) -> bool:
        return True


class _RubberThatLifts(RubberRolling):
    """Without spin about the normal, too."""

    @property
    def one_sided(self) -> bool:
        return True


class HybridState(State):
    """A state that can be in every mode; what the mode does not use stands still."""

    slip: Float[Array, "3"]
    position: Float[Array, "3"]
    velocity: Float[Array, "3"]

    def rolling(self) -> State:
        """As a state that rolls."""
        return State(**shared_parts(self))

    def sliding(self) -> SlidingState:
        """As a state that slips."""
        return SlidingState(**shared_parts(self), slip=self.slip)

    def flying(self) -> FlyingState:
        """As a state in flight."""
        parts = shared_parts(self)
        return FlyingState(**parts, position=self.position, velocity=self.velocity)


def of(state: Any) -> HybridState:
    """A state of one mode among all; what it does not have is zero."""
    zero = jnp.zeros_like(state.angular_velocity)
    names = "slip", "position", "velocity"
    own: dict[str, Any] = {name: getattr(state, name, zero) for name in names}
    return HybridState(**shared_parts(state), **own)


def slipping(
    scene: Scene,
    mu: Float[Array, ""],
    direction: Float[Array, "3"],
    state: HybridState,
    follows: bool = False,
    turns: bool = True,
) -> Scene:
    """A scene that rolls, as it slips; direction of the slip on fixed axes [1].

    Of length 1/2: the slip only begins, unless ``follows`` says that it does not. It
    has no derivative: a slip that ends may turn by 1e5 rad/s and more, and what follows
    does not depend on when it was looked at. ``turns``: it is asked how fast it does.
    """
    assert isinstance(scene.contact, Rolling)
    direction = jax.lax.stop_gradient(direction)
    own = matvec_transposed(rotation_matrix(state.orientation), direction)
    friction = DirectedFriction(
        mu, own, onset_of(scene), scene.contact.one_sided, follows, turns
    )
    return under(scene, Slipping(friction))


class ModedState(eqx.Module):
    """A state of a run in modes, with the mode that it was in.

    Attributes:
        parts: The state in every mode.
        mode: One of :class:`Mode`; -1 where not reached.
        direction: Of the slip, FIXED axes [1], shape (3,); while it only begins, where
            it began, and of length 1/2.
    """

    parts: HybridState
    mode: Int[Array, ""]
    direction: Float[Array, "3"]

    @property
    def in_its_mode(self) -> State:
        """What its known mode uses of it; all of it where no mode was reached."""
        states = {
            Mode.ROLLING: self.parts.rolling,
            Mode.SLIPPING: self.parts.sliding,
            Mode.FLYING: self.parts.flying,
        }
        mode = int(self.mode)
        return states[Mode(mode)]() if mode in set(Mode) else self.parts

    @property
    def alpha(self) -> Array:
        """Coordinates of what the body supports, shape (n,)."""
        return self.parts.alpha

    @property
    def alpha_dot(self) -> Array:
        """Their rates, shape (n,)."""
        return self.parts.alpha_dot

    @property
    def orientation(self) -> Array:
        """Quaternion, scalar first, body to fixed axes, of any length [1]."""
        return self.parts.orientation

    @property
    def angular_velocity(self) -> Array:
        """On BODY axes [rad/s], shape (3,)."""
        return self.parts.angular_velocity


class Switches(eqx.Module):
    """Changes of the mode in a run, in order; unused places are NaN.

    Attributes:
        time: [s], shape (S,).
        before: Mode before, one of :class:`Mode`, shape (S,).
        after: Mode after, shape (S,).
        state: After the change, every array with a leading S.
        count: How many there were.
    """

    time: Float[Array, " S"]
    before: Int[Array, " S"]
    after: Int[Array, " S"]
    state: HybridState
    count: Int[Array, ""]

    def __repr__(self) -> str:
        """The changes that there were, a line each; of many runs, types and shapes."""
        if is_traced(self) or len(jnp.shape(self.count)):
            return eqx.tree_pformat(self)
        does = {Mode.ROLLING: "rolls", Mode.SLIPPING: "slips", Mode.FLYING: "flies"}
        rows = zip(
            self.time.tolist(), self.before.tolist(), self.after.tolist(), strict=True
        )
        lines = [
            f"\n  {does[Mode(before)]} -> {does[Mode(after)]} at {t:.6g} s,"
            for t, before, after in list(rows)[: int(self.count)]
        ]
        return f"Switches(count={int(self.count)},{''.join(lines)}\n)"

    @property
    def first_lift(self) -> Float[Array, ""]:
        """When the contact was first lost [s]; NaN where it never was."""
        lost = (self.after == Mode.FLYING) & (self.before != Mode.FLYING)
        first = jnp.min(jnp.where(lost, self.time, jnp.inf), axis=-1)
        return jnp.where(jnp.isfinite(first), first, jnp.nan)


def as_it_is(
    function: Callable[[Scene, Array, Any], Array],
    scene: Scene,
    t: Float[Array, ""],
    mode: Int[Array, ""],
    y: HybridState,
) -> Array:
    """``function(scene, t, state)`` of the state as it flies, or as it touches."""
    flying = lambda: function(scene, t, y.flying())
    touching = lambda: function(scene, t, y.rolling())
    return cast(Array, jax.lax.cond(mode == Mode.FLYING, flying, touching))
