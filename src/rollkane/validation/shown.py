"""Values as a reader wants them: their numbers with units, in a few lines."""

import dataclasses
from typing import Any, cast

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

# Unit of a field by its name, which means the same in every class that is shown.
_UNITS = {
    "mass": "kg",
    "inertia": "kg m^2",
    "acceleration": "m/s^2",
    "angular_velocity": "rad/s",
    "angle": "rad",
    "rate": "rad/s",
    **dict.fromkeys(("time", "final_time", "kinks"), "s"),
    **dict.fromkeys(("velocity", "slip", "speed", "rest_speed"), "m/s"),
    **dict.fromkeys(("center_of_mass", "center", "position", "point"), "m"),
    **dict.fromkeys(("radius", "major_radius", "minor_radius", "semi_axes"), "m"),
}
_MOST_NUMBERS = 9  # that an array is shown with; of larger ones, type and shape
_WIDTH = 88


def described(module: Any) -> str:
    """A module by its numbers, in one line, or a line for each field.

    What is None, False or empty is left out.

    Args:
        module: A dataclass, such as a body, a surface or a state; of other values
            their own ``repr``.
    """
    name, parts = type(module).__name__, _parts(module)
    line = f"{name}({', '.join(parts)})"
    if len(line) <= _WIDTH or not parts:
        return line
    return f"{name}(\n  " + ",\n  ".join(parts) + ",\n)"


def in_a_line(value: Any) -> str:
    """A module by its numbers, in one line however long."""
    return _text(value)


def _parts(module: Any) -> list[str]:
    parts: list[str] = []
    for field in dataclasses.fields(module):
        value = getattr(module, field.name, None)
        if field.name.startswith("_") or not field.repr or _is_nothing(value):
            continue
        text, unit = _text(value), ""
        if isinstance(value, np.ndarray | jax.Array):
            text = _of_array(value, is_tensor=field.name == "inertia")
            unit = f" {_UNITS[field.name]}" if field.name in _UNITS else ""
        parts.append(f"{field.name}={text}{unit}")
    return parts


def _is_nothing(value: Any) -> bool:
    if isinstance(value, np.ndarray | jax.Array):
        return value.size == 0
    return value is None or value is False or value in ((), "")


def _text(value: Any) -> str:
    """A value in one line."""
    if isinstance(value, np.ndarray | jax.Array):
        return _of_array(value)
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, eqx.Module):
        name = getattr(value, "__name__", None)  # of a user's function
        if name is not None:
            return str(name)
        return f"{type(value).__name__}({', '.join(_parts(value))})"
    if isinstance(value, tuple):
        each = [_text(x) for x in cast("tuple[Any, ...]", value)]
        return f"({', '.join(each)}{',' * (len(each) == 1)})"
    return repr(value)


def _of_array(value: Any, is_tensor: bool = False) -> str:
    kind = f"{value.dtype}{list(value.shape)}"
    if isinstance(value, Tracer):
        return f"traced {kind}"
    if value.size > _MOST_NUMBERS or getattr(value, "is_deleted", bool)():
        return kind
    numbers = np.asarray(value)
    if is_tensor and numbers.shape == (3, 3):
        entries = np.diag(numbers)
        if not np.any(numbers - np.diag(entries)):
            return f"diag{_rows(entries.tolist())}"
    return _rows(numbers.tolist())


def _rows(numbers: Any) -> str:
    if not isinstance(numbers, list):
        return f"{numbers:.6g}" if isinstance(numbers, float) else str(numbers)
    each = [_rows(x) for x in cast("list[Any]", numbers)]
    return f"({', '.join(each)}{',' * (len(each) == 1)})"
