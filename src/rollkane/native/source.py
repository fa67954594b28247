"""A right-hand side and a Runge-Kutta pair as C.

A number is either ``uniform``, the same for all lanes (a C scalar, computed once a
call), or a ``row``, one value for each lane (a vector of the compiler's).
"""

import math
from collections.abc import Callable, Iterator
from importlib.resources import files
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
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
    return _functions(listing, stage, [Result("d", rates, row=True)])


class Derivative(NamedTuple):
    """What is compiled for changes along steps, or back along them.

    Attributes:
        functions: Of the rates alone; None where those of the changes give them too.
        changes: Of the changes.
        closed: Arrays that the rates close over: their numbers follow those of what is
            varied in ``shared``.
    """

    functions: Functions | None
    changes: Functions
    closed: list


def tangents_source(rates: Callable, state: Any, varied: list) -> Derivative:
    """A right-hand side of one motion together with its changes along a row.

    Args:
        rates: ``rates(t, y, *varied)`` -> rates, shape (n,).
        state: Shape and type of y.
        varied: What has changes, apart from y: arrays, or shapes and types.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """

    def changes(t, y, varied, y_dot, varied_dot):
        along = lambda y, *varied: rates(t, y, *varied)
        return jax.jvp(along, (y, *varied), (y_dot, *varied_dot))

    time, like = _like([jnp.zeros((), state.dtype), *varied])
    program = Program(changes, time, state, like, state, like)
    given, closed = _given(state, like, program.closed)
    rows = _array("dy", state.shape, row=True)
    moved = _in_order("moved", like, state.dtype, row=True)
    listing = Listing()
    found = program([*given, rows, *moved], listing.operate, closed)
    stage = "real t, const real *restrict y, const row *restrict dy"
    results = [Result("d", found[0]), Result("dd", found[1], row=True)]
    return Derivative(None, _functions(listing, stage, results), program.closed)


def cotangents_source(rates: Callable, state: Any, varied: list) -> Derivative:
    """A right-hand side of one motion, and what a cotangent of its rates becomes.

    That of the state, and what it adds to those of what is varied.

    Args:
        rates: ``rates(t, y, *varied)`` -> rates, shape (n,).
        state: Shape and type of y.
        varied: What has cotangents, apart from y: arrays, or shapes and types.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """

    def pulled(t, y, varied, asked):
        along = lambda y, *varied: rates(t, y, *varied)
        return jax.vjp(along, y, *varied)[1](asked)

    time, like = _like([jnp.zeros((), state.dtype), *varied])
    there = Program(lambda t, y, varied: rates(t, y, *varied), time, state, like)
    back = Program(pulled, time, state, like, state)
    given, closed = _given(state, like, [*there.closed, *back.closed])
    listing = Listing()
    found = there(given, listing.operate, closed[: len(there.closed)])
    stage = "real t, const real *restrict y"
    functions = _functions(listing, stage, [Result("d", found[0])])
    listing = Listing()
    asked = _array("asked", state.shape, row=False)
    found = back([*given, asked], listing.operate, closed[len(there.closed) :])
    numbers = [x for array in found[1:] for x in array.reshape(-1)]
    results = [Result("g", found[0]), Result("m", as_objects(numbers, (-1,)), adds=True)]
    stage = f"{stage}, const real *restrict asked"
    changes = _functions(listing, stage, results, "_back")
    return Derivative(functions, changes, [*there.closed, *back.closed])


def _like(arrays: list) -> tuple[Any, list]:
    first, *rest = (jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays)
    return first, rest


def _given(state: Any, like: list, closed: list) -> tuple[list, list]:
    """Time, state and what is varied as symbols, and what is closed over."""
    given = [_symbols(["t"], (), row=False), _array("y", state.shape, row=False)]
    shared = _in_order("shared", [*like, *closed], state.dtype, row=False)
    return given + shared[: len(like)], shared[len(like) :]


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


class Result(NamedTuple):
    """What a function leaves in an array.

    Attributes:
        name: Of the array.
        numbers: What is left.
        row: Whether every lane has its own.
        adds: Whether they are added to what is there.
    """

    name: str
    numbers: Any
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


_FIXED = "const real *restrict shared, const row *restrict moved"
_PREPARED = "const real *restrict u, const row *restrict v"


