"""A scene: which body rolls on which base, under which loads.

What a scene does not name costs nothing: it is no part of the traced program.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, cast

import equinox as eqx
from jaxtyping import Array, Float

from ..geometry.surfaces import AbstractSurface, Plane
from ..kinematics.base_motion import AbstractBaseMotion
from ..validation.checks import FieldError, checked_kinks
from ..validation.shown import described
from .abstract_supported import AbstractSupported, rolling_parts, shares
from .bodies import Body
from .friction import AbstractFriction, ViscousFriction
from .loads import AbstractLoad, Gravity
from .scene_description import description


class AbstractContactLaw(eqx.Module):
    """What holds body and base together; each law says what others ask of it."""

    touches: ClassVar[bool] = True  # there is a contact
    slips: ClassVar[bool] = False  # the state has a slip
    without_spin: ClassVar[bool] = False  # no turn about the normal

    @property
    def does_work(self) -> bool:
        """Whether the contact force takes energy; not where it does not move."""
        return self.slips

    @property
    def needs_normal_force(self) -> bool:
        """Whether a part of it is proportional to the normal force."""
        return False

    @property
    def one_sided(self) -> bool:
        """Whether dry resistance goes with the sign of the normal force, not its size.

        Smoothly through its zero, for a run that ends the contact there.
        """
        return False


class Rolling(AbstractContactLaw):
    """Contact law: rolling without slipping, turning about the normal allowed.

    Bilateral: a run goes on where the contact force is tensile, and the result says
    when that began.
    """


class RubberRolling(Rolling):
    """Contact law: rolling without slipping and without turning about the normal.

    Relative to the base; a spin about the normal in a start is left out.

    Source: docs/theory.md, (7.3).
    """

    without_spin: ClassVar[bool] = True


class Slipping(AbstractContactLaw):
    """Contact law: the contact holds, but the body slips on it, against friction.

    Bilateral, like rolling: where the contact pulls, friction acts with the size of the
    normal force.

    Attributes:
        friction: ``ViscousFriction``, ``CoulombFriction`` or ``StribeckFriction``.

    Source: docs/theory.md, (7.1), (7.2).
    """

    slips: ClassVar[bool] = True
    friction: AbstractFriction

    def __init__(self, friction: AbstractFriction | None = None):
        """Make the law.

        Args:
            friction: A friction law; ``ViscousFriction(0.0)``, a smooth surface, when
                left out.

        Raises:
            FieldError: something else.
        """
        friction = ViscousFriction(0.0) if friction is None else friction
        remedy = "give ViscousFriction, CoulombFriction or StribeckFriction"
        _require("Slipping.friction", friction, AbstractFriction, remedy)
        self.friction = friction

    @property
    def needs_normal_force(self) -> bool:
        """Whether the friction does."""
        return self.friction.needs_normal_force


class Flying(AbstractContactLaw):
    """No contact: the body flies under its loads (a mode of a run with ``modes``)."""

    touches: ClassVar[bool] = False


class Base(eqx.Module):
    """What the body rolls on.

    Attributes:
        surface: Surface, base axes; they coincide with the fixed axes at rest.
        motion: How it moves, or None: a base at rest.
    """

    surface: AbstractSurface
    motion: AbstractBaseMotion | None

    def __init__(
        self,
        surface: AbstractSurface | None = None,
        motion: AbstractBaseMotion | None = None,
    ):
        """Make a base.

        Args:
            surface: Surface in base axes; ``Plane()`` when left out.
            motion: ``BaseMotion``, ``Spin`` or ``RecordedMotion``; left out, a base at
                rest, whose axes are the fixed axes.

        Raises:
            FieldError: no surface, or something else for a motion.
        """
        surface = Plane() if surface is None else surface
        if not isinstance(cast(object, surface), AbstractSurface):
            raise FieldError(
                "Base.surface",
                surface,
                "must be a surface",
                "give one of the catalogue, for example Plane()",
            )
        if not isinstance(cast(object, motion), AbstractBaseMotion | None):
            raise FieldError(
                "Base.motion",
                motion,
                "must be a motion",
                "give BaseMotion(position, rotation), Spin(rate), "
                "RecordedMotion(time, acceleration) or None: a base at rest",
            )
        self.surface = surface
        self.motion = motion

    def __repr__(self) -> str:
        """Its numbers, with units, in a few lines."""
        return described(self)


class Scene(eqx.Module):
    """A body on a base, with what it supports and what acts on it.

    Attributes:
        body: The rolling body.
        base: What it rolls on.
        supported: Masses and bodies that it carries, in the order of their
            coordinates in alpha.
        loads: What acts on it and on what it carries.
        contact: The contact law.
        kinks: Times at which functions of time of its parts jump [s], or None.
        has_contact_coordinates: Whether the state holds the contact point on the body;
            False where it follows from the normal.
    """

    body: Body
    base: Base
    supported: tuple[AbstractSupported, ...]
    loads: tuple[AbstractLoad, ...]
    contact: Rolling | Slipping | Flying
    kinks: Float[Array, " k"] | None
    has_contact_coordinates: bool = eqx.field(static=True)

    def __init__(
        self,
        body: Body,
        base: Base | None = None,
        supported: Any = (),
        loads: AbstractLoad | Sequence[AbstractLoad] | None = None,
        contact: Rolling | Slipping | None = None,
        kinks: Any = None,
    ):
        """Make a scene.

        Args:
            body: The rolling body.
            base: What it rolls on; a horizontal plane at rest when left out.
            supported: ``PointMasses``, ``SupportedBody``, ``Prescribed`` or
                ``RollingBody``, one or a tuple of them.
            loads: Forces; ``(Gravity(),)`` when left out, ``()`` for none.
            contact: The contact law; ``Rolling()`` when left out.
            kinks: Times [s] at which a force, a torque, a control or another function
                of time of its parts jumps or begins, shape (k,): steps end before each
                and begin behind it, so that no pulse is missed. They must not depend
                on what you differentiate by. A motion of the base has its own.

        Raises:
            FieldError: a part of another kind, kinks that are no times.
        """
        base = Base() if base is None else base
        loads = (Gravity(),) if loads is None else loads
        contact = Rolling() if contact is None else contact
        _require("Scene.body", body, Body, "give a Body")
        _require("Scene.base", base, Base, "give a Base, for example Base(Plane())")
        remedy = "give Rolling(), RubberRolling() or Slipping(friction)"
        _require("Scene.contact", contact, (Rolling, Slipping), remedy)
        if isinstance(loads, AbstractLoad):
            loads = (loads,)
        _require("Scene.loads", loads, (tuple, list), "give a tuple of loads")
        for i, load in enumerate(loads):
            _require(
                f"Scene.loads[{i}]",
                load,
                AbstractLoad,
                "give Gravity(), or () for none",
            )
        if isinstance(supported, AbstractSupported):
            supported = (supported,)
        _require("Scene.supported", supported, (tuple, list), "give a tuple of parts")
        for i, part in enumerate(supported):
            remedy = "give PointMasses, SupportedBody, Prescribed or RollingBody"
            _require(f"Scene.supported[{i}]", part, AbstractSupported, remedy)
        self.body, self.base, self.contact = body, base, contact
        self.loads, self.supported = tuple(loads), tuple(supported)
        self.kinks = checked_kinks("Scene.kinks", kinks)
        self.has_contact_coordinates = (
            body.surface.normal_map(base.surface.is_flat) is None
        )

    def __repr__(self) -> str:
        """Its numbers, with units, in a few lines."""
        return described(self)

    def describe(self) -> str:
        """The scene in sentences, with its numbers and units."""
        return description(self)

    @property
    def carries_point(self) -> bool:
        """Former name of ``has_contact_coordinates``, for one release."""
        return self.has_contact_coordinates

    @property
    def coordinate_count(self) -> int:
        """Number n of coordinates alpha; parts that roll on the body have a state."""
        rolling = sum(part.count for part in rolling_parts(self.supported))
        return sum(part.count for part in self.supported) - rolling

    def shares(self, state: Any) -> Iterator[tuple[AbstractSupported, Any, Array]]:
        """Each supported part with its own coordinates and rates, by a state.

        Parts that roll on the body come last, with a ``State`` and no rates.
        """
        return shares(self.supported, state.alpha, state.alpha_dot, state.supported)

    @property
    def does_work(self) -> bool:
        """Whether anything but the base's motion may change the energy."""
        active = any(part.does_work for part in (*self.supported, *self.loads))
        return active or self.contact.does_work


def under(
    scene: Scene, law: AbstractContactLaw, loads: tuple[AbstractLoad, ...] | None = None
) -> Scene:
    """A scene under another contact law, and with other loads if they are given."""
    alone: Callable[[object], bool] = lambda x: x is scene.contact or x is scene.loads
    parts = law, scene.loads if loads is None else loads
    return eqx.tree_at(lambda s: (s.contact, s.loads), scene, parts, is_leaf=alone)


def require_scene(field: str, scene: object, remedy: str = "give a Scene") -> Scene:
    """The scene; what is none is refused.

    Args:
        field: Of the error.
        scene: What was given.
        remedy: What to do about it.

    Raises:
        FieldError: it is none.
    """
    if not isinstance(scene, Scene):
        kind = type(scene).__name__
        raise FieldError(field, f"a {kind}", f"must be a Scene, not a {kind}", remedy)
    return scene


def _require(
    field: str, value: object, kind: type | tuple[type, ...], remedy: str
) -> None:
    if not isinstance(value, kind):
        raise FieldError(field, value, f"cannot be a {type(value).__name__}", remedy)
