"""Numbers of a program in C, of the types that they have there, and operations on them.

Whole numbers stay whole here, unlike in the rows of many motions (``scalar_source``).
"""

from typing import Any, NamedTuple

import numpy as np

from .jaxpr_types import Params
from .known_numbers import REAL, TRUTH, WHOLE
from .scalar_program import NotElementwiseError
from .scalar_source import (
    ARITHMETIC,
    COMPARED,
    FORMULAS,
    FUNCTIONS,
    ROUNDED,
    literal,
)

# type in C of real numbers, whole ones and truth values
IN_C = {"real": "real", "whole": "long", "truth": "int"}

_BETWEEN = ARITHMETIC | COMPARED | {"and": "&", "or": "|", "xor": "^"}
_OF_SEVERAL = {
    # the order of all numbers, what is not one behind them
    "lt_to": "({0} < {1}) | (({0} == {0}) & ({1} != {1}))",
    "le_to": "({0} <= {1}) | ({1} != {1})",
    "nextafter": "C(nextafter)({0}, {1})",
    "select_n": "{0} ? {2} : {1}",
    "clamp": "max_one({0}, min_one({1}, {2}))",
}
_OF_TRUTH = {"not": "!{0}"}
_OF_WHOLE = {
    "clamp": "{1} < {0} ? {0} : {1} > {2} ? {2} : {1}",
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


class Number(NamedTuple):
    """A number of a program in C.

    Attributes:
        text: How it is written.
        type: ``real``, ``whole`` or ``truth``.
    """

    text: str
    type: str


def type_of(dtype: np.dtype) -> str:
    """Of the numbers of an array."""
    return {"b": "truth", "i": "whole", "u": "whole"}.get(dtype.kind, "real")


def in_c(x: Any) -> Number:
    """A number, known or not."""
    if isinstance(x, Number):
        return x
    if isinstance(x, (bool, TRUTH)):
        return Number(str(int(x)), "truth")
    if isinstance(x, WHOLE):
        # C has no negative literals: the least number would be none of its type
        least = int(x) == -(2**63)
        return Number(f"({int(x) + 1}L - 1)" if least else f"{int(x)}L", "whole")
    if isinstance(x, REAL):
        return Number(literal(float(x)), "real")
    raise NotElementwiseError(f"a number of {type(x)}")


def expression(name: str, params: Params, operands: list[Any], dtype: np.dtype) -> str:
    """One operation on numbers, of which at least one is not known, in C.

    Raises:
        NotElementwiseError: C has none, or none for numbers of this type.
    """
    given = [in_c(x) for x in operands]
    texts = [x.text for x in given]
    kind = given[-1].type
    if name == "convert_element_type":
        return _converted(given[0], type_of(params["new_dtype"]))
    own = {"whole": _OF_WHOLE, "truth": _OF_TRUTH}.get(kind, {})
    if name in own:
        return own[name].format(*texts)
    if name == "select_n" and len(texts) != 3:
        raise NotElementwiseError("a choice among many")
    if name in _BETWEEN:
        return f"{texts[0]} {_BETWEEN[name]} {texts[1]}"
    if name in _OF_SEVERAL:
        return _OF_SEVERAL[name].format(*texts)
    if name == "round":
        return f"{ROUNDED[int(params['rounding_method'])]}_one({texts[0]})"
    if name in FORMULAS:
        return FORMULAS[name].format(texts[0], "_one")
    if name in FUNCTIONS and kind != "truth" and type_of(dtype) == "real":
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
