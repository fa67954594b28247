"""Statements of a program in C: blocks of them, and functions that long blocks become.

Compilers take a time that grows with the square of a function's length, so that what is
long and may be skipped or repeated, a branch or the body of a loop, is a function of
its own: of the numbers that it uses, to those that are used of it.
"""

import re
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import Any, NamedTuple

from .scalars import IN_C, Number

_LONG = 150  # lines of a block that is a function
# names of single numbers: computed once, or changed by a loop or a branch
_NAME = re.compile(r"\b[sc]\d+\b")
_COMPUTED_ONCE = re.compile(r"s\d+")


def part(i: int) -> str:
    """The head of a function."""
    parameters = "const Frame *frame, const double *given, double *left"
    return f"OF_THE_PROGRAM void part{i}({parameters})"


def stays(x: Any) -> bool:
    """Whether a number is known, or computed once."""
    return not isinstance(x, Number) or bool(_COMPUTED_ONCE.fullmatch(x.text))


class Block:
    """Statements between braces, and what was computed by them."""

    def __init__(self):
        """None yet."""
        self.lines: list[str] = []
        self.named: set[str] = set()
        self.known: dict[tuple[str, str], Number] = {}


class Target(NamedTuple):
    """What a block leaves: a number, in the variable of that name."""

    name: str
    number: Number


class Writer:
    """A program in C as it is written.

    Attributes:
        functions: Of blocks that were long.
        tables: Definitions of known numbers that are looked up.
        workspace: How many numbers the arrays in memory take.
        places: Where each of these begins, in the order of their names.
    """

    def __init__(self):
        """An empty program."""
        self.functions: list[str] = []
        self.tables: dict[str, str] = {}
        self.workspace = 0
        self.places: list[int] = []
        self._blocks = [Block()]
        self._types: dict[str, str] = {}
        self._calls = 0

    @property
    def block(self) -> Block:
        """The one that is being written."""
        return self._blocks[-1]

    def line(self, text: str) -> None:
        """A statement, or a part of one."""
        self.block.lines.append(text)

    def let(self, text: str, kind: str, changes: bool = False) -> Number:
        """The value of an expression, computed once, unless memory changes it."""
        if text in self._types:
            return Number(text, kind)
        expression = text, kind
        for block in () if changes else self._blocks:
            found = block.known.get(expression)
            if found is not None:
                return found
        number = self._new("s", kind)
        self.line(f"const {IN_C[kind]} {number.text} = {text};")
        if not changes:
            self.block.known[expression] = number
        return number

    def variable(self, kind: str, first: Number | None = None) -> Number:
        """A number that changes."""
        number = self._new("c", kind)
        value = "" if first is None else f" = {first.text}"
        self.line(f"{IN_C[kind]} {number.text}{value};")
        return number

    def _new(self, letter: str, kind: str) -> Number:
        number = Number(f"{letter}{len(self._types)}", kind)
        self._types[number.text] = kind
        self.block.named.add(number.text)
        return number

    def place(self, size: int) -> str:
        """Place for an array in memory."""
        self.places.append(self.workspace)
        self.workspace += size
        return f"m{len(self.places) - 1}"

    def table(self, values: Iterable[str]) -> str:
        """An array of known numbers."""
        text = ", ".join(values)
        return self.tables.setdefault(text, f"t{len(self.tables)}")

    @contextmanager
    def inner(self) -> Generator[Block, None, None]:
        """A block of its own, which is nowhere yet."""
        block = Block()
        self._blocks.append(block)
        try:
            yield block
        finally:
            self._blocks.pop()

    @contextmanager
    def apart(self) -> Generator[Block, None, None]:
        """A block of another function: nothing of what is around is known in it."""
        around, self._blocks = self._blocks, [Block()]
        try:
            yield self.block
        finally:
            self._blocks = around

    def called(self, i: int, given: str, types: list[str]) -> list[Number]:
        """What function i leaves, of numbers of these types."""
        self._calls += 1
        handed, left = f"g{self._calls}", f"l{self._calls}"
        self.line(f"const double {handed}[] = {{{given}}};")
        self.line(f"double {left}[{len(types) + 1}];")
        self.line(f"part{i}(frame, {handed}, {left});")
        texts = [f"({IN_C[kind]}){left}[{k}]" for k, kind in enumerate(types)]
        return [self.let(text, kind) for text, kind in zip(texts, types, strict=True)]

    @contextmanager
    def reopened(self, block: Block) -> Generator[None, None, None]:
        """Go on with a block that is nowhere yet."""
        self._blocks.append(block)
        try:
            yield
        finally:
            self._blocks.pop()

    def copy(self, number: Number) -> Number:
        """The value that a variable has now."""
        kept = self._new("s", number.type)
        self.line(f"const {IN_C[number.type]} {kept.text} = {number.text};")
        return kept

    @contextmanager
    def braces(self, head: str) -> Generator[None, None, None]:
        """Statements between braces behind a head."""
        with self.inner() as block:
            yield
        self.line(f"{head} {{")
        self._extend(block)
        self.line("}")

    def _extend(self, block: Block) -> None:
        self.block.lines += block.lines
        self.block.named |= block.named

    def put(self, block: Block, targets: list[Target]) -> None:
        """A block here, which leaves numbers in variables: as it is, or as a call."""
        if len(block.lines) < _LONG:
            self.line("{")
            self._extend(block)
            for name, number in targets:
                self.line(f"{name} = {number.text};")
            self.line("}")
            return
        texts = (*block.lines, *(target.number.text for target in targets))
        used = {name for text in texts for name in _NAME.findall(text)}
        given = sorted(used - block.named, key=lambda name: int(name[1:]))
        i = len(self.functions)
        kind: Callable[[str], str] = lambda name: IN_C[self._types[name]]
        lines = [
            f"{part(i)} {{",
            *(
                f"const {kind(name)} {name} = ({kind(name)})given[{k}];"
                for k, name in enumerate(given)
            ),
            *block.lines,
            *(f"left[{k}] = (double){x.number.text};" for k, x in enumerate(targets)),
            "}",
        ]
        self.functions.append("\n".join(lines))
        handed = ", ".join(f"(double){name}" for name in given)
        self.line("{")
        self.line(f"const double given[] = {{{handed or '0'}}};")
        self.line(f"double left[{len(targets) + 1}];")
        self.line(f"part{i}(frame, given, left);")
        for k, (name, _) in enumerate(targets):
            self.line(f"{name} = ({kind(name)})left[{k}];")
        self.line("}")
