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
from .whole_numbers import in_range, of_real, type_of, whole_expression, whole_literal

# type in C of real numbers, whole ones and truth values
IN_C = {"real": "real", "whole": "int64_t", "truth": "int"}

_BETWEEN = ARITHMETIC | COMPARED | {"and": "&", "or": "|", "xor": "^"}
_OF_SEVERAL = {
    # the order of all numbers, what is not one behind them
    "lt_to": "({0} < {1}) | (({0} == {0}) & ({1} != {1}))",
    "le_to": "({0} <= {1}) | ({1} != {1})",
    "nextafter": "C(nextafter)({0}, {1})",
    "select_n": "{0} ? {2} : {1}",
    "clamp": "max_one({0}, min_one({1}, {2}))",
    "not": "!{0}",  # of a truth value
}


class Number(NamedTuple):
    """A number of a program in C.

    Attributes:
        text: How it is written.
        type: ``real``, ``whole`` or ``truth``.
    """

    text: str
    type: str


def in_c(x: Any) -> Number:
    """A number, known or not."""
    if isinstance(x, Number):
        return x
    if isinstance(x, (bool, TRUTH)):
        return Number(str(int(x)), "truth")
    if isinstance(x, WHOLE):
        return Number(whole_literal(x), "whole")
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
        return _converted(given[0], np.dtype(params["new_dtype"]))
    if kind == "whole" and name != "select_n":
        return whole_expression(name, texts, dtype, "_one")
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


def _converted(x: Number, dtype: np.dtype) -> str:
    kind = type_of(dtype)
    if kind == "truth":
        return f"{x.text} != 0"
    if kind == "whole" and x.type == "real":
        return of_real(x.text, dtype, "_one")
    if kind == "whole":
        return in_range(x.text, dtype, "_one")
    return x.text if x.type == "real" else f"({IN_C[kind]}){x.text}"
