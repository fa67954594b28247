"""What a loop's body computes in every turn, though no turn changes it.

Samples of a surface and their places are the same wherever a search begins: they are
computed once, ahead of it. A compiler of C does so with single numbers alone.
"""

from collections.abc import Callable, Iterable, Sequence

from .jaxpr_types import Equation, Variable
from .value_uses import is_literal


def invariants(
    equations: Sequence[Equation],
    fixed: Iterable[Variable],
    is_worth: Callable[[Equation], bool],
) -> list[Equation]:
    """Equations of a loop's body that are computed ahead of it, in order.

    Args:
        equations: Of the body.
        fixed: What no turn changes.
        is_worth: Whether an equation is computed there for its own sake, not only
            because another takes what it gives.
    """
    known, found = set(fixed), list[Equation]()
    for equation in equations:
        if all(is_literal(v) or v in known for v in equation.invars):
            found.append(equation)
            known.update(equation.outvars)
    wanted, taken = set[Variable](), list[Equation]()
    for equation in reversed(found):
        if wanted.isdisjoint(equation.outvars) and not is_worth(equation):
            continue
        taken.append(equation)
        wanted.update(v for v in equation.invars if not is_literal(v))
    return taken[::-1]
