"""A right-hand side and a Runge-Kutta pair as C.

A number is either ``uniform``, the same for all lanes (a C scalar, computed once a
call), or a ``row``, one value for each lane (a vector of the compiler's).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from ..numberwise import NotElementwiseError, Numbers, Program
from ..tableau import Weights

# how XLA's operations are written: between two numbers, or as functions of lane_loop.c
_ARITHMETIC = {"add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/"}
_COMPARED = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
_LOGICAL = {"and": "&", "or": "|"}
_FORMULAS = {
    "neg": "-{0}",
    "square": "{0} * {0}",
    "rsqrt": "(real)1 / sqrt{1}({0})",
    "logistic": "(real)1 / ((real)1 + exp{1}(-{0}))",
    "is_finite": "({0} - {0}) == ({0} - {0})",
}
_FUNCTIONS = frozenset(
    """
    abs acos acosh asin asinh atan atan2 atanh cbrt ceil cos cosh exp exp2 expm1 floor
    log log1p max min pow rem sign sin sinh sqrt tan tanh
    """.split()  # noqa: SIM905 -- words read better than a column of strings
)


class Symbol(NamedTuple):
    """A number of the C program.

    Attributes:
        text: How it is written.
        row: Whether every lane has its own.
        truth: Whether it is true or false.
    """

    text: str
    row: bool
    truth: bool = False

    @property
    def kind(self) -> str:
        """Its type in C."""
        if self.row:
            return "mask" if self.truth else "row"
        return "int" if self.truth else "real"


class Listing:
    """C statements as they come, those for all lanes apart from those for each.

    Attributes:
        uniform: Symbols that all lanes share, each with its expression.
        rows: Symbols of which every lane has its own.
    """

    def __init__(self):
        """An empty program."""
        self.uniform: list[tuple[Symbol, str]] = []
        self.rows: list[tuple[Symbol, str]] = []
        self._written: dict[str, Symbol] = {}

    def operate(self, name: str, params: Any, operands: list, dtype: Any) -> Symbol:
        """Write one operation; see :class:`rollkane.numberwise.Program`."""
        truth = dtype == np.bool_
        if not truth and not np.issubdtype(dtype, np.floating):
            raise NotElementwiseError(f"{name} of whole numbers")
        row = any(isinstance(x, Symbol) and x.row for x in operands)
        text = _expression(name, params, operands, row)
        if text in self._written:  # computed before
            return self._written[text]
        statements = self.rows if row else self.uniform
        symbol = Symbol(f"{'r' if row else 'c'}{len(statements)}", row, truth)
        statements.append((symbol, text))
        self._written[text] = symbol
        return symbol


def _expression(name: str, params: Any, operands: list, row: bool) -> str:
    ending = "_row" if row else "_one"
    if name in _ARITHMETIC or name in _COMPARED:
        a, b = (_written(x, row and not isinstance(x, Symbol)) for x in operands)
        return f"{a} {(_ARITHMETIC | _COMPARED)[name]} {b}"
    if name == "convert_element_type":
        return _converted(operands[0], params["new_dtype"], row)
    texts = [_written(x, row) for x in operands]
    if name in _LOGICAL:
        return f" {_LOGICAL[name]} ".join(texts)
    if name == "not":
        return f"{'~' if row else '!'}{texts[0]}"
    if name in _FORMULAS:
        return _FORMULAS[name].format(texts[0], ending)
    if name == "select_n" and len(texts) == 3:
        which, no, yes = texts
        return f"choose{ending}({which}, {yes}, {no})"
    if name == "clamp":
        least, x, most = texts
        return f"max{ending}({least}, min{ending}({x}, {most}))"
    if name in _FUNCTIONS:
        return f"{name}{ending}({', '.join(texts)})"
    raise NotElementwiseError(name)


def _converted(x: Symbol, dtype: Any, row: bool) -> str:
    if x.truth:
        one, zero = (_written(np.float64(value), row) for value in (1.0, 0.0))
        return f"choose{'_row' if row else '_one'}({x.text}, {one}, {zero})"
    # real to real: a program has one precision
    return f"{x.text} != (real)0" if dtype == np.bool_ else x.text


def _written(x: Any, as_row: bool) -> str:
    """A symbol or a known number; as a row where it has to be one."""
    if isinstance(x, Symbol):
        text, spread, truth = x.text, as_row and not x.row, x.truth
    elif isinstance(x, np.bool_):
        text, spread, truth = str(int(x)), as_row, True
    elif isinstance(x, np.floating):
        text, spread, truth = _literal(float(x)), as_row, False
    else:
        raise NotElementwiseError("whole numbers")
    if not spread:
        return text
    return f"mask_of({text})" if truth else f"splat({text})"


def _literal(value: float) -> str:
    if np.isfinite(value):
        return f"(real){value.hex()}"
    if np.isnan(value):
        return "(real)NAN"
    return "(real)INFINITY" if value > 0 else "-(real)INFINITY"


def source_of(
    derivative: Callable,
    state: jax.ShapeDtypeStruct,
    leaves: list,
    own: list[bool],
    zeros: list[tuple[bool, ...]] | None = None,
) -> tuple[str, int]:
    """A right-hand side as two C functions, ``prepare`` and ``rates``.

    Args:
        derivative: ``derivative(t, y, *leaves)`` -> rates, shape (n,).
        state: Shape and type of y.
        leaves: Shapes and types of the model's leaves for one motion.
        own: Which of them differ from motion to motion.
        zeros: Of each leaf, which numbers are zero for all: what they are multiplied
            by is left out. None: not known.

    Returns:
        The text, and how many uniform numbers ``prepare`` leaves for ``rates``.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """
    time = jax.ShapeDtypeStruct((), state.dtype)
    program = Program(derivative, time, state, *leaves)
    listing = Listing()
    values = [_symbols(["t"], (), True), _array("y", state.shape, True, 0)]
    places = {"own": 0, "shared": 0}
    zeros = [()] * len(leaves) if zeros is None else zeros
    for leaf, differs, nothing in zip(leaves, own, zeros, strict=True):
        if not np.issubdtype(leaf.dtype, np.floating):
            raise NotElementwiseError("a model with whole numbers")
        name = "own" if differs else "shared"
        numbers = _array(name, leaf.shape, differs, places[name])
        for i, is_zero in enumerate(nothing):
            if is_zero:
                numbers.reshape(-1)[i] = leaf.dtype.type(0)
        values.append(numbers)
        places[name] += int(np.prod(leaf.shape))
    (rates,) = program(values, listing.operate)
    return _functions(listing, list(rates))


def _array(name: str, shape: tuple, row: bool, first: int) -> Numbers:
    count = int(np.prod(shape))
    return _symbols([f"{name}[{first + i}]" for i in range(count)], shape, row)


def _symbols(texts: list[str], shape: tuple, row: bool) -> Numbers:
    numbers = np.empty(len(texts), object)
    for i, text in enumerate(texts):
        numbers[i] = Symbol(text, row)
    return numbers.reshape(shape)


def _functions(listing: Listing, rates: list) -> tuple[str, int]:
    """The two functions; what is uniform goes from one to the other in an array."""
    body = _statements(listing.rows)
    for i, x in enumerate(rates):
        spread = not (isinstance(x, Symbol) and x.row)
        body.append(f"d[{i}] = {_written(x, spread)};")
    words = set("".join(c if c.isalnum() else " " for c in "\n".join(body)).split())
    used = [symbol for symbol, _ in listing.uniform if symbol.text in words]
    handed = [
        f"const {symbol.kind} {symbol.text} = u[{i}];" for i, symbol in enumerate(used)
    ]
    lines = [
        "static void prepare(const real *restrict shared, real *restrict u) {",
        *_statements(listing.uniform),
        *(f"u[{i}] = {symbol.text};" for i, symbol in enumerate(used)),
        "}",
        "static void rates(row t, const row *restrict y, const real *restrict shared,",
        "                  const row *restrict own, const real *restrict u,",
        "                  row *restrict d) {",
        *handed,
        *body,
        "}",
    ]
    return "\n".join(lines), len(used)


def _statements(listed: list[tuple[Symbol, str]]) -> list[str]:
    return [f"const {symbol.kind} {symbol.text} = {text};" for symbol, text in listed]


def stages_of(weights: Weights) -> str:
    """Stages and error of a Runge-Kutta pair as one C function, ``attempt``."""
    lines = [
        "static void attempt(row t, row t_end, row h, const row *restrict y,",
        "                    const real *restrict shared, const row *restrict own,",
        "                    const real *restrict u, row k[][N], row *restrict y_new,",
        "                    row *restrict error) {",
    ]
    each = "for (int c = 0; c < N; c++)"
    for i, (row, node) in enumerate(zip(weights.rows, weights.nodes, strict=True), 1):
        time = "t_end" if node == 1.0 else f"t + h * {_literal(node)}"
        lines.append(f"{each} y_new[c] = y[c] + h * ({_weighted(row)});")
        lines.append(f"rates({time}, y_new, shared, own, u, k[{i}]);")
    lines.append(f"{each} error[c] = h * ({_weighted(weights.error)});")
    return "\n".join([*lines, "}"])


def _weighted(weights: tuple[float, ...]) -> str:
    return " + ".join(f"k[{i}][c] * {_literal(w)}" for i, w in enumerate(weights) if w)
