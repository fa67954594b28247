"""What distributions are made of: checked numbers of one shape, covariances."""

import hashlib
from collections.abc import Callable
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..validation.checks import FieldError, is_traced, real, refuse

_LISTED = 4096  # entries that a description lists; of more it has the digest


def inside(u: ArrayLike) -> Array:
    """Uniform numbers as floating ones strictly inside of (0, 1).

    Those of double precision that single precision would round to 0 or 1 stay inside.
    """
    known = jnp.asarray(u)
    if not jnp.issubdtype(known.dtype, jnp.floating):
        known = known.astype(jnp.result_type(float))
    limits = np.finfo(np.dtype(known.dtype))
    return jnp.clip(known, float(limits.tiny), 1.0 - 0.5 * float(limits.eps))


def numbers(field: str, value: Any) -> Array:
    """A number, or an array of any shape.

    Raises:
        FieldError: it is not made of finite numbers.
    """
    try:
        shape = jnp.asarray(value).shape if is_traced(value) else np.shape(value)
    except (TypeError, ValueError):
        shape = ()
    return real(field, value, shape, "a number, or an array of them")


def alike(kind: str, **values: Any) -> list[Array]:
    """Numbers of one shape: those of all entries are repeated.

    Args:
        kind: Distribution that is made.
        values: By argument.

    Raises:
        FieldError: not finite numbers, shapes that do not fit each other.
    """
    found = {name: numbers(f"{kind}.{name}", value) for name, value in values.items()}
    shapes = {name: array.shape for name, array in found.items()}
    try:
        shape = np.broadcast_shapes(*shapes.values())
    except ValueError as error:
        remedy = "give numbers for all entries, or arrays of one shape"
        problem = "have shapes that do not fit each other"
        raise FieldError(kind, shapes, problem, remedy) from error
    return [jnp.broadcast_to(array, shape) for array in found.values()]


def refuse_negative(field: str, array: Array) -> Array:
    """The array, unless an entry is below zero."""
    remedy = "give 0 or more"
    return refuse(array, lambda x: ~(x >= 0), field, "must not be negative", remedy)


def ordered(field: str, low: Array, high: Array) -> Array:
    """The lower ends, unless one is not below its upper end."""
    if is_traced(low, high):
        return refuse(low, ~(low < high), field, "", "")
    remedy = f"give less than the upper end, {np.asarray(high).tolist()}"
    bad = ~(np.asarray(low) < np.asarray(high))
    return refuse(low, bad, field, "must be below the upper end", remedy)


def log_share(share: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Logarithm of a share of a whole: -inf below 0, and 0 beyond 1."""
    some = share > 0.0
    known = jnp.log(jnp.clip(jnp.where(some, share, 1.0), None, 1.0))
    return jnp.where(some, known, -jnp.inf)


def unit(field: str, value: Any) -> Float[Array, "3"]:
    """The unit vector along three numbers.

    Raises:
        FieldError: not three finite numbers, or all zero.
    """
    vector = real(field, value, (3,), "three components of any length but zero")
    remedy = "give a vector of any length but zero"
    none: Callable[[Any], Any] = lambda x: ~(x != 0.0).any()
    vector = refuse(vector, none, field, "has no direction", remedy)
    vector = vector / jnp.max(jnp.abs(vector))  # so that no square overflows
    return vector / jnp.sqrt(jnp.sum(vector * vector))


def root_of(field: str, given: Any, matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower triangular L with ``L L^T`` the matrix, which may be semidefinite.

    A traced matrix has to be definite: L is NaN where it is not.

    Args:
        field: Name used in the error.
        given: The matrix as the user wrote it: known, where a program being traced
            makes an abstract value of it.
        matrix: As an array.

    Raises:
        FieldError: not symmetric, or with a negative eigenvalue.
    """
    if is_traced(given):
        return cast(Array, jnp.linalg.cholesky(matrix))
    known = np.asarray(given, float)
    variances = np.diag(known)
    # of each number in units of its own deviation, as units are the user's
    scale = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    scaled = known / np.outer(scale, scale)
    # a thousand units of rounding, of the numbers and of eigenvalues
    slack = 1e3 * float(np.finfo(np.dtype(matrix.dtype)).eps)
    if np.max(np.abs(scaled - scaled.T), initial=0.0) > slack:
        remedy = "write entry (i, j) equal to entry (j, i)"
        raise FieldError(field, known, "must be symmetric", remedy)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    if np.min(values, initial=0.0) < -slack:
        problem = "has a negative eigenvalue, which no numbers that vary together can"
        remedy = "give all digits of an estimate, or drop negative eigenvalues"
        raise FieldError(field, known, problem, remedy)
    square = vectors * np.sqrt(np.maximum(values, 0.0))
    lower = np.linalg.qr(square.T).R.T
    lower = scale[:, None] * lower * np.where(np.diag(lower) < 0.0, -1.0, 1.0)
    return jnp.asarray(lower, matrix.dtype)


def described(distribution: object, *names: str) -> dict[str, Any]:
    """Kind and named numbers, as JSON has them."""
    held = {name: listed(getattr(distribution, name)) for name in names}
    return {"kind": type(distribution).__name__, **held}


def listed(array: ArrayLike) -> Any:
    """An array as nested lists; a large one as its shape and its SHA-256."""
    known = np.asarray(array)
    if known.size <= _LISTED:
        # null and names, as JSON has no infinite numbers
        return _finite(known.tolist())
    stored = np.ascontiguousarray(known, dtype="<f8")
    digest = hashlib.sha256(stored.tobytes()).hexdigest()
    return {"shape": list(known.shape), "sha256": digest}


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(part) for part in cast("list[Any]", value)]
    return value if np.isfinite(value) else str(value)
