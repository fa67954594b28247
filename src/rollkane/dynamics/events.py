"""Events of the user's own: a number that changes its sign along a run."""

import functools
from collections.abc import Callable
from typing import Any, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.small_linear import dot
from ..validation.checks import FieldError, flag, is_traced, not_negative, real, whole
from ..validation.user_functions import accepts
from .observables import normal_force
from .rolling import contact_of, press_and_pull
from .scene import Scene

# Of a scene, the time [s] and a state.
_Function: TypeAlias = Callable[[Any, Array, Any], Any]
_MOST = 16
_WAYS = {-1: "falling", 0: "either way", 1: "rising"}
_LONGEST = 1000  # of what is kept of one event


class Event(eqx.Module):
    """A number of scene, time and state that is looked for where it changes its sign.

    A run's steps end on it, to rounding. What is found are changes of the sign between
    the ends of steps: two within one step are missed, and the value at the start, where
    it is zero, is none. More outputs make steps shorter.
    """

    _arrays: Any
    _fixed: Any = eqx.field(static=True)
    direction: int = eqx.field(static=True)
    stop: bool = eqx.field(static=True)
    name: str = eqx.field(static=True)
    most: int = eqx.field(static=True)

    def __init__(
        self,
        function: _Function,
        direction: int = 0,
        stop: bool = False,
        name: str = "",
        most: int = _MOST,
    ):
        """Say what is looked for.

        Args:
            function: ``function(scene, t, state)`` -> a number [any unit], by jax.numpy
                operations; ``t`` [s] and ``state`` are those of one moment. An
                ``equinox`` module that holds arrays is differentiated by them. With
                ``modes`` scene and state are those of the mode, as for
                ``Trajectory.each``.
            direction: 1: only where it rises through zero as the run goes on, -1: only
                where it falls, 0: both.
            stop: Whether the run ends there, with ``Code.STOPPED``.
            name: Of ``Trajectory.events``; the function's own by default.
            most: How often it is kept; later ones are counted only. One that ends the
                run happens once.

        Raises:
            FieldError: no function, or fields of another kind.
        """
        if not callable(function):
            remedy = "give a function of (scene, t, state)"
            raise FieldError("Event.function", function, "must be a function", remedy)
        if not accepts(function, 3):
            problem = "has a signature that does not fit"
            remedy = "let it take (scene, t, state)"
            raise FieldError("Event.function", function, problem, remedy)
        if isinstance(direction, bool) or direction not in _WAYS:
            known = ", ".join(f"{way} ({text})" for way, text in _WAYS.items())
            problem, remedy = "is no direction", f"give one of {known}"
            raise FieldError("Event.direction", direction, problem, remedy)
        if not isinstance(cast(object, name), str):
            raise FieldError("Event.name", name, "must be a text", "give a word or two")
        self._arrays, self._fixed = eqx.partition(function, eqx.is_array)
        self.direction = int(direction)
        self.stop = flag("Event.stop", stop)
        own = getattr(function, "__name__", "")
        self.name = name or ("" if own.startswith("<") else own)
        self.most = whole("Event.most", most, 1, "give how many are to be kept")
        if self.most > _LONGEST:
            problem, remedy = (
                "is more than is kept of a run",
                f"give {_LONGEST} or less",
            )
            raise FieldError("Event.most", most, problem, remedy)

    def __call__(self, scene: Any, t: Array, state: Any) -> Array:
        """Its value, of the time's type."""
        return jnp.asarray(self.function(scene, t, state)).astype(t.dtype)

    @property
    def function(self) -> _Function:
        """The user's."""
        return cast(_Function, eqx.combine(self._arrays, self._fixed))

    @staticmethod
    def lift_off(stop: bool = False, name: str = "lift-off") -> "Event":
        """Where the contact would first have to pull: ``N`` [N] falls through zero.

        Args:
            stop: Whether the run ends there.
            name: Of ``Trajectory.events``.
        """
        return Event(normal_force, -1, stop, name)

    @staticmethod
    def friction(
        coefficient: ArrayLike, stop: bool = False, name: str = "friction"
    ) -> "Event":
        """Where rolling needs more friction than there is: ``mu N - |T|`` falls [N].

        Args:
            coefficient: Of static friction, mu [1].
            stop: Whether the run ends there.
            name: Of ``Trajectory.events``.

        Raises:
            FieldError: a negative coefficient.
        """
        mu = not_negative("Event.friction.coefficient", coefficient, "without unit")
        return Event(_Spare(mu), -1, stop, name)

    @staticmethod
    def section(
        normal: ArrayLike,
        offset: ArrayLike = 0.0,
        direction: int = 1,
        stop: bool = False,
        name: str = "section",
        most: int = _MOST,
    ) -> "Event":
        """Where the body's origin O crosses the plane ``n . r_O = d``, FIXED axes.

        Args:
            normal: n [1], shape (3,).
            offset: d [m, times the length of n].
            direction: 1: only towards n, -1: only against it, 0: both.
            stop: Whether the run ends there.
            name: Of ``Trajectory.events``.
            most: How often it is kept.

        Raises:
            FieldError: no vector of three numbers, or one without length.
        """
        n = real("Event.section.normal", normal, (3,), "a vector of three numbers")
        if not is_traced(n) and not np.any(np.asarray(n) != 0.0):
            remedy = "give the direction in which it is crossed"
            raise FieldError("Event.section.normal", n, "has no length", remedy)
        d = real("Event.section.offset", offset, (), "a number in m")
        return Event(_Section(n, d.astype(n.dtype)), direction, stop, name, most)


