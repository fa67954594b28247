"""A program of single numbers as C functions.

A number is one for all lanes, a C scalar, or a row of one value for each lane, a vector
of the compiler's. What is the same at all stages of all steps is computed once a call.
"""

import functools
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from .data_movement import Numbers, as_objects
from .fused import FUSED, Products
from .jaxpr_types import Params, Shaped
from .known_numbers import REAL, TRUTH, WHOLE
from .scalar_program import NotElementwiseError
from .stage_text import Signature, Statement, function_source, used
from .whole_numbers import (
    are_whole,
    in_range,
    of_real,
    type_of,
    whole_expression,
    whole_literal,
)

# how XLA's operations are written: between two numbers, or as functions of rows.h;
# the ending of their names says whether of a row
ARITHMETIC = {"add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/"}
COMPARED = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
_LOGICAL = {"and": "&", "or": "|"}
FORMULAS = {
    "copy": "{0}",  # a sum with nothing, no product any more
    "neg": "-{0}",
    "square": "{0} * {0}",
    "one_minus_square": "((real)1 + {0}) * ((real)1 - {0})",
    "rsqrt": "(real)1 / sqrt{1}({0})",
    "logistic": "(real)1 / ((real)1 + exp{1}(-{0}))",
    "is_finite": "({0} - {0}) == ({0} - {0})",
}
FUNCTIONS = frozenset(
    """
    abs acos acosh asin asinh atan atan2 atanh cbrt ceil cos cosh erf erfc exp exp2
    expm1 floor lgamma log log1p max min pow rem sign sin sinh sqrt tan tanh
    """.split()  # noqa: SIM905 -- words read better than a column of strings
).union(FUSED)
_OF_SEVERAL = {
    # the order of all numbers: what is not one behind them
    "lt_to": "({0} < {1}) | (({0} == {0}) & ({1} != {1}))",
    "le_to": "({0} <= {1}) | ({1} != {1})",
    "not": "not{end}({0})",
    "clamp": "max{end}({0}, min{end}({1}, {2}))",
}
# half a number away from zero, or to the even one, by XLA's number of the way
ROUNDED = {0: "round", 1: "rint"}
_PLACE = re.compile(r"shared\[(\d+)\]")  # of a number that lies in memory


class Symbol(NamedTuple):
    """A number of the C program.

    Attributes:
        text: How it is written.
        row: Whether every lane has its own.
        truth: Whether it is true or false.
        fixed: Whether it is the same at all stages.
        whole: Whether it is a whole number; none is the same at all stages, as real
            numbers are what a call hands to them.
    """

    text: str
    row: bool
    truth: bool = False
    fixed: bool = False
    whole: bool = False

    @property
    def kind(self) -> str:
        """Its type in C."""
        if self.whole:
            return "whole_row" if self.row else "int64_t"
        if self.row:
            return "mask" if self.truth else "row"
        return "int" if self.truth else "real"


class Statements:
    """C statements as they come, those of a call apart from those of a stage.

    Attributes:
        before: Symbols that all stages share, each with its expression.
        stage: Symbols that are computed at every stage.
        tables: Known numbers that are looked up, and the names of such arrays in C.
    """

    def __init__(self):
        """An empty program."""
        self.before: list[tuple[Symbol, str]] = []
        self.stage: list[tuple[Symbol, str]] = []
        self.tables: dict[str, str] = {}
        self._written: dict[tuple[str, bool], Symbol] = {}
        self._products = Products()

    def operate(
        self, name: str, params: Params, operands: list[Any], dtype: np.dtype
    ) -> Symbol:
        """Write one operation; see :class:`rollkane.codegen.scalar_program.Program`."""
        truth, whole = dtype == np.bool_, np.issubdtype(dtype, np.integer)
        if name == "lookup":
            return self._looked_up(*operands)
        if name == "copy" and not self._products.holds(operands[0]):
            return operands[0]
        real = not truth and not whole
        if real:
            name, operands = self._products.fused(name, operands)
        known = [x for x in operands if isinstance(x, Symbol)]
        row = any(x.row for x in known)
        fixed = all(x.fixed for x in known) and not whole
        text = _expression(name, params, operands, row, dtype)
        symbol = self._symbol(text, Symbol("", row, truth, fixed, whole))
        if real:
            self._products.note(name, operands, symbol.text)
        return symbol

    def _symbol(self, text: str, like: Symbol) -> Symbol:
        """What an expression gives: written once."""
        if (text, like.whole) in self._written:  # computed before
            return self._written[text, like.whole]
        statements = self.before if like.fixed else self.stage
        name = f"{'b' if like.fixed else 's'}{len(statements)}"
        symbol = like._replace(text=name)
        statements.append((symbol, text))
        self._written[text, like.whole] = symbol
        return symbol

    def _looked_up(self, index: Symbol, numbers: Numbers) -> Symbol:
        """The number at an index, of numbers that are known or lie in an array in C."""
        if all(isinstance(x, np.floating) for x in numbers):
            values = ", ".join(literal(float(x)) for x in numbers)
            table = self.tables.setdefault(values, f"table{len(self.tables)}")
            stride = 1
        else:
            table, stride = _in_memory(numbers)
        ending = "_row" if index.row else "_one"
        at = _real(index, index.row)
        text = f"lookup{ending}({table}, {stride}, {len(numbers)}, {at})"
        return self._symbol(text, Symbol("", index.row, fixed=index.fixed))


