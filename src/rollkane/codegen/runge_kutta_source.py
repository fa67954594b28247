"""Steps of Runge-Kutta methods in C, around a right-hand side's functions."""

from collections.abc import Callable, Sequence
from fractions import Fraction

from .scalar_program import NotElementwiseError
from .scalar_source import FIXED, PREPARED, literal
from .tableau import Weights

# Compiling 7,000 takes 2 s, 12,000 take 4 s (by XLA 60 s), 15,000 take 8 s and 40,000
# take 90 s.
_MOST_STATEMENTS = 20_000
_DENOMINATOR = 1_000_000  # those of Dopri5 and Bosh3 are below
_EACH = "for (int c = 0; c < N; c++)"


def of_bearable_length(texts: tuple[str, ...]) -> tuple[str, ...]:
    """Texts in C for a run that waits for their compiler.

    Raises:
        NotElementwiseError: it would take longer than XLA's.
    """
    if sum(text.count("\n") for text in texts) > _MOST_STATEMENTS:
        raise NotElementwiseError("too many operations")
    return texts


def attempt_source(weights: Weights) -> str:
    """Stages and error of a Runge-Kutta pair as one C function, ``attempt``.

    Its last stage is the step's end; where there are EVENTS it gives their values, too.
    """
    given = "own, shared, NULL"
    lines = [
        "static void attempt(row t, row t_end, row h, const row *restrict y,",
        "                    const real *restrict shared, const row *restrict own,",
        "                    const real *restrict u, const row *restrict v,",
        "                    row k[][N], row *restrict y_new, row *restrict error",
        "#if EVENTS",
        "                    , const real *restrict event_u, const row *event_v,",
        "                    row *restrict seen",
        "#endif",
        ") {",
    ]
    *before, (row, end) = _stages(weights)
    for i, (stage, time) in enumerate(before, 1):
        lines.append(f"{_EACH} y_new[c] = {_moved('y', 'k', stage)};")
        lines.append(f"rates({time}, y_new, {given}, u, v, k[{i}]);")
    lines += [
        f"{_EACH} y_new[c] = {_moved('y', 'k', row)};",
        "#if EVENTS",
        f"rates_events({end}, y_new, {given}, event_u, event_v, k[STAGES - 1], seen);",
        "#else",
        f"rates({end}, y_new, {given}, u, v, k[STAGES - 1]);",
        "#endif",
        f"{_EACH} error[c] = h * {_weighted('k', weights.error)};",
    ]
    return "\n".join([*lines, "}"])


def watched_attempt_source(
    weights: Weights, mode: int, beside: Sequence[tuple[float, Sequence[float]]]
) -> str:
    """Stages and error of a pair in C for lanes of a mode, ``attempt_0``, ...

    With what is seen at each stage but the first; and ``beside_0``, which sees the same
    on a step that is done, at shares of it.

    Args:
        weights: Of the pair.
        mode: Its number.
        beside: Those shares, each with the weights of the rates to there.
    """
    known = "const real *restrict shared, const row *restrict own"
    known += ", const real *restrict u, const row *restrict v"
    given, each = "own, shared, NULL, u, v", f"for (int c = 0; c < ACTIVE_{mode}; c++)"
    rest = f"for (int c = ACTIVE_{mode}; c < GIVEN_{mode}; c++)"
    lines = [
        f"static void attempt_{mode}(row t, row t_end, row h, const row *restrict y,",
        f"    {known},",
        "    const real *restrict end_u, const row *restrict end_v,",
        f"    row k[][ACTIVE_{mode}], row *restrict y_new, row *restrict error,",
        "    row seen[][SEEN]) {",
    ]
    last = len(weights.rows)
    for i, (stage, time) in enumerate(_stages(weights), 1):
        call = f"rates_{mode}({time}, y_new, {given}"
        if i == last:
            call = f"rates_end_{mode}({time}, y_new, own, shared, NULL, end_u, end_v"
        lines += [
            f"{each} y_new[c] = {_moved('y', 'k', stage)};",
            f"{call}, k[{i}], seen[{i}]);",
        ]
    lines += [
        f"{each} error[c] = h * {_weighted('k', weights.error)};",
        "}",
        f"static void beside_{mode}(row t, row h, const row *restrict y,",
        f"    {known},",
        f"    row k[][ACTIVE_{mode}], row seen[][SEEN]) {{",
        f"row at[GIVEN_{mode}], rates[ACTIVE_{mode}];",
        f"{rest} at[c] = y[c];",
    ]
    for i, (share, row) in enumerate(beside, len(weights.rows) + 1):
        lines += [
            f"{each} at[c] = {_moved('y', 'k', tuple(row))};",
            f"rates_{mode}(t + h * {_weight(share)}, at, {given}, rates, seen[{i}]);",
        ]
    return "\n".join([*lines, "}"])


