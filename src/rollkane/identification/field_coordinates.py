"""The coordinates that a field is varied in, and its bounds, by what the field is."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..validation.checks import FieldError
from . import paths
from .inertia_transforms import inertia_transform
from .parameters import Free, Model, number_in
from .start_coordinates import start_transform
from .transform_values import values_at
from .transforms import AbstractTransform, Plain, Positive, Rotated, Scaled

# Fields whose constructors ask for numbers above zero, by class ("": any class)
_POSITIVE = {
    ("", "mass"),
    ("", "radius"),
    ("", "major_radius"),
    ("", "minor_radius"),
    ("", "regularization"),
    ("Implicit", "size"),
    ("Modes", "rest_speed"),
    ("Ellipsoid", "semi_axes"),
    ("StribeckFriction", "speed"),
}
# and those that may be zero, with the largest that they may be
_NOT_NEGATIVE = {
    ("Modes", "friction"): np.inf,
    ("Modes", "static_friction"): np.inf,
    ("Modes", "restitution"): 1.0,
    ("StribeckFriction", "static"): np.inf,
    ("StribeckFriction", "kinetic"): np.inf,
    ("StribeckFriction", "viscous"): np.inf,
    ("CoulombFriction", "coefficient"): np.inf,
    ("ViscousFriction", "coefficient"): np.inf,
    ("RollingResistance", "viscous"): np.inf,
    ("RollingResistance", "dry"): np.inf,
    ("SpinningResistance", "viscous"): np.inf,
    ("SpinningResistance", "dry"): np.inf,
    ("Drag", "linear"): np.inf,
    ("Drag", "quadratic"): np.inf,
    ("Drag", "angular"): np.inf,
}
# Unit quaternions
_QUATERNIONS = {("", "orientation"), ("RollingBody", "rotation")}


def is_clock(model: Model, keys: paths.Keys) -> bool:
    """Whether keys lead to the times of samples, whose order a fit would not keep."""
    return _kind(model, keys) == ("RecordedMotion", "time")


def _kind(model: Model, keys: paths.Keys) -> tuple[str, str]:
    """Class that holds a number, and the number's name there."""
    while isinstance(keys[-1], int):
        keys = keys[:-1]
    return type(number_in(model, keys[:-1])).__name__, str(keys[-1])


def _is_among(fields: set[tuple[str, str]], kind: tuple[str, str]) -> bool:
    return kind in fields or ("", kind[1]) in fields


def transform_of(
    free: Free, model: Model, keys: paths.Keys, value: Array
) -> AbstractTransform:
    """The coordinates of a free parameter, by the class and the field that has it.

    Args:
        free: What was asked for.
        model: The model.
        keys: Of the parameter in the model.
        value: What the model has there.

    Raises:
        FieldError: a part of an inertia or a quaternion, a form that is not the
            field's, a positive number that is none.
    """
    field = f"Free({free.path!r})"
    value, kind = jnp.asarray(value), _kind(model, keys)
    turned = _is_among(_QUATERNIONS, kind)
    if (turned or kind[1] == "inertia") and isinstance(keys[-1], int):
        whole = free.path.rstrip("[]0123456789.")
        remedy = f"free {whole!r}, which stays physical as a whole"
        raise FieldError(field, free.path, "is only a part", remedy)
    if free.form == "scale":
        if not np.any(np.asarray(value)):
            raise FieldError(field, value, "is zero and has no scale", "leave form out")
        return Scaled(value)
    if kind[1] == "inertia" and value.shape == (3, 3):
        return inertia_transform(field, value, free.form)
    if free.form not in (None, "full"):
        raise FieldError(f"{field}.form", free.form, "is of inertias", "leave it out")
    if turned and value.shape == (4,):
        return Rotated(value)
    without_spare = start_transform(model, keys, value)
    if without_spare is not None:
        return without_spare
    if _is_among(_POSITIVE, kind):
        if not np.all(np.asarray(value) > 0.0):
            raise FieldError(field, value, "must start above zero", "give it a guess")
        return Positive(value)
    return Plain(value)


def bounds_of(
    free: Free, model: Model, keys: paths.Keys, transform: AbstractTransform
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds in coordinates: those that were given, and those that physics has.

    Args:
        free: What was asked for.
        model: The model.
        keys: Of the parameter in the model.
        transform: Its coordinates.

    Returns:
        Lower and upper bounds, each of shape (k,).

    Raises:
        FieldError: bounds of what has none, out of order, or beside the start.
    """
    start = transform.start()
    field = f"Free({free.path!r}).bounds"
    low, high = -np.inf, np.inf
    kind = _kind(model, keys)
    if isinstance(transform, Plain) and kind in _NOT_NEGATIVE:
        low, high = 0.0, _NOT_NEGATIVE[kind]
    if keys[0] == "channels" and keys[-1] == "delay":
        low, high = 0.0, np.inf
    if free.bounds is not None:
        if not isinstance(transform, (Plain, Positive)):
            remedy = "leave them out: its coordinates keep it physical; or give a prior"
            raise FieldError(field, free.bounds, "are for plain numbers", remedy)
        least, most = free.bounds
        low, high = low if least is None else least, high if most is None else most
    known = values_at(transform, start).value
    shape, value = known.shape, known.ravel()
    try:
        lower, upper = (
            np.ravel(np.broadcast_to(np.asarray(x, float), shape)) for x in (low, high)
        )
    except (TypeError, ValueError) as error:
        remedy = f"give (least, largest), numbers or arrays of shape {shape}"
        raise FieldError(field, free.bounds, "do not fit", remedy) from error
    slack = 1e-12 * np.abs(value)
    if not np.all(lower < upper):
        raise FieldError(field, free.bounds, "must be (least, largest)", "order them")
    if isinstance(transform, (Plain, Positive)) and not np.all(
        (lower <= value + slack) & (value - slack <= upper)
    ):
        problem = f"do not hold the start, {value.tolist()}"
        raise FieldError(field, free.bounds, problem, "widen them, or move the start")
    if isinstance(transform, Positive):
        with np.errstate(divide="ignore"):
            return np.log(np.maximum(lower, 0.0)), np.log(upper)
    if isinstance(transform, Plain):
        return lower, upper
    return np.full_like(start, -np.inf), np.full_like(start, np.inf)
