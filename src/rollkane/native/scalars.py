"""Numbers of a program in C, of the types that they have there, and operations on them.

Whole numbers stay whole here, unlike in the rows of many motions (``listing``).
"""

from typing import Any, NamedTuple

import numpy as np

from ..numberwise import NotElementwiseError
from .listing import literal

# type in C of real numbers, whole ones and truth values
IN_C = {"real": "real", "whole": "long", "truth": "int"}

_BETWEEN = {
    "add": "+",
    "add_any": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "lt": "<",
    "le": "<=",
    "gt": ">",
    "ge": ">=",
    "eq": "==",
    "ne": "!=",
    "and": "&",
    "or": "|",
    "xor": "^",
}
_FORMULAS = {
    "neg": "-{0}",
    "square": "{0} * {0}",
    "one_minus_square": "((real)1 + {0}) * ((real)1 - {0})",
    "rsqrt": "(real)1 / sqrt_one({0})",
    "logistic": "(real)1 / ((real)1 + exp_one(-{0}))",
    "is_finite": "({0} - {0}) == ({0} - {0})",
    # the order of all numbers, what is not one behind them
    "lt_to": "({0} < {1}) | (({0} == {0}) & ({1} != {1}))",
    "le_to": "({0} <= {1}) | ({1} != {1})",
    "nextafter": "C(nextafter)({0}, {1})",
    "select_n": "{0} ? {2} : {1}",
}
_OF_WHOLE = {
    "div": "div_whole({0}, {1})",
    "rem": "rem_whole({0}, {1})",
    "abs": "({0} < 0 ? -{0} : {0})",
    "sign": "({0} > 0) - ({0} < 0)",
    "max": "({0} > {1} ? {0} : {1})",
    "min": "({0} < {1} ? {0} : {1})",
    "not": "~{0}",
    "shift_left": "{0} << {1}",
    "shift_right_arithmetic": "{0} >> {1}",
}
_FUNCTIONS = frozenset(
    """
    abs acos acosh asin asinh atan atan2 atanh cbrt ceil cos cosh exp exp2 expm1 floor
    log log1p max min pow rem sign sin sinh sqrt tan tanh
    """.split()  # noqa: SIM905 -- words read better than a column of strings
)


class Number(NamedTuple):
    """A number of a program in C.

    Attributes:
        text: How it is written.
        type: ``real``, ``whole`` or ``truth``.
    """

    text: str
    type: str


def type_of(dtype: Any) -> str:
    """Of the numbers of an array."""
    if dtype == np.bool_:
        return "truth"
    return "whole" if np.issubdtype(dtype, np.integer) else "real"


def in_c(x: Any) -> Number:
    """A number, known or not."""
    if isinstance(x, Number):
        return x
    if isinstance(x, (bool, np.bool_)):
        return Number(str(int(x)), "truth")
    if isinstance(x, np.integer):
        return Number(f"{int(x)}L", "whole")
    if isinstance(x, np.floating):
        return Number(literal(float(x)), "real")
    raise NotElementwiseError(f"a number of {type(x)}")


def expression(name: str, params: Any, operands: list, dtype: Any) -> str:
    """One operation on numbers, of which at least one is not known, in C.

    Raises:
        NotElementwiseError: C has none, or none for numbers of this type.
    """
    given = [in_c(x) for x in operands]
    texts = [x.text for x in given]
    kind = given[-1].type
    if name == "convert_element_type":
        return _converted(given[0], type_of(params["new_dtype"]))
    if name == "clamp":
        least, x, most = texts
        if kind == "real":
            return f"max_one({least}, min_one({x}, {most}))"
        return f"{x} < {least} ? {least} : {x} > {most} ? {most} : {x}"
    if name == "not" and kind == "truth":
        return f"!{texts[0]}"
    if kind == "whole" and name in _OF_WHOLE:
        return _OF_WHOLE[name].format(*texts)
    if name == "select_n" and len(texts) != 3:
        raise NotElementwiseError("a choice among many")
    if name in _BETWEEN:
        return f"{texts[0]} {_BETWEEN[name]} {texts[1]}"
    if name in _FORMULAS:
        return _FORMULAS[name].format(*texts)
    if name in _FUNCTIONS and kind != "truth" and type_of(dtype) == "real":
        return f"{name}_one({', '.join(texts)})"
    raise NotElementwiseError(f"{name} of {kind} numbers")


def _converted(x: Number, kind: str) -> str:
    if kind == x.type:
        return x.text
    if kind == "truth":
        return f"{x.text} != 0"
    if kind == "whole" and x.type == "real":
        return f"whole_of({x.text})"
    return f"({IN_C[kind]}){x.text}"
