"""Quantities by name that a steady motion can be asked to have."""

import dataclasses
import difflib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics.observables import (
    angular_momentum,
    energy,
    momentum,
    moving_energy,
    normal_force,
)
from ..dynamics.ready_observables import tilt
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene
from ..geometry.small_linear import cross, safe_norm
from ..identification import paths
from ..kinematics.coordinates import State
from ..validation.checks import FieldError
from .problem import AbstractProblem, RollingProblem

_Observable: TypeAlias = Callable[[Any, Array, Any], Array]


def speed(scene: Scene, t: Float[Array, ""], state: State) -> Float[Array, ""]:
    """Of the body's mass centre [m/s]."""
    contact = contact_of(scene, t, state)
    arm = scene.body.center_of_mass - contact.body_point
    v = cross(contact.angular_velocity, arm)
    moved = contact.point_velocity
    return safe_norm(v if moved is None else v + moved)


def spin(scene: Scene, t: Float[Array, ""], state: State) -> Float[Array, ""]:
    """Angular velocity about the body's own z axis [rad/s]."""
    del scene, t
    return state.angular_velocity[2]


def _component(function: _Observable, k: int) -> _Observable:
    return lambda scene, t, state: function(scene, t, state)[k]


NAMED: dict[str, _Observable] = {
    "speed": speed,
    "tilt": tilt,
    "spin": spin,
    "energy": energy,
    "moving energy": moving_energy,
    "normal force": normal_force,
}
for _k, _axis in enumerate("xyz"):
    NAMED[f"momentum {_axis}"] = _component(momentum, _k)
    NAMED[f"angular momentum {_axis}"] = _component(angular_momentum, _k)


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A quantity by its name; equal ones share their compiled programs.

    Attributes:
        name: As it was asked for.
        keys: Of a number of the state; None: another kind.
        function: Of the user's, of (scene, t, state); None: another kind.
        velocity: Number of the generator whose velocity it is; None: another kind.
    """

    name: str
    keys: paths.Keys | None = None
    function: Callable[..., Any] | None = None
    velocity: int | None = None

    def __call__(
        self, problem: AbstractProblem, state: Any, velocities: Float[Array, " K"]
    ) -> Float[Array, ""]:
        """Its value."""
        if self.velocity is not None:
            return velocities[self.velocity]
        if self.keys is not None:
            return jnp.asarray(paths.found(state, self.keys))
        t = jnp.zeros_like(velocities, shape=())
        function = self.function or NAMED[self.name]
        return jnp.asarray(function(problem.model, t, state))


def quantity(
    field: str, problem: AbstractProblem, state: Any, name: str, function: Any = None
) -> Quantity:
    """A quantity by its name.

    Args:
        field: Name used in the error.
        problem: Whose it is.
        state: In which numbers are named.
        name: One of ``NAMED``, a generator (its velocity), a number of the state
            (``"angular_velocity[2]"``, also with ``start.`` in front), or any name of
            the user's function.
        function: ``function(scene, t, state)`` -> a number; None for a known name.

    Raises:
        FieldError: a name that nothing has.
    """
    if function is not None:
        return Quantity(name, function=function)
    if name in problem.group:
        return Quantity(name, velocity=problem.group.index(name))
    plain = name.removeprefix("start.").removeprefix("state.")
    if plain in NAMED and isinstance(problem, RollingProblem):
        return Quantity(plain)
    try:
        keys = paths.keys_of(plain)
        value = paths.found(state, keys)
    except (FieldError, LookupError):
        value = ()
    if paths.is_floating(np.asarray(value)) and not np.shape(value):
        return Quantity(name, keys=paths.keys_of(plain))
    known = [*problem.group, *paths.floats(state)]
    known += NAMED if isinstance(problem, RollingProblem) else ()
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    meant = f"did you mean {near[0]!r}? " if near else ""
    remedy = f"{meant}name one number: {', '.join(known)} (with an index)"
    raise FieldError(field, name, "is no quantity that can be held", remedy)


def held_quantities(
    field: str, problem: AbstractProblem, state: Any, hold: Any
) -> tuple[tuple[Quantity, ...], list[float | None]]:
    """Quantities that are held, and their values; None: that of the guess.

    Args:
        field: Name used in errors.
        problem: Whose they are.
        state: The guess.
        hold: Names; or a mapping of names to values, to (function, value), or None.

    Raises:
        FieldError: names that nothing has, values that are no finite numbers.
    """
    chosen: list[Quantity] = []
    values: list[float | None] = []
    for name, value in held_by_name(field, hold).items():
        where, function = f"{field}[{name!r}]", None
        if callable(value):
            function, value = value, None
        elif isinstance(value, tuple) and len(cast(tuple[Any, ...], value)) == 2:
            function, value = cast(tuple[Any, Any], value)
        chosen.append(quantity(where, problem, state, name, function))
        values.append(None if value is None else _number(where, value))
    return tuple(chosen), values


def held_by_name(field: str, hold: Any) -> Mapping[str, Any]:
    """What is held, each with its value or None.

    Raises:
        FieldError: neither names nor a mapping of them.
    """
    if hold is None:
        return {}
    names: list[Any] = [hold]
    if isinstance(hold, Iterable) and not isinstance(hold, str):
        names = list(cast(Iterable[Any], hold))
    for name in names:
        if not isinstance(name, str):
            remedy = 'give names, such as ("speed",), or values: {"speed": 1.0}'
            raise FieldError(field, name, "is no name of a quantity", remedy)
    if isinstance(hold, Mapping):
        return cast(Mapping[str, Any], hold)
    return dict.fromkeys(names)


def _number(field: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        remedy = "give its value, None for that of the guess, or (function, value)"
        raise FieldError(field, value, "is not a finite number", remedy)
    return number
