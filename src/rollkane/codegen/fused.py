"""Products that are added, as fused multiply-adds: chosen here, not by a compiler.

Compilers that may fuse products and sums do so by rules of their own: the same motion
would be rounded otherwise in lanes than alone, and on a GPU than on a processor.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

# of functions of rows.h: x y + z, x y - z, z - x y, -x y - z
FUSED = frozenset({"fma", "fms", "fnma", "fnms"})
SUMS = frozenset({"add", "add_any", "sub"})
_ADDED = {False: "fma", True: "fnma"}  # of a product, by whether it is a negative one
_TAKEN = {False: "fnma", True: "fma"}
_LESSENED = {False: "fms", True: "fnms"}


class _Product(NamedTuple):
    factors: tuple[Any, Any]
    negative: bool


class Products:
    """Which numbers of a program in C are products, by how they are written."""

    def __init__(self):
        """None yet."""
        self._of: dict[str, _Product] = {}

    def note(self, name: str, operands: Sequence[Any], text: str) -> None:
        """Remember what a number that is written so is, if it is a product.

        Args:
            name: Of an operation of XLA's on real numbers.
            operands: Numbers, known or with a ``text``; they do not change.
            text: How its value is written.
        """
        if name in ("mul", "square"):
            self._of[text] = _Product((operands[0], operands[-1]), False)
        elif name == "neg":
            product = self._product(operands[0])
            if product is not None:
                self._of[text] = product._replace(negative=not product.negative)

    def holds(self, x: Any) -> bool:
        """Whether a number is a product."""
        return self._product(x) is not None

    def fused(self, name: str, operands: list[Any]) -> tuple[str, list[Any]]:
        """An operation: fused with a product that it adds or subtracts, if it does.

        Of two products the second, as the first was there before.
        """
        if name not in SUMS:
            return name, operands
        first, second = map(self._product, operands)
        if second is not None:
            names = _TAKEN if name == "sub" else _ADDED
            return names[second.negative], [*second.factors, operands[0]]
        if first is not None:
            names = _LESSENED if name == "sub" else _ADDED
            return names[first.negative], [*first.factors, operands[1]]
        return name, operands

    def _product(self, x: Any) -> _Product | None:
        return self._of.get(getattr(x, "text", ""))
