"""Bad input: one way to refuse it, naming the field, the value and the remedy.

Known numbers are checked at once and refused with a :class:`FieldError`. Numbers that
are still being traced by JAX become NaN instead, in ``jit``, ``vmap`` and derivatives
alike: a run with them ends with a code and names the field
(:mod:`rollkane.validation.codes`), and a member of a batch fails alone. Nothing calls
back to the host.
"""

import decimal
import numbers
from collections.abc import Callable
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer, eval_context
from jax.typing import ArrayLike
from jaxtyping import Array, Float

_T = TypeVar("_T")
# what isinstance tells apart, of any element type
_ARRAYS: tuple[type[Any], ...] = (np.ndarray, jax.Array)
_TRUTHS: tuple[type[Any], ...] = (bool, np.bool_)
_WHOLE: tuple[type[Any], ...] = (int, np.integer)
_EXACT = numbers.Real, decimal.Decimal
_NUMBERS = {int, float, np.float64}  # most of what lists are made of
# of NumPy's kinds of durations and dates
_IN_SECONDS = {
    "m": '{0} / np.timedelta64(1, "s")',
    "M": '({0} - {0}[0]) / np.timedelta64(1, "s")',
}


class FieldError(ValueError):
    """A field with a value that cannot be used.

    Attributes:
        field: Where it stands, for example ``Body.mass``.
        value: What was given.
        problem: What is wrong with it.
        remedy: What to do.
    """

    def __init__(self, field: str, value: Any, problem: str, remedy: str):
        """Say what is wrong with which field, and what to do (see the class)."""
        self.field, self.value, self.problem, self.remedy = (
            field,
            value,
            problem,
            remedy,
        )
        super().__init__(f"{field}: {problem}, got {_shown(value)}; {remedy}")


def _shown(value: Any) -> str:
    if isinstance(value, Tracer):
        return f"a traced {value.dtype}{list(value.shape)}"
    if isinstance(value, _ARRAYS):
        value = np.asarray(value).tolist()
    name = getattr(value, "__name__", None)
    text = f"the function {name}" if callable(value) and name else repr(value)
    if not isinstance(value, str):
        text = " ".join(text.split())  # what is shown in several lines
    return text if len(text) <= 200 else text[:197] + "..."


def is_traced(*values: Any) -> bool:
    """Whether any leaf is an abstract value of a JAX transformation."""
    for value in values:
        if isinstance(value, Tracer):
            return True
        if isinstance(value, _ARRAYS):  # in a fifth of the time of a tree of one
            continue
        if any(isinstance(x, Tracer) for x in jax.tree.leaves(value)):
            return True
    return False


def known_in_a_trace(function: Callable[..., _T], *known: Any) -> _T:
    """What a function gives of known numbers, known though a trace is under way.

    Where it holds traced ones, what it gives is traced, too.
    """
    try:
        with eval_context():
            return function(*known)
    except jax.errors.UnexpectedTracerError:
        return function(*known)


def known_array(numbers: ArrayLike) -> Array:
    """Known numbers for JAX, in the middle of a trace, too.

    What follows from them is then found once. ``jnp.asarray`` would make traced ones of
    them in ``jit``, and compile a program for each new shape.
    """
    with eval_context():
        return jax.device_put(np.array(numbers))  # a copy, as JAX may keep it


def dimension(value: Any) -> int:
    """How many axes numbers have: NumPy tells it of no list that holds traced ones."""
    if isinstance(value, (list, tuple)):
        entries = cast("list[Any]", value)
        return 1 + (dimension(entries[0]) if entries else 0)
    return np.ndim(value)


def real_numbers(field: str, value: Any, remedy: str) -> Any:
    """An array of real numbers of any shape: NumPy's, or JAX's where it is traced.

    Fractions, decimals and long whole numbers become floats. What NumPy would turn into
    numbers silently is refused: texts, truth values, complex numbers, dates and
    durations (of any unit), masked entries.

    Args:
        field: Name used in the error.
        value: Number, nested sequence or array.
        remedy: What to do where it is none.

    Raises:
        FieldError: it is not made of real numbers.
    """
    if isinstance(value, (str, bytes, bool)) or value is None:
        raise FieldError(field, value, "must be made of numbers", remedy)
    if np.ma.is_masked(value):
        raise FieldError(field, value, "must have no masked entries", remedy)
    if _has_truths(value):  # which NumPy makes numbers of where others are beside them
        raise FieldError(field, value, "must be made of real numbers", remedy)
    try:
        # NumPy where the numbers are known: each jnp call would compile a program
        array: Any = jnp.asarray(value) if is_traced(value) else np.asarray(value)
        if array.dtype == object and all(isinstance(x, _EXACT) for x in array.flat):
            array = array.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise FieldError(field, value, "must be made of numbers", remedy) from error
    kind = getattr(array.dtype, "kind", "")  # a key's type has none
    if kind not in "iuf" and not jnp.issubdtype(array.dtype, jnp.floating):
        if kind in _IN_SECONDS:
            name = field.rpartition(".")[2]
            remedy = "give " + _IN_SECONDS[kind].format(name)
        raise FieldError(field, value, "must be made of real numbers", remedy)
    return array


def _has_truths(value: Any) -> bool:
    """Whether a truth value is anywhere in nested lists."""
    if not isinstance(value, (list, tuple)):
        return getattr(getattr(value, "dtype", None), "kind", "") == "b"
    entries = cast("list[Any]", value)
    kinds = set(map(type, entries))  # in a tenth of the time of a look at each
    if not kinds.isdisjoint(_TRUTHS):
        return True
    return not kinds <= _NUMBERS and any(map(_has_truths, entries))


