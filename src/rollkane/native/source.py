"""A right-hand side and a Runge-Kutta pair as C.

A number is either ``uniform``, the same for all lanes (a C scalar, computed once a
call), or a ``row``, one value for each lane (a vector of the compiler's).
"""

import math
from collections.abc import Callable
from importlib.resources import files
from typing import Any, NamedTuple

import jax
import numpy as np

from ..numberwise import NotElementwiseError, Numbers, Program, as_objects
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
        fixed: Whether it is the same at all stages.
    """

    text: str
    row: bool
    truth: bool = False
    fixed: bool = False

    @property
    def kind(self) -> str:
        """Its type in C."""
        if self.row:
            return "mask" if self.truth else "row"
        return "int" if self.truth else "real"


class Listing:
    """C statements as they come, those of a call apart from those of a stage.

    Attributes:
        before: Symbols that all stages share, each with its expression.
        stage: Symbols that are computed at every stage.
    """

    def __init__(self):
        """An empty program."""
        self.before: list[tuple[Symbol, str]] = []
        self.stage: list[tuple[Symbol, str]] = []
        self._written: dict[str, Symbol] = {}

    def operate(self, name: str, params: Any, operands: list, dtype: Any) -> Symbol:
        """Write one operation; see :class:`rollkane.numberwise.Program`."""
        truth = dtype == np.bool_
        if not truth and not np.issubdtype(dtype, np.floating):
            raise NotElementwiseError(f"{name} of whole numbers")
        symbols = [x for x in operands if isinstance(x, Symbol)]
        row = any(x.row for x in symbols)
        fixed = all(x.fixed for x in symbols)
        text = _expression(name, params, operands, row)
        if text in self._written:  # computed before
            return self._written[text]
        statements = self.before if fixed else self.stage
        symbol = Symbol(f"{'b' if fixed else 's'}{len(statements)}", row, truth, fixed)
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
        return f"not_row({texts[0]})" if row else f"!{texts[0]}"
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


def program_of(dtype: Any, lanes: int, head: dict[str, int], parts: Any) -> str:
    """A C program for some numbers in a row.

    Args:
        dtype: Of the numbers.
        lanes: How many a row holds.
        head: Names of whole numbers that the parts know.
        parts: Names of files beside this one, or texts.
    """
    dtype = np.dtype(dtype)
    double = dtype == np.float64
    lines = [f"typedef {'double' if double else 'float'} real;"]
    known = {
        "REAL_IS_DOUBLE": int(double),
        "BYTES": lanes * dtype.itemsize,
        "ONE_LANE": int(lanes == 1),
        **head,
    }
    lines += [f"#define {name} {value}" for name, value in known.items()]
    folder = files("rollkane.native")
    named = lambda part: part.endswith((".c", ".h"))
    lines += [folder.joinpath(x).read_text() if named(x) else x for x in parts]
    return "\n".join(lines)


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


def lanes_source(
    derivative: Callable,
    state: jax.ShapeDtypeStruct,
    leaves: list,
    own: list[bool],
    zeros: list[tuple[bool, ...]] | None = None,
) -> Functions:
    """A right-hand side for a row of motions.

    Args:
        derivative: ``derivative(t, y, *leaves)`` -> rates, shape (n,).
        state: Shape and type of y.
        leaves: Shapes and types of the model's leaves for one motion.
        own: Which of them differ from motion to motion.
        zeros: Of each leaf, which numbers are zero for all: what they are multiplied
            by is left out. None: not known.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """
    time = jax.ShapeDtypeStruct((), state.dtype)
    program = Program(derivative, time, state, *leaves)
    listing = Listing()
    values = [_symbols(["t"], (), row=True), _array("y", state.shape, row=True)]
    places = {"own": 0, "shared": 0}
    zeros = [()] * len(leaves) if zeros is None else zeros
    for leaf, differs, nothing in zip(leaves, own, zeros, strict=True):
        if not np.issubdtype(leaf.dtype, np.floating):
            raise NotElementwiseError("a model with whole numbers")
        name = "own" if differs else "shared"
        # a lane takes the next motion in the middle of the others' runs
        numbers = _array(
            name, leaf.shape, places[name], row=differs, fixed=not differs
        )
        for i, is_zero in enumerate(nothing):
            if is_zero:
                numbers.reshape(-1)[i] = leaf.dtype.type(0)
        values.append(numbers)
        places[name] += math.prod(leaf.shape)
    (rates,) = program(values, listing.operate)
    stage = "row t, const row *restrict y, const row *restrict own"
    return _functions(listing, stage, [("d", True, rates)])


def tangents_source(
    rates: Callable, state: jax.ShapeDtypeStruct, varied: list
) -> tuple[Functions, list]:
    """A right-hand side of one motion together with its changes along a row.

    Args:
        rates: ``rates(t, y, *varied)`` -> rates, shape (n,).
        state: Shape and type of y.
        varied: What has changes, apart from y: arrays, or shapes and types.

    Returns:
        The functions, and the arrays that the rates close over: their numbers follow
        those of what is varied in ``shared``.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """

    def changes(t, y, varied, y_dot, varied_dot):
        along = lambda y, *varied: rates(t, y, *varied)
        return jax.jvp(along, (y, *varied), (y_dot, *varied_dot))

    like = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in varied]
    time = jax.ShapeDtypeStruct((), state.dtype)
    program = Program(changes, time, state, like, state, like)
    values = [_symbols(["t"], (), row=False), _array("y", state.shape, row=False)]
    shared = _in_order("shared", [*like, *program.closed], state.dtype, row=False)
    moved = _in_order("moved", like, state.dtype, row=True)
    values += [*shared[: len(like)], _array("dy", state.shape, row=True), *moved]
    listing = Listing()
    found = program(values, listing.operate, shared[len(like) :])
    stage = "real t, const real *restrict y, const row *restrict dy"
    results = [("d", False, found[0]), ("dd", True, found[1])]
    return _functions(listing, stage, results), program.closed


def _in_order(name: str, arrays: list, dtype: Any, *, row: bool) -> list[Numbers]:
    """Numbers of fixed arrays that lie one behind the other."""
    found, first = [], 0
    for x in arrays:
        if x.dtype != dtype:
            raise NotElementwiseError(f"numbers of {x.dtype}")
        found.append(_array(name, x.shape, first, row=row, fixed=True))
        first += math.prod(x.shape)
    return found


def _array(
    name: str, shape: tuple, first: int = 0, *, row: bool, fixed: bool = False
) -> Numbers:
    texts = [f"{name}[{first + i}]" for i in range(math.prod(shape))]
    return _symbols(texts, shape, row=row, fixed=fixed)


def _symbols(
    texts: list[str], shape: tuple, *, row: bool, fixed: bool = False
) -> Numbers:
    return as_objects([Symbol(text, row, fixed=fixed) for text in texts], shape)


_FIXED = "const real *restrict shared, const row *restrict moved"


def _functions(listing: Listing, stage: str, results: list) -> Functions:
    """The two functions; what is fixed goes from one to the other in two arrays."""
    body = _statements(listing.stage)
    for name, row, numbers in results:
        for i, x in enumerate(numbers):
            spread = row and not (isinstance(x, Symbol) and x.row)
            body.append(f"{name}[{i}] = {_written(x, spread)};")
    words = set("".join(c if c.isalnum() else " " for c in "\n".join(body)).split())
    used = [symbol for symbol, _ in listing.before if symbol.text in words]
    numbers = [x for x in used if not x.row]
    rows = [x for x in used if x.row]
    handed = [(f"u[{i}]", "real", x) for i, x in enumerate(numbers)]
    handed += [(f"v[{i}]", "row", x) for i, x in enumerate(rows)]
    out = ", ".join(f"{'row' if row else 'real'} *restrict {x}" for x, row, _ in results)
    lines = [
        f"static void prepare({_FIXED}, real *restrict u, row *restrict v) {{",
        *_statements(listing.before),
        *(f"{place} = ({kind}){x.text};" for place, kind, x in handed),
        "}",
        f"static void rates({stage}, {_FIXED},",
        f"                  const real *restrict u, const row *restrict v, {out}) {{",
        *(f"const {x.kind} {x.text} = ({x.kind}){place};" for place, _, x in handed),
        *body,
        "}",
    ]
    return Functions("\n".join(lines), len(numbers), len(rows))


def _statements(listed: list[tuple[Symbol, str]]) -> list[str]:
    return [f"const {symbol.kind} {symbol.text} = {text};" for symbol, text in listed]


_EACH = "for (int c = 0; c < N; c++)"


def attempt_source(weights: Weights) -> str:
    """Stages and error of a Runge-Kutta pair as one C function, ``attempt``."""
    lines = [
        "static void attempt(row t, row t_end, row h, const row *restrict y,",
        "                    const real *restrict shared, const row *restrict own,",
        "                    const real *restrict u, const row *restrict v,",
        "                    row k[][N], row *restrict y_new, row *restrict error) {",
    ]
    for i, (row, time) in enumerate(_stages(weights), 1):
        lines.append(f"{_EACH} y_new[c] = y[c] + h * ({_weighted('k', row)});")
        lines.append(f"rates({time}, y_new, own, shared, NULL, u, v, k[{i}]);")
    lines.append(f"{_EACH} error[c] = h * ({_weighted('k', weights.error)});")
    return "\n".join([*lines, "}"])


def advance_source(weights: Weights) -> str:
    """A step of a state together with its changes as one C function, ``advance``."""
    given = "shared, moved, u, v"
    lines = [
        "static void advance(real t, real t_end, real h, real *restrict y,",
        f"                    row *restrict dy, {_FIXED},",
        "                    const real *restrict u, const row *restrict v) {",
        "real k[STAGES][N], z[N];",
        "row dk[STAGES][N], dz[N];",
        f"rates(t, y, dy, {given}, k[0], dk[0]);",
    ]
    *before, last = _stages(weights)
    for i, (row, time) in enumerate(before, 1):
        lines.append(f"{_EACH} z[c] = y[c] + h * ({_weighted('k', row)});")
        lines.append(f"{_EACH} dz[c] = dy[c] + h * ({_weighted('dk', row)});")
        lines.append(f"rates({time}, z, dz, {given}, k[{i}], dk[{i}]);")
    lines.append(f"{_EACH} y[c] += h * ({_weighted('k', last[0])});")
    lines.append(f"{_EACH} dy[c] += h * ({_weighted('dk', last[0])});")
    return "\n".join([*lines, "}"])


def _stages(weights: Weights) -> list[tuple[tuple[float, ...], str]]:
    """Weights and time of each stage but the first, the step's end the last."""
    time = lambda node: "t_end" if node == 1.0 else f"t + h * {_literal(node)}"
    return [(row, time(c)) for row, c in zip(weights.rows, weights.nodes, strict=True)]


def _weighted(rates: str, weights: tuple[float, ...]) -> str:
    terms = [f"{rates}[{i}][c] * {_literal(w)}" for i, w in enumerate(weights) if w]
    return " + ".join(terms)
