"""Operations on whole numbers in C, as XLA has them: they wrap, and are never trapped.

A whole number has 64 bits in C, one or one for each lane (``rows.h``); behind what may
lead out of its own type it is wrapped to that type.
"""

from typing import Any

import numpy as np

from .known_numbers import WHOLE
from .scalar_program import NotElementwiseError

_OF_NUMBERS = """
    abs add and clamp div eq ge gt le lt max min mul ne neg not or rem sign square sub
    xor
    """.split()  # noqa: SIM905 -- words read better than a column of strings
# by XLA's names, those in C; and what never leads out of a type
_NAMES = dict(zip(_OF_NUMBERS, _OF_NUMBERS, strict=True)) | {
    "add_any": "add",
    "shift_left": "left",
    "shift_right_arithmetic": "right",
    "shift_right_logical": "logical",
}
_STAYS = frozenset(
    "and clamp eq ge gt le lt max min ne or rem sign xor".split()  # noqa: SIM905
)

_BY_BITS = {"shift_right_arithmetic": "int", "shift_right_logical": "uint"}


def type_of(dtype: np.dtype) -> str:
    """What numbers of a type are in C: ``real``, ``whole`` or ``truth``.

    Raises:
        NotElementwiseError: they are none of these: complex, or whole beyond 2^63.
    """
    if dtype.kind not in "biuf" or dtype == np.uint64:
        raise NotElementwiseError(f"numbers of {dtype}")
    return {"b": "truth", "i": "whole", "u": "whole", "f": "real"}[dtype.kind]


def whole_expression(name: str, texts: list[str], dtype: np.dtype, ending: str) -> str:
    """One operation on whole numbers, in C.

    Args:
        name: XLA's name of it.
        texts: Its operands.
        dtype: Of the result: a whole number's, or a comparison's.
        ending: ``_one``, or ``_row`` where the operands are rows.

    Raises:
        NotElementwiseError: C has no such operation.
    """
    known = _NAMES.get(name)
    if known is None:
        raise NotElementwiseError(f"{name} of whole numbers")
    if name in _BY_BITS:  # as if it had a sign, or none
        first = np.dtype(f"{_BY_BITS[name]}{8 * dtype.itemsize}")
        texts = [in_range(texts[0], first, ending), *texts[1:]]
    text = f"{known}_whole{ending}({', '.join(texts)})"
    return text if known in _STAYS else in_range(text, dtype, ending)


def in_range(text: str, dtype: np.dtype, ending: str) -> str:
    """A whole number wrapped to its type, by its last bits."""
    return text if dtype.itemsize == 8 else f"{dtype.name}_of{ending}({text})"


def of_real(text: str, dtype: np.dtype, ending: str) -> str:
    """A real number cut to a whole one: the nearest that the type has, of NaN zero."""
    bits = 8 * dtype.itemsize
    return f"whole_of{ending}({text}, {bits}, {int(dtype.kind == 'i')})"


def whole_literal(x: Any) -> str:
    """A known whole number in C."""
    # C has no negative literals: the least number would be none of its type
    least = int(x) == -(2**63)
    return f"(-INT64_C({2**63 - 1}) - 1)" if least else f"INT64_C({int(x)})"


def are_whole(operands: list[Any]) -> bool:
    """Whether an operation is one on whole numbers, known or not."""
    return all(isinstance(x, WHOLE) or getattr(x, "whole", False) for x in operands)