def push_source(weights: Weights) -> str:
    """A step of a state together with its changes as a C function, ``advance``."""
    names = [("", "h", False), ("d", "splat(h)", True)]
    lines = [
        "static void advance(real t, real t_end, real h, real *restrict y,",
        f"                    row *restrict dy, {FIXED}, {PREPARED}) {{",
        "real k[STAGES][N], z[N];",
        "row dk[STAGES][N], dz[N];",
        *_advanced(weights, names, "shared, tangents, u, v"),
        "}",
    ]
    return "\n".join(lines)


def pull_source(weights: Weights) -> str:
    """A step of a row of motions and its way back in C, ``advance`` and ``retreat``.

    With rates ``k_m = f(y + h sum_j a_mj k_j)`` and the end ``y + h sum_m b_m k_m``,
    the cotangent of a rate is ``h (b_m back + sum_j a_jm g_j)``, where ``g_j`` is that
    of the stage j behind it; that of y is the sum of all ``g`` and ``back``.
    """
    given = "const row *restrict own, const real *restrict shared"
    given += ", const real *restrict u, const row *restrict v"
    lines = [
        "static void advance(row t, row t_end, row h, row *restrict y,",
        f"                    {given}, row k[STAGES][N]) {{",
        "row z[N];",
        *_advanced(weights, [("", "h", True)], "own, shared, NULL, u, v"),
        "}",
        "static void retreat(row t, row t_end, row h,",
        "                    const row *restrict y, const row k[STAGES][N],",
        f"                    {given}, row *restrict back, row *restrict m) {{",
        "row g[STAGES][N], z[N], a[N];",
    ]
    stages = _stages(weights)
    last = stages[-1][0]
    places = [((), "t"), *stages[:-1]]
    for i, (row, time) in reversed(list(enumerate(places))):
        behind = [(j, places[j][0][i]) for j in range(i + 1, len(places))]
        terms = [("back[c]", last[i]), *((f"g[{j}][c]", x) for j, x in behind)]
        lines.append(f"{_EACH} a[c] = h * {_sum(terms)};")
        place = _moved("y", "k", row) if row else "y[c]"
        lines.append(f"{_EACH} z[c] = {place};")
        lines.append(f"rates_back({time}, z, own, a, shared, NULL, u, v, g[{i}], m);")
    total = " + ".join(f"g[{i}][c]" for i in range(len(places)))
    return "\n".join([*lines, f"{_EACH} back[c] += {total};", "}"])


def _advanced(
    weights: Weights, names: list[tuple[str, str, bool]], given: str
) -> list[str]:
    """Stages and end of a step; of each name x: xy is state, xk rates, xz workspace.

    Args:
        weights: Of the pair.
        names: Each with the step as its numbers are, and whether these are rows.
        given: What the rates are given behind time and state.
    """
    listed: Callable[[str], str]
    listed = lambda array: ", ".join(x + array for x, *_ in names)

    def each(to: str, weights: tuple[float, ...]) -> list[str]:
        return [
            f"{_EACH} {x}{to}[c] = {_moved(f'{x}y', f'{x}k', weights, h, row)};"
            for x, h, row in names
        ]

    lines = [f"rates(t, {listed('y')}, {given}, {listed('k[0]')});"]
    *before, last = _stages(weights)
    for i, (row, time) in enumerate(before, 1):
        lines += each("z", row)
        lines.append(f"rates({time}, {listed('z')}, {given}, {listed(f'k[{i}]')});")
    return lines + each("y", last[0])


def _stages(weights: Weights) -> list[tuple[tuple[float, ...], str]]:
    """Weights and time of each stage but the first, the step's end the last."""
    time: Callable[[float], str]
    time = lambda node: "t_end" if node == 1.0 else f"t + h * {_weight(node)}"
    return [(row, time(c)) for row, c in zip(weights.rows, weights.nodes, strict=True)]


def _moved(
    y: str, rates: str, weights: tuple[float, ...], h: str = "h", row: bool = True
) -> str:
    """A number of a state behind a step, with these weights of the rates."""
    return _fused(h, _weighted(rates, weights, row), f"{y}[c]", row)


def _weighted(rates: str, weights: tuple[float, ...], row: bool = True) -> str:
    return _sum([(f"{rates}[{i}][c]", w) for i, w in enumerate(weights)], row)


def _sum(terms: list[tuple[str, float]], row: bool = True) -> str:
    """Numbers times weights, in order; rows, or single ones."""
    as_row = "splat({})" if row else "{}"
    given = [(x, as_row.format(_weight(weight))) for x, weight in terms if weight]
    if not given:
        return as_row.format("(real)0")
    (x, weight), *others = given
    total = f"{x} * {weight}"
    for x, weight in others:
        total = _fused(x, weight, total, row)
    return f"({total})"


def _fused(x: str, y: str, z: str, row: bool) -> str:
    return f"fma_{'row' if row else 'one'}({x}, {y}, {z})"


def _weight(value: float) -> str:
    """A coefficient: as the fraction that it is to the last bit, or as it is.

    So that steps in more than double precision have their method's own order.
    """
    fraction = Fraction(value).limit_denominator(_DENOMINATOR)
    if float(fraction) != value:
        return literal(value)
    return f"((real){fraction.numerator} / (real){fraction.denominator})"