def real(
    field: str,
    value: Any,
    shape: tuple[int | None, ...],
    meaning: str,
    dtype: np.dtype[Any] | None = None,
) -> Array:
    """Convert to an array of floats of the given shape, or say why it cannot be.

    What is known stays so inside of ``jit``.

    Args:
        field: Name used in the error.
        value: Number, nested sequence or array; floating arrays keep their dtype.
        shape: Wanted shape; None stands for any length of that axis.
        meaning: What the field is, with its unit, for the remedy.
        dtype: Of the array; None: of the value.
    """
    remedy = f"give {meaning}"
    array = real_numbers(field, value, remedy)
    matches = len(shape) == array.ndim and all(
        wanted in (None, found)
        for wanted, found in zip(shape, array.shape, strict=True)
    )
    if not matches:
        wanted = "(" + ", ".join("n" if n is None else str(n) for n in shape) + ")"
        raise FieldError(
            field, value, f"must have shape {wanted}, not {array.shape}", remedy
        )
    if array.dtype.itemsize < 4 and jnp.issubdtype(array.dtype, jnp.floating):
        problem, precise = "is in half precision", "give float64, or float32"
        raise FieldError(field, value, problem, precise)
    widest = jnp.result_type(float)
    if array.dtype.kind in "iu" or array.dtype.itemsize > widest.itemsize:
        array = array.astype(widest)
    if dtype is not None and array.dtype != dtype:
        array = array.astype(dtype)
    if is_traced(array):
        return cast(Array, _finite_or_nan(array))
    array = refuse(array, lambda x: ~(abs(x) < np.inf), field, "must be finite", remedy)
    return known_array(array)


def checked_kinks(field: str, kinks: Any) -> Float[Array, " k"] | None:
    """Times at which a function of time jumps [s], of those that may be given.

    Args:
        field: Name used in the error.
        kinks: Shape (k,); None: none are known.
    """
    if kinks is None:
        return None
    return real(field, kinks, (None,), "times in seconds")


@jax.jit
def _finite_or_nan(array: Array) -> Array:
    return spoilt(array, ~jnp.all(jnp.abs(array) < jnp.inf))


def spoilt(array: ArrayLike, bad: ArrayLike) -> Array:
    """The array, or NaN where it is bad: its derivatives, backwards too."""
    array = jnp.asarray(array)
    return array * jnp.where(bad, jnp.nan, 1.0).astype(array.dtype)


@jax.custom_jvp
def cleared(array: Array, good: Array) -> Array:
    """The array, or zeros where it is not good; their derivatives are NaN."""
    return jnp.where(good, array, 0.0)


@cleared.defjvp
def _(
    primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    array, good = primals
    return cleared(array, good), spoilt(tangents[0], ~good)


def refuse(
    array: Any,
    bad: ArrayLike | Callable[[Any], Any],
    field: str,
    problem: str,
    remedy: str,
) -> Any:
    """Return ``array`` unless it is bad.

    Args:
        array: What is checked, and returned.
        bad: Where it is bad, as a truth value, or as a function of it that takes a
            NumPy array (known numbers) as well as a traced one.
        field: Name used in the error.
        problem: What is wrong with it.
        remedy: What to do.

    Raises:
        FieldError: known numbers that are bad; traced ones become NaN.
    """
    where: Any = bad
    if callable(bad):
        where = bad(array if is_traced(array) else np.asarray(array))
    if not is_traced(array, where):
        if bool(np.any(np.asarray(where))):  # a program of JAX's, of a JAX array
            raise FieldError(field, array, problem, remedy)
        return array
    return spoilt(array, jnp.any(where))


def positive(
    field: str, value: Any, shape: tuple[int | None, ...], meaning: str
) -> Array:
    """A finite number (or array of them) greater than zero."""
    array = real(field, value, shape, meaning)
    return refuse(
        array, lambda x: ~(x > 0), field, "must be positive", f"give {meaning}"
    )


def refuse_disorder(field: str, times: Any) -> None:
    """Refuse known sample times that do not increase, naming the first pair.

    Args:
        field: Name used in the error.
        times: Known numbers [s], shape (N,), as they were given.

    Raises:
        FieldError: one is no later than the one before.
    """
    falls = np.flatnonzero(np.diff(times) <= 0.0)
    if falls.size:
        row = int(falls[0]) + 1
        # all digits: what falls may do so in the last one
        pair = f"row {row} has {times[row]!s} s after {times[row - 1]!s} s"
        remedy = "sort the samples by time, and leave out repeated times"
        raise FieldError(field, times, f"is out of order: {pair}", remedy)


def flag(field: str, value: object) -> bool:
    """True or False, and nothing that merely looks like it."""
    if not isinstance(value, _TRUTHS):
        raise FieldError(field, value, "must be True or False", "write one of the two")
    return bool(value)


def whole(field: str, value: Any, least: int, remedy: str) -> int:
    """A whole number, no less than another.

    Raises:
        FieldError: it is not.
    """
    good = isinstance(value, _WHOLE) and not isinstance(value, bool)
    if not good or value < least:
        problem = f"must be a whole number of at least {least}"
        raise FieldError(field, value, problem, remedy)
    return int(value)


def not_negative(field: str, value: Any, unit: str) -> Float[Array, ""]:
    """A number that is zero or more.

    Raises:
        FieldError: it is not.
    """
    value = real(field, value, (), f"a number {unit}")
    return refuse(
        value, lambda x: ~(x >= 0.0), field, "must not be negative", "give 0 or more"
    )