def _in_memory(numbers: Numbers) -> tuple[str, int]:
    """Where numbers lie in an array in C, and how far apart."""
    texts = [x.text if isinstance(x, Symbol) else "" for x in numbers]
    places = [place for place in map(_place, texts) if place is not None]
    stride = places[1] - places[0] if len(places) > 1 else 1
    first = places[0] if places else 0
    if stride < 1 or places != [first + stride * i for i in range(len(texts))]:
        raise NotElementwiseError("a lookup among numbers that are computed")
    return f"shared + {first}", stride


# a record's numbers are looked up in some ten times: some 7 MB of short texts at most
@functools.lru_cache(2**16)
def _place(text: str) -> int | None:
    """Which of the shared numbers a text in C reads."""
    found = _PLACE.fullmatch(text)
    return None if found is None else int(found[1])


def _expression(
    name: str, params: Params, operands: list[Any], row: bool, dtype: np.dtype
) -> str:
    ending = "_row" if row else "_one"
    if name == "convert_element_type":
        return _converted(operands[0], dtype, row)
    texts = [_written(x, row) for x in operands]
    if name == "select_n":
        return _chosen(texts, operands[1:], ending)
    if are_whole(operands):
        return whole_expression(name, texts, dtype, ending)
    if name in ARITHMETIC or name in COMPARED:
        a, b = (_written(x, row and not isinstance(x, Symbol)) for x in operands)
        return f"{a} {(ARITHMETIC | COMPARED)[name]} {b}"
    if name in _LOGICAL:
        return f" {_LOGICAL[name]} ".join(texts)
    if name in FORMULAS:
        return FORMULAS[name].format(texts[0], ending)
    if name == "round":
        return f"{ROUNDED[int(params['rounding_method'])]}{ending}({texts[0]})"
    if name in _OF_SEVERAL:
        return _OF_SEVERAL[name].format(*texts, end=ending)
    if name in FUNCTIONS:
        return f"{name}{ending}({', '.join(texts)})"
    raise NotElementwiseError(name)


def _chosen(texts: list[str], options: list[Any], ending: str) -> str:
    """One of two numbers."""
    which, first, second = texts
    x = options[0]
    if x.truth if isinstance(x, Symbol) else isinstance(x, TRUTH):
        return f"({which} & {second}) | (not{ending}({which}) & {first})"
    kind = "_whole" if are_whole(options) else ""
    return f"choose{kind}{ending}({which}, {second}, {first})"


def _converted(x: Symbol, dtype: np.dtype, row: bool) -> str:
    ending = "_row" if row else "_one"
    kind = type_of(dtype)
    if kind == "real":  # of a real one: a program has one precision
        return _real(x, row)
    if kind == "truth" and x.whole:
        return f"ne_whole{ending}({x.text}, {_written(np.int64(0), row)})"
    if kind == "truth":
        return f"{x.text} != (real)0"
    if x.truth:
        return f"whole_of_mask({x.text})" if row else f"(int64_t){x.text}"
    by_type = in_range if x.whole else of_real
    return by_type(x.text, dtype, ending)


def _real(x: Symbol, row: bool) -> str:
    """A number as a real one."""
    if x.truth:
        one, zero = (_written(np.float64(value), row) for value in (1.0, 0.0))
        return f"choose{'_row' if row else '_one'}({x.text}, {one}, {zero})"
    if x.whole:
        return f"real_of_whole_row({x.text})" if row else f"(real){x.text}"
    return x.text


