"""Functions in C shared out between compilers, which work side by side."""

import os
import re
from collections.abc import Sequence

from .stage_text import PIECE

# Lines that are worth a compiler of their own
_WORTH_A_COMPILER = 2_000
# By which a function's time in a compiler goes with its lines, and a loop beside it: by
# 1.7e-5 s of GCC 12 (40 functions of 60 to 4,900 lines, most within a third), a loop by
# 1.7 ms at -O1 and 2 to 3 at -O2
_STEEPNESS, _LOOP = 1.2, 100

_PIECES = re.compile(
    rf"^{re.escape(PIECE)}(void \w+\([^{{]*\)) \{{\n.*?^\}}\n", re.MULTILINE | re.DOTALL
)


def in_groups(functions: list[str]) -> list[list[str]]:
    """Functions shared out between compilers, the last one in the last group."""
    sizes = [text.count("\n") for text in functions]
    count = min(os.cpu_count() or 1, 8, sum(sizes) // _WORTH_A_COMPILER + 1)
    costs = [
        size**_STEEPNESS + _LOOP * text.count("for (")
        for size, text in zip(sizes, functions, strict=True)
    ]
    groups: list[list[str]] = [[] for _ in range(count)]
    loads = [0.0] * count
    groups[-1].append(functions[-1])
    loads[-1] = costs[-1]
    # the dearest first, each to who has least
    for i in sorted(range(len(functions) - 1), key=lambda i: -costs[i]):
        least = loads.index(min(loads))
        groups[least].append(functions[i])
        loads[least] += costs[i]
    return groups


def apart(texts: Sequence[str]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Texts of which pieces of long functions are compiled by themselves.

    Args:
        texts: Of functions of a program, written with what is in ``rows.h``.

    Returns:
        The texts less those pieces, and parts of further texts of the program, see
        :class:`rollkane.codegen.ffi_call.XlaCall`.
    """
    pieces = {x[0]: x[1] for text in texts for x in _PIECES.finditer(text)}
    if not pieces:
        return tuple(texts), ()
    rest = [_PIECES.sub("", text) for text in texts]
    *others, _ = in_groups([*pieces, "\n".join(rest)])
    moved = {text for group in others for text in group}

    def declared(piece: re.Match[str]) -> str:
        stays = piece[0] not in moved
        return piece[0] if stays else f"OF_THE_PROGRAM {piece[1]};\n"

    def defined(text: str) -> str:
        return text.replace(PIECE, "OF_THE_PROGRAM ", 1)

    further = [("rows.h", *map(defined, group)) for group in others if group]
    return tuple(_PIECES.sub(declared, text) for text in texts), tuple(further)
