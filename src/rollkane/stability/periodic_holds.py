"""Quantities that a periodic motion can be asked to have, by name."""

import dataclasses
from collections.abc import Callable
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from ..dynamics.scene import Scene
from ..identification import paths
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, real
from .closing_newton import PERIOD, Held, coordinates_of, scales
from .neutral import FLOW, neutral
from .quantities import NAMED, held_by_name
from .shooting import Shooting, measured

FIELD = "periodic_motion"


def held_of(shot: Shooting, start: State, period: float, hold: Any) -> tuple[Held, ...]:
    """What is held, with its values.

    Raises:
        FieldError: names that are not known, values that are no numbers.
    """
    found: list[Held] = []
    for name, given in held_by_name(f"{FIELD}.hold", hold).items():
        field = f"{FIELD}.hold[{name!r}]"
        one, value = _quantity(shot, start, field, name, given)
        if value is None:
            value = period
            if one.place is not None:
                remedy = "give its displacement in a period [m] or [rad]"
                raise FieldError(field, None, "is not known of a guess", remedy)
            if one.quantity is not None:
                t = jnp.asarray(shot.time, start.orientation.dtype)
                value = float(measured(one.quantity, shot.scene, t, start)[0])
        value = float(real(field, value, (), "a number"))
        if name == PERIOD and not value > 0.0:
            raise FieldError(field, value, "must be positive", "give a time [s]")
        found.append(one._replace(value=value))
    return tuple(found)


def check_invariant(shot: Shooting, start: State, held: tuple[Held, ...]) -> None:
    """Refuse to hold what a symmetry does not leave as it is.

    Raises:
        FieldError: with the symmetry's name.
    """
    around = coordinates_of(shot, start)
    size = scales(around, 2.0 * np.pi)
    known = neutral(around, shot.group)
    for one in held:
        if one.quantity is None or getattr(one.quantity, "is_local", False):
            continue
        slope = np.asarray(measured(one.quantity, shot.scene, around.time, start)[1])
        steep = slope * size
        for name, direction in zip(known.names, known.directions / size, strict=True):
            change = abs(float(steep @ direction))
            least = 1e-8 * np.linalg.norm(steep) * np.linalg.norm(direction)
            if name != FLOW and change > least:
                problem = f"is not left as it is by the symmetry {name!r}"
                remedy = "hold what no symmetry changes, such as the energy"
                field = f"{FIELD}.hold[{one.name!r}]"
                raise FieldError(field, one.value, problem, remedy)


def _quantity(
    shot: Shooting, start: State, field: str, name: str, given: Any
) -> tuple[Held, Any]:
    """What a name stands for, and the value that it is given."""
    one, value = Held(name, 0.0), given
    if type(given) is tuple:
        pair = cast(tuple[Any, ...], given)
        if len(pair) == 2 and callable(pair[0]):
            return one._replace(quantity=cast(Callable[..., Any], pair[0])), pair[1]
    if name == PERIOD:
        return one, value
    if name in shot.group.names:
        return one._replace(place=shot.group.names.index(name)), value
    if name in NAMED:
        return one._replace(quantity=NAMED[name]), value
    numbers = [*paths.floats(start)]
    try:
        keys = paths.keys_of(name)
        if np.shape(paths.found(start, keys)) == ():
            return one._replace(quantity=_Number(keys)), value
    except (FieldError, LookupError):
        pass
    known = ", ".join(repr(x) for x in (PERIOD, *NAMED, *shot.group.names, *numbers))
    remedy = (
        f"hold one of {known} (with an index), or give a pair (function, value) with "
        "function(scene, t, state) -> a number"
    )
    raise FieldError(field, given, "is not known", remedy)


@dataclasses.dataclass(frozen=True)
class _Number:
    """A number of the state; equal ones share their compiled programs."""

    keys: paths.Keys

    def __call__(self, scene: Scene, t: Any, state: Any) -> Any:
        """Its value."""
        del scene, t
        return jnp.asarray(paths.found(state, self.keys))
