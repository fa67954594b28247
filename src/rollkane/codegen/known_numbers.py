"""Operations on single numbers of which some, or all, are known: nothing is written."""

import operator
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from .jaxpr_types import Params

# what known numbers are: of any precision, which NumPy's types have as a parameter
KNOWN: type[Any] = np.generic
TRUTH: type[Any] = np.bool_
WHOLE: type[Any] = np.integer
REAL: type[Any] = np.floating
_IN_NUMPY: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "add_any": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,  # as IEEE 754 has it, in any library
    "neg": operator.neg,
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
    "max": np.maximum,
    "min": np.minimum,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "not": np.invert,
    "abs": np.abs,
    "square": np.square,
    # of JAX 0.12 and later
    "one_minus_square": lambda x: (1 - x) * (1 + x),
    "sqrt": np.sqrt,
    "is_finite": np.isfinite,
}
# those that a walk does itself, and that numbers take as they are
_BY_THEMSELVES = (
    "select_n",
    "integer_pow",
    "convert_element_type",
    "copy",
    "stop_gradient",
)


def is_quick(name: str) -> bool:
    """Whether an operation on known numbers is done without XLA."""
    return name in _IN_NUMPY or name in _BY_THEMSELVES


def of_known(name: str, params: Params, operands: list[Any], dtype: np.dtype) -> Any:
    """The number that an operation on known numbers gives."""
    if name in ("div", "rem") and dtype.kind in "iu" and int(operands[1]) > 0:
        return dtype.type(_whole_quotient(*map(int, operands))[name == "rem"])
    known = _IN_NUMPY.get(name)
    if known is not None and (name != "div" or dtype.kind == "f"):
        return dtype.type(known(*operands))
    cut = isinstance(operands[0], REAL) and dtype.kind in "iu"  # by XLA's own rules
    if name in ("copy", "convert_element_type", "stop_gradient") and not cut:
        return operands[0].astype(dtype)
    # rare: whatever XLA makes of it
    primitive = getattr(jax.lax, name + "_p")
    with jax.ensure_compile_time_eval():
        given = [jax.numpy.asarray(x) for x in operands]
        return dtype.type(primitive.bind(*given, **params))


def _whole_quotient(a: int, b: int) -> tuple[int, int]:
    """Rounded towards zero, and what is left of the number."""
    quotient = abs(a) // b if a >= 0 else -(abs(a) // b)
    return quotient, a - quotient * b


def _is(x: Any, value: float) -> bool:
    return isinstance(x, KNOWN) and bool(x == value)


def _times(a: Any, b: Any) -> Any:
    for x, y in ((a, b), (b, a)):
        if _is(x, 0):
            return x
        if _is(x, 1):
            return y
    return None


def _plus(a: Any, b: Any) -> Any:
    return b if _is(a, 0) else a if _is(b, 0) else None


def _both(a: Any, b: Any) -> Any:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, TRUTH):
            return y if x else x
    return None


def _either(a: Any, b: Any) -> Any:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, TRUTH):
            return x if x else y
    return None


def _the_only(which: Any, *options: Any) -> Any:
    del which
    return options[0] if all(x is options[0] for x in options) else None


# zero times something is zero, even where the other factor is not finite
SHORTCUTS: dict[str, Callable[..., Any]] = {
    "mul": _times,
    "add": _plus,
    "add_any": _plus,
    "sub": lambda a, b: a if _is(b, 0) else None,
    "div": lambda a, b: a if _is(a, 0) or _is(b, 1) else None,
    "and": _both,
    "or": _either,
    "select_n": _the_only,
    "copy": lambda x: x,
    "stop_gradient": lambda x: x,
}