def _written(x: Any, as_row: bool) -> str:
    """A symbol or a known number; as a row where it has to be one."""
    if isinstance(x, Symbol):
        text, spread, truth, whole = x.text, as_row and not x.row, x.truth, x.whole
    elif isinstance(x, TRUTH):
        text, spread, truth, whole = str(int(x)), as_row, True, False
    elif isinstance(x, WHOLE):
        text, spread, truth, whole = whole_literal(x), as_row, False, True
    elif isinstance(x, REAL):
        text, spread, truth, whole = literal(float(x)), as_row, False, False
    else:
        raise NotElementwiseError(f"a number of {type(x)}")
    if not spread:
        return text
    name = "mask_of" if truth else "splat_whole" if whole else "splat"
    return f"{name}({text})"


def literal(value: float) -> str:
    """A number in C, to the last bit."""
    if np.isfinite(value):
        return f"(real){value.hex()}"
    if np.isnan(value):
        return "(real)NAN"
    return "(real)INFINITY" if value > 0 else "-(real)INFINITY"


def in_order(
    name: str, arrays: Sequence[Shaped], dtype: np.dtype, first: int = 0, *, row: bool
) -> list[Numbers]:
    """Numbers of fixed arrays that lie one behind the other, from the first on."""
    found: list[Numbers] = []
    for x in arrays:
        if x.dtype != dtype:
            raise NotElementwiseError(f"numbers of {x.dtype}")
        found.append(array(name, x.shape, first, row=row, fixed=True))
        first += math.prod(x.shape)
    return found


def array(
    name: str,
    shape: tuple[int, ...],
    first: int = 0,
    *,
    row: bool,
    fixed: bool = False,
) -> Numbers:
    """Symbols of an array's numbers, from the first on, as a part of an array in C."""
    texts = [f"{name}[{first + i}]" for i in range(math.prod(shape))]
    return symbols(texts, shape, row=row, fixed=fixed)


def symbols(
    texts: list[str], shape: tuple[int, ...], *, row: bool, fixed: bool = False
) -> Numbers:
    """Symbols of these texts, in order."""
    return as_objects([Symbol(text, row, fixed=fixed) for text in texts], shape)


class Functions(NamedTuple):
    """``prepare``, called once, and ``rates``, called at every stage, in C.

    Attributes:
        text: Of both.
        numbers: How many numbers ``prepare`` leaves for ``rates``.
        rows: How many rows it leaves.
    """

    text: str
    numbers: int
    rows: int


class Result(NamedTuple):
    """What a function leaves in an array.

    Attributes:
        name: Of the array.
        numbers: What is left.
        row: Whether every lane has its own.
        adds: Whether they are added to what is there.
    """

    name: str
    numbers: Numbers
    row: bool = False
    adds: bool = False

    @property
    def parameter(self) -> str:
        """The array, in C."""
        return f"{'row' if self.row else 'real'} *restrict {self.name}"

    def statements(self) -> Iterator[str]:
        """What leaves them there, in C."""
        for i, x in enumerate(self.numbers):
            known = not isinstance(x, Symbol)
            if self.adds and known and x == 0:
                continue
            text = _written(x, self.row and (known or not x.row))
            yield f"{self.name}[{i}] {'+' if self.adds else ''}= {text};"


FIXED = "const real *restrict shared, const row *restrict tangents"
PREPARED = "const real *restrict u, const row *restrict v"


def as_functions(
    statements: Statements, stage: str, results: list[Result], ending: str = ""
) -> Functions:
    """The two functions; what is fixed goes from one to the other in two arrays."""
    left = [line for result in results for line in result.statements()]
    body, words = used(
        [Statement(x.text, x.kind, text) for x, text in statements.stage], left
    )
    shared = [symbol for symbol, _ in statements.before if symbol.text in words]
    numbers = [x for x in shared if not x.row]
    rows = [x for x in shared if x.row]
    handed = [(f"u[{i}]", "real", x) for i, x in enumerate(numbers)]
    handed += [(f"v[{i}]", "row", x) for i, x in enumerate(rows)]
    given = {
        name: f"static const real {name}[] = {{{values}}};"
        for values, name in statements.tables.items()
    }
    tables = list(given.values())
    for place, _, x in handed:
        given[x.text] = Statement(x.text, x.kind, f"({x.kind}){place}").line
    parts = [stage, FIXED, PREPARED, *(result.parameter for result in results)]
    parameters = tuple(x.strip() for part in parts for x in part.split(","))
    lines = [
        f"static void prepare{ending}({FIXED}, real *restrict u, row *restrict v) {{",
        *tables,
        *(Statement(x.text, x.kind, text).line for x, text in statements.before),
        *(f"{place} = ({kind}){x.text};" for place, kind, x in handed),
        "}",
        *function_source(Signature(f"rates{ending}", parameters), given, body, left),
    ]
    return Functions("\n".join(lines), len(numbers), len(rows))
