"""The text in C of a long list of statements that each compute one number, or one row.

A program of arrays does one operation for all their numbers, then the next. Compilers
keep that order and so hundreds of values alive at once, and the time that they take to
find registers grows with the square of a function's length. So long programs are put in
another order, and written as several functions.
"""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

# so few fit into the caches whatever their order
_SHORT = 1000
_PIECE = 500  # statements of a function, for which compilers take 0.1 s
# how a piece of a function begins
PIECE = "static __attribute__((noinline)) "
_NAMES = re.compile(r"[A-Za-z_]\w*")


class Statement(NamedTuple):
    """``const kind name = text;``.

    Attributes:
        name: What it gives.
        kind: Its type in C.
        text: The expression.
    """

    name: str
    kind: str
    text: str

    @property
    def line(self) -> str:
        """The statement, in C."""
        return f"const {self.kind} {self.name} = {self.text};"


class Signature(NamedTuple):
    """Of a function without a result.

    Attributes:
        name: Its name.
        parameters: As they are declared.
    """

    name: str
    parameters: tuple[str, ...]

    @property
    def arguments(self) -> str:
        """The parameters, handed on."""
        return ", ".join(_NAMES.findall(x)[-1] for x in self.parameters)

    def head(self, ending: str = "", *further: str) -> str:
        """How the function begins, in C."""
        listed = ",\n    ".join([*self.parameters, *further])
        return f"{self.name}{ending}({listed}) {{"


def names_in(texts: Iterable[str]) -> set[str]:
    """All names in some texts in C."""
    return set(_NAMES.findall("\n".join(texts)))


def used(
    statements: Sequence[Statement], results: Iterable[str]
) -> tuple[list[Statement], set[str]]:
    """Those of some statements that results need, and all names in both."""
    names, kept = names_in(results), list[Statement]()
    for one in reversed(statements):
        if one.name in names:
            kept.append(one)
            names.update(_NAMES.findall(one.text))
    return kept[::-1], names


def function_source(
    signature: Signature,
    given: dict[str, str],
    statements: Sequence[Statement],
    results: Sequence[str],
) -> list[str]:
    """A function in C; of a long one, after the functions that are its pieces.

    Args:
        signature: Of the function.
        given: Lines that define names which the statements may use.
        statements: In an order in which they can be computed.
        results: Lines that leave the results.
    """
    if len(statements) <= _SHORT:
        lines = [x.line for x in statements]
        head = f"static void {signature.head()}"
        return [head, *given.values(), *lines, *results, "}"]
    order = last_ready_first(statements)
    pieces = [order[i : i + _PIECE] for i in range(0, len(order), _PIECE)]
    return _in_pieces(signature, given, pieces, results)


def last_ready_first(statements: Sequence[Statement]) -> list[Statement]:
    """Statements in an order in which values are used soon after they are there.

    Of those whose operands are there, the one comes next whose last operand came last.
    """
    index = {x.name: i for i, x in enumerate(statements)}
    needs = [
        {index[x] for x in _NAMES.findall(one.text) if x in index} for one in statements
    ]
    users: list[list[int]] = [[] for _ in statements]
    for i, operands in enumerate(needs):
        for k in operands:
            users[k].append(i)
    missing = [len(operands) for operands in needs]
    ready = [i for i in reversed(range(len(statements))) if not missing[i]]
    order: list[Statement] = []
    while ready:
        k = ready.pop()
        order.append(statements[k])
        for i in reversed(users[k]):
            missing[i] -= 1
            if not missing[i]:
                ready.append(i)
    return order


def _in_pieces(
    signature: Signature,
    given: dict[str, str],
    pieces: list[list[Statement]],
    results: Sequence[str],
) -> list[str]:
    """One function for each piece, and one that calls them in order.

    What later pieces use goes from one to the next in memory, one array for each type.
    """
    texts = [[x.text for x in piece] for piece in pieces]
    texts[-1] += results
    used = [names_in(text) for text in texts]
    kinds = sorted({x.kind for piece in pieces for x in piece})
    counts = dict.fromkeys(kinds, 0)
    kept: dict[str, tuple[str, str]] = {}  # name: type and place of what goes on
    for k, piece in enumerate(pieces):
        later = set[str]().union(*used[k + 1 :])
        for x in piece:
            if x.name in later:
                kept[x.name] = x.kind, f"kept_{x.kind}[{counts[x.kind]}]"
                counts[x.kind] += 1
    arrays = [f"{kind} *restrict kept_{kind}" for kind in kinds]
    lines: list[str] = []
    calls = [f"{kind} kept_{kind}[{n + 1}];" for kind, n in counts.items()]
    for k, piece in enumerate(pieces):
        own = {x.name for x in piece}
        taken = [(x, *kept[x]) for x in sorted(used[k] - own) if x in kept]
        left = [f"{kept[x.name][1]} = {x.name};" for x in piece if x.name in kept]
        lines += [
            f"{PIECE}void {signature.head(f'_{k}', *arrays)}",
            *(line for name, line in given.items() if name in used[k]),
            *(f"const {kind} {name} = {place};" for name, kind, place in taken),
            *(x.line for x in piece),
            *left,
            *(results if k == len(pieces) - 1 else ()),
            "}",
        ]
        handed = ", ".join([signature.arguments, *(f"kept_{kind}" for kind in kinds)])
        calls.append(f"{signature.name}_{k}({handed});")
    return [*lines, f"static void {signature.head()}", *calls, "}"]
