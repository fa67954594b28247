"""Functions whose traced numbers are arguments, for programs that are given them."""

from collections.abc import Callable
from typing import cast

import jax
from jax.extend import core
from jaxtyping import Array

from ..validation.checks import is_traced
from .jaxpr_types import Shaped


def opened(
    function: Callable[..., Array], state: Shaped, leaves: list[Array], before: int = 0
) -> tuple[Callable[..., Array], list[Array]]:
    """A function with the traced arrays that it closes over as arguments.

    Behind the leaves, and behind ``before`` others that it does not look at. In a batch
    they may differ from motion to motion as well.
    """
    like = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves]
    time = jax.ShapeDtypeStruct((), state.dtype)
    traced = jax.make_jaxpr(function)(time, state, *like)
    places = [i for i, x in enumerate(traced.consts) if is_traced(x)]

    def opened(t: Array, y: Array, *arguments: Array) -> Array:
        consts, first = list(traced.consts), len(leaves) + before
        for place, x in zip(places, arguments[first:], strict=False):
            consts[place] = x
        program = core.ClosedJaxpr(traced.jaxpr, consts)
        again = cast("Callable[..., list[Array]]", core.jaxpr_as_fun(program))
        (found,) = again(t, y, *arguments[: len(leaves)])
        return found

    return opened, [traced.consts[i] for i in places]
