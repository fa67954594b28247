"""Systems, states and times as a user gives them: refused by field, or as arrays.

Shapes alone decide, which traced numbers have, too: nothing is added to a program.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError, is_traced, real_numbers
from ..validation.user_functions import as_time
from .system import KaneState, KaneSystem

_INSTEAD = {
    "Scene": "make it one by kane.rolling_system, or integrate it by rollkane.simulate",
    "RollingSystem": "give its `system`, or `eliminated`",
}
_MANY = "(a batch of states needs jax.vmap)"


def known_system(field: str, system: object) -> KaneSystem:
    """The system.

    Raises:
        FieldError: it is none.
    """
    if isinstance(system, KaneSystem):
        return system
    kind = type(system).__name__
    remedy = _INSTEAD.get(kind, "give a KaneSystem")
    raise FieldError(field, f"a {kind}", f"must be a KaneSystem, not a {kind}", remedy)


def checked_state(
    field: str,
    system: KaneSystem,
    state: object,
    dtype: Any = None,
    lead: tuple[int, ...] = (),
) -> KaneState:
    """A state of a system, or as many as there are times.

    Args:
        field: Name used in the error.
        system: The system.
        state: What was given.
        dtype: Of its numbers; None: floats keep theirs.
        lead: Shape of the times.

    Raises:
        FieldError: another kind of value, or of another shape.
    """
    if not isinstance(state, KaneState):
        problem, remedy = "must be a KaneState", "give KaneState(q, u)"
        raise FieldError(field, state, problem, remedy)
    sizes = {"q": system.coordinates, "u": len(system.independent)}
    which = "every speed"
    if system.dependent:
        which = f"the speeds {list(system.independent)}, the independent ones, alone"
    each = f", for times of shape {lead}" if lead else f" {_MANY}"
    remedies = {"q": f"give every coordinate{each}", "u": f"give {which}{each}"}
    q, u = (
        _shaped(f"{field}.{name}", getattr(state, name), (*lead, size), remedies[name])
        for name, size in sizes.items()
    )
    if dtype is not None:
        q, u = jnp.asarray(q, dtype), jnp.asarray(u, dtype)
    return KaneState(q, u)


def coordinates_of(field: str, system: KaneSystem, q: Any) -> Float[Array, " n"]:
    """Every coordinate.

    Raises:
        FieldError: no numbers, or another number of them.
    """
    remedy = f"give every coordinate {_MANY}"
    return _shaped(field, q, (system.coordinates,), remedy)


def time_of(field: str, t: Any) -> Float[Array, ""]:
    """One time [s].

    Raises:
        FieldError: no number, or several.
    """
    remedy = "give one time in seconds (several need jax.vmap)"
    return as_time(_shaped(field, t, (), remedy))


def times_of(field: str, t: Any) -> Array:
    """One time or several [s].

    Raises:
        FieldError: no numbers.
    """
    return as_time(_floats(field, t, "give times in seconds"))


def with_auxiliary(field: str, system: KaneSystem, u: Any) -> Float[Array, " m"]:
    """All speeds, the auxiliary ones behind the others.

    Raises:
        FieldError: another number of speeds, or known auxiliary ones that are not zero.
    """
    remedy = "give every speed, dependent ones included"
    array, count = _floats(field, u, remedy), system.auxiliary
    whole = array.shape == (system.speeds + count,)
    if not whole:
        array = _of_shape(field, array, (system.speeds,), remedy)
        return jnp.concatenate([array, jnp.zeros(count, array.dtype)])
    known = None if is_traced(u) else np.asarray(u)
    if known is not None and known[system.speeds :].any():
        raise FieldError(
            field,
            known,
            "has auxiliary speeds that are not zero",
            "leave them out: they are only thought of, to give the reactions",
        )
    return array


def _shaped(field: str, value: Any, shape: tuple[int, ...], remedy: str) -> Array:
    """Floats of a shape."""
    return _of_shape(field, _floats(field, value, remedy), shape, remedy)


def _floats(field: str, value: Any, remedy: str) -> Array:
    checked = real_numbers(field, value, remedy)
    # a known array of JAX's stays one in the middle of a trace
    array = jnp.asarray(value if eqx.is_array(value) else checked)
    floats = jnp.issubdtype(array.dtype, jnp.floating)
    return array if floats else array.astype(float)


def _of_shape(field: str, array: Array, shape: tuple[int, ...], remedy: str) -> Array:
    if array.shape != shape:
        raise FieldError(field, array.shape, f"must have shape {shape}", remedy)
    return array