class _Spare(eqx.Module):
    """What friction spares, ``mu N - |T|`` [N]."""

    mu: Float[Array, ""]

    def __call__(self, scene: Scene, t: Array, state: Any) -> Array:
        press, pull = press_and_pull(scene, t, state)
        squared = dot(pull, pull)
        some = squared > 0.0
        size = jnp.where(some, jnp.sqrt(jnp.where(some, squared, 1.0)), 0.0)
        return self.mu.astype(press.dtype) * press - size


class _Section(eqx.Module):
    """Distance of O from a plane [m], times the length of its normal."""

    normal: Float[Array, "3"]
    offset: Float[Array, ""]

    def __call__(self, scene: Scene, t: Array, state: Any) -> Array:
        place = contact_of(scene, t, state).position
        along = dot(self.normal.astype(place.dtype), place)
        return along - self.offset.astype(place.dtype)


_READY: dict[str, Callable[[], Event]] = {"lift-off": Event.lift_off}
_NEEDING = {
    "friction": "rollkane.Event.friction(coefficient)",
    "section": "rollkane.Event.section(normal)",
}


def known_event(field: str, given: object) -> Event:
    """An event, or a ready one by its name.

    Raises:
        FieldError: neither.
    """
    if isinstance(given, Event):
        return given
    if isinstance(given, str):
        if given in _READY:
            return _READY[given]()
        if given in _NEEDING:
            problem = "is not known by its name alone"
            raise FieldError(field, given, problem, f"give {_NEEDING[given]}")
    known = ", ".join(f'"{name}"' for name in _READY)
    remedy = f"give an Event, or one of {known}"
    raise FieldError(field, given, "is no event", remedy)


def bound(event: Event, field: str, scene: Any, t: Array, state: Any) -> Event:
    """An event of this scene: one that gives a number, and closes over nothing traced.

    Raises:
        FieldError: its function cannot be traced, or gives no single real number.
    """
    if not _hides(event, field, scene, t, state):
        return event
    opened = eqx.filter_closure_convert(event.function, scene, t, state)
    how = event.direction, event.stop, event.name, event.most
    return Event(opened, *how)


def refuse_closure(event: Event, field: str, scene: Any, t: Array, state: Any) -> None:
    """Refuse an event that does not fit a mode, or hides traced numbers in it.

    Raises:
        FieldError: it does.
    """
    if _hides(event, field, scene, t, state):
        problem = "closes over a traced number, which it cannot do with modes"
        remedy = "give an equinox module that holds the number"
        raise FieldError(field, event.function, problem, remedy)


def _hides(event: Event, field: str, scene: Any, t: Array, state: Any) -> bool:
    """Whether an event closes over traced numbers."""
    known = event, scene, t, state
    leaves, tree = cast("tuple[list[Any], Any]", jax.tree.flatten(known))
    form = tree, tuple((jnp.shape(x), jnp.result_type(x)) for x in leaves)
    try:
        return _closes_over_traced(field, form)
    except TypeError:  # a function that has no hash
        return _closes_over_traced.__wrapped__(field, form)


@functools.lru_cache(256)
def _closes_over_traced(field: str, form: tuple[Any, tuple[Any, ...]]) -> bool:
    """Whether an event's function hides traced numbers from derivatives.

    Raises:
        FieldError: it cannot be traced, or gives no single real number.
    """
    tree, sizes = form
    like = [jax.ShapeDtypeStruct(*size) for size in sizes]
    event, *arguments = cast("list[Any]", jax.tree.unflatten(tree, like))
    remedy = "let it return one real number, by jax.numpy operations"

    def value(event: Event, scene: Any, t: Array, state: Any) -> Any:
        return event.function(scene, t, state)

    shown = event.function
    try:
        program, found = jax.make_jaxpr(value, return_shape=True)(event, *arguments)
    except Exception as error:
        first = str(error).partition("\n")[0]
        problem = f"cannot be traced by JAX ({first})"
        raise FieldError(field, shown, problem, remedy) from error
    shape, kind = getattr(found, "shape", None), getattr(found, "dtype", None)
    if shape != () or kind is None:
        raise FieldError(field, shown, f"gives {found}", remedy)
    if kind.kind not in "iuf":
        raise FieldError(field, shown, f"gives a {kind}, which has no sign", remedy)
    return is_traced(program.consts)
