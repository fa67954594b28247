"""Forward mode's rules of calls, branches and loops: of programs in a program."""

from collections.abc import Sequence
from typing import Any

from .called_programs import Rows, rows_of
from .forward_rules import Dot, Moves, Rule, WithDots, moving, only
from .jaxpr_types import ClosedJaxpr, Equation, Variable
from .new_programs import NewEquation, NewJaxpr, NewProgram, NewVariable


def _called(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    inner = equation.params["jaxpr"]
    program, moved = b.inside(inner, moving(dots))
    inputs = [*equation.invars, *only(dots)]
    return b.with_dots("jit", equation, inputs, moved, {"jaxpr": program})


def _branched(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    branches, moves = equation.params["branches"], moving(dots[1:])
    each = [b.inside(branch, moves).moved for branch in branches]
    moved = tuple(map(any, zip(*each, strict=True)))
    made = tuple(b.inside(x, moves, moved).program for x in branches)
    inputs = [*equation.invars, *only(dots)]
    return b.with_dots("cond", equation, inputs, moved, {"branches": made})


def _going_on(
    b: WithDots, body: ClosedJaxpr, fixed: Moves, begun: Moves, rows: Moves
) -> Moves:
    """Which of what goes from turn to turn moves, from the first turn on or later."""
    while True:
        moved = b.inside(body, (*fixed, *begun, *rows)).moved[: len(begun)]
        both = tuple(a or b for a, b in zip(begun, moved, strict=True))
        if both == begun:
            return begun
        begun = both


def _each_with_dots(
    b: WithDots, values: Sequence[Variable], dots: Sequence[Dot], moves: Moves
) -> list[Variable]:
    """Values, then the tangents of those that move."""
    triples = zip(values, dots, moves, strict=True)
    return [*values, *(b.known(x, v.aval) for v, x, moved in triples if moved)]


def _looped(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    params = equation.params
    more, body = params["cond_jaxpr"], params["body_jaxpr"]
    first, second = params["cond_nconsts"], params["body_nconsts"]
    parts = Rows(second, len(dots) - first - second, 0)
    asked, values = equation.invars[:first], equation.invars[first:]
    fixed, begun, _ = parts.parted([*dots[first:]])
    moves = _going_on(b, body, moving(fixed), moving(begun), ())
    program, moved = b.inside(
        body, (*moving(fixed), *moves), moves if any(moves) else None
    )
    if not any(moved):
        b.eqns.append(equation)
        return [None] * len(begun)
    shared, carried, _ = parts.parted([*values])
    inputs = _each_with_dots(b, shared, fixed, moving(fixed))
    turned = _each_with_dots(b, carried, begun, moves)
    known = {
        "cond_jaxpr": _with_more(more, [v.aval for v in turned[len(carried) :]]),
        "body_jaxpr": _in_order(program, parts, moving(fixed), moves, ()),
        "cond_nconsts": first,
        "body_nconsts": len(inputs),
    }
    return b.with_dots("while", equation, [*asked, *inputs, *turned], moved, known)


def _with_more(program: ClosedJaxpr, avals: Sequence[Any]) -> NewProgram:
    """A program with more arguments behind, of which it takes no notice."""
    jaxpr = program.jaxpr
    invars = [*jaxpr.invars, *map(NewVariable, avals)]
    new = NewJaxpr(jaxpr.constvars, invars, jaxpr.outvars, jaxpr.eqns)
    return NewProgram(new, program.consts)


def _in_order(
    program: NewProgram, parts: Rows, fixed: Moves, carried: Moves, rows: Moves
) -> NewProgram:
    """A loop's body, each part of its arguments followed by its tangents."""
    jaxpr, count = program.jaxpr, sum(parts)
    values, dots = jaxpr.invars[:count], iter(jaxpr.invars[count:])
    invars: list[Variable] = []
    known = zip(parts.parted([*values]), (fixed, carried, rows), strict=True)
    for own, moves in known:
        invars += own
        invars += [next(dots) for moved in moves if moved]
    new = NewJaxpr(jaxpr.constvars, invars, jaxpr.outvars, jaxpr.eqns)
    return NewProgram(new, program.consts)


def _scanned(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    params, parts = equation.params, rows_of(equation)
    body = params["jaxpr"]
    shared, begun, rows = parts.parted(dots)
    fixed, by_rows = moving(shared), moving(rows)
    moves = _going_on(b, body, fixed, moving(begun), by_rows)
    free = b.inside(body, (*fixed, *moves, *by_rows)).moved
    moved = (*moves, *free[parts.carried :])
    program, _ = b.inside(body, (*fixed, *moves, *by_rows), moved)
    if not any(moved):
        b.eqns.append(equation)
        return [None] * len(moved)
    values = parts.parted([*equation.invars])
    groups = zip(values, (shared, begun, rows), (fixed, moves, by_rows), strict=True)
    inputs = [v for group in groups for v in _each_with_dots(b, *group)]
    jaxpr = _in_order(program, parts, fixed, moves, by_rows).jaxpr
    # what goes on, its tangents, then the rows that are left, and theirs
    outs, behind = equation.outvars, parts.carried
    all_dots = [
        NewVariable(v.aval) if m else None for v, m in zip(outs, moved, strict=True)
    ]
    left = [*outs[:behind], *only(all_dots[:behind])]
    left += [*outs[behind:], *only(all_dots[behind:])]
    count, going = len(outs), sum(moves)
    own, more = jaxpr.outvars[:count], jaxpr.outvars[count:]
    turned = [*own[:behind], *more[:going], *own[behind:], *more[going:]]
    new = NewJaxpr(jaxpr.constvars, jaxpr.invars, turned, jaxpr.eqns)
    known = {
        "jaxpr": NewProgram(new, program.consts),
        "length": params["length"],
        "reverse": params["reverse"],
    }
    b.eqns.append(NewEquation.of("scan", known, inputs, left))
    return [*all_dots]


LOOPS: dict[str, Rule] = {
    "cond": _branched,
    "jit": _called,
    "pjit": _called,
    "scan": _scanned,
    "while": _looped,
}