def _functions(
    listing: Listing, stage: str, results: list[Result], ending: str = ""
) -> Functions:
    """The two functions; what is fixed goes from one to the other in two arrays."""
    body = _statements(listing.stage)
    for result in results:
        body += result.statements()
    words = set("".join(c if c.isalnum() else " " for c in "\n".join(body)).split())
    used = [symbol for symbol, _ in listing.before if symbol.text in words]
    numbers = [x for x in used if not x.row]
    rows = [x for x in used if x.row]
    handed = [(f"u[{i}]", "real", x) for i, x in enumerate(numbers)]
    handed += [(f"v[{i}]", "row", x) for i, x in enumerate(rows)]
    lines = [
        f"static void prepare{ending}({_FIXED}, real *restrict u, row *restrict v) {{",
        *_statements(listing.before),
        *(f"{place} = ({kind}){x.text};" for place, kind, x in handed),
        "}",
        f"static void rates{ending}({stage}, {_FIXED}, {_PREPARED},",
        f"    {', '.join(result.parameter for result in results)}) {{",
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


def push_source(weights: Weights) -> str:
    """A step of a state together with its changes as a C function, ``advance``."""
    lines = [
        "static void advance(real t, real t_end, real h, real *restrict y,",
        f"                    row *restrict dy, {_FIXED}, {_PREPARED}) {{",
        "real k[STAGES][N], z[N];",
        "row dk[STAGES][N], dz[N];",
        *_advanced(weights, ["", "d"], "moved, u, v"),
        "}",
    ]
    return "\n".join(lines)


def pull_source(weights: Weights) -> str:
    """A step and its way back in C, ``advance`` and ``retreat``.

    With rates ``k_m = f(y + h sum_j a_mj k_j)`` and the end ``y + h sum_m b_m k_m``, the
    cotangent of a rate is ``h (b_m back + sum_j a_jm g_j)``, where ``g_j`` is that of
    the stage j behind it; that of y is the sum of all ``g`` and ``back``.
    """
    lines = [
        "static void advance(real t, real t_end, real h, real *restrict y,",
        "                    const real *restrict shared, const real *restrict u,",
        "                    real k[STAGES][N]) {",
        "real z[N];",
        *_advanced(weights, [""], "NULL, u, NULL"),
        "}",
        "static void retreat(real t, real t_end, real h, const real *restrict y,",
        "                    const real k[STAGES][N], const real *restrict shared,",
        "                    const real *restrict w, real *restrict back,",
        "                    real *restrict m) {",
        "real g[STAGES][N], z[N], a[N];",
    ]
    stages = _stages(weights)
    last = stages[-1][0]
    places = [((), "t"), *stages[:-1]]
    for i, (row, time) in reversed(list(enumerate(places))):
        behind = [(j, places[j][0][i]) for j in range(i + 1, len(places))]
        terms = [f"back[c] * {_literal(last[i])}"] if last[i] else []
        terms += [f"g[{j}][c] * {_literal(weight)}" for j, weight in behind if weight]
        lines.append(f"{_EACH} a[c] = h * ({' + '.join(terms)});")
        place = f"y[c] + h * ({_weighted('k', row)})" if row else "y[c]"
        lines.append(f"{_EACH} z[c] = {place};")
        lines.append(f"rates_back({time}, z, a, shared, NULL, w, NULL, g[{i}], m);")
    total = " + ".join(f"g[{i}][c]" for i in range(len(places)))
    return "\n".join([*lines, f"{_EACH} back[c] += {total};", "}"])


def _advanced(weights: Weights, names: list[str], given: str) -> list[str]:
    """Stages and end of a step; of each name x a state xy, rates xk and a room xz."""
    listed = lambda array: ", ".join(x + array for x in names)
    each = lambda text: [f"{_EACH} {text.replace('@', x)};" for x in names]
    lines = [f"rates(t, {listed('y')}, shared, {given}, {listed('k[0]')});"]
    *before, last = _stages(weights)
    for i, (row, time) in enumerate(before, 1):
        lines += each(f"@z[c] = @y[c] + h * ({_weighted('@k', row)})")
        lines.append(f"rates({time}, {listed('z')}, shared, {given}, {listed(f'k[{i}]')});")
    return lines + each(f"@y[c] += h * ({_weighted('@k', last[0])})")


def _stages(weights: Weights) -> list[tuple[tuple[float, ...], str]]:
    """Weights and time of each stage but the first, the step's end the last."""
    time = lambda node: "t_end" if node == 1.0 else f"t + h * {_literal(node)}"
    return [(row, time(c)) for row, c in zip(weights.rows, weights.nodes, strict=True)]


def _weighted(rates: str, weights: tuple[float, ...]) -> str:
    terms = [f"{rates}[{i}][c] * {_literal(w)}" for i, w in enumerate(weights) if w]
    return " + ".join(terms)
