"""Whether rates depend on time: by what is traced, and where it is, by their values."""

import functools
from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Times at which rates are compared [s]: from a fraction of any vibration's period to
# hours, so dense that what lasts a twentieth of the time since zero is not missed.
_FIRST, _LAST, _PER_DECADE = -4, 4, 50
# Of rates of the same state at two times: what carrying the state along for hours, with
# a drift known to 1e-9 [1/s], leaves open. What does depend on time seldom makes less.
_SAME = 1e-5

Rates = Callable[[Any, Array, Any], Any]


def uses_time(rates: Rates, model: Any, state: Any) -> bool:
    """Whether the traced rates of a model, ``rates(model, t, state)``, look at t."""
    leaves, tree = cast(tuple[list[Any], Any], jax.tree.flatten((model, state)))
    shapes = tuple((np.shape(x), np.dtype(jnp.result_type(x))) for x in leaves)
    return _uses_time(rates, tree, shapes)


@functools.lru_cache(maxsize=256)
def _uses_time(rates: Rates, tree: Any, shapes: tuple[Any, ...]) -> bool:
    def at(t: Array, *leaves: Array) -> Any:
        model, state = jax.tree.unflatten(tree, leaves)
        return rates(model, t, state)

    given = [jax.ShapeDtypeStruct(*one) for one in shapes]
    traced = jax.make_jaxpr(at)(jnp.zeros((), jnp.result_type(float)), *given).jaxpr
    time = traced.invars[0]
    return any(time is used for step in traced.eqns for used in step.invars)


def wide_times(
    kinks: Any = None, span: tuple[Any, Any] | None = None
) -> Float[np.ndarray, " T"]:
    """Times of all sizes, the first zero [s]; and between kinks, and within a span.

    Args:
        kinks: Of what is a function of time [s]; None: none are known.
        span: First and last time at which it is known [s]; None: all.
    """
    count = (_LAST - _FIRST) * _PER_DECADE + 1
    ahead = np.logspace(_FIRST, _LAST, count)
    times = [np.zeros(1), ahead, -ahead]
    if kinks is not None and np.size(kinks):
        known = np.sort(np.asarray(kinks, float))
        times += [known, 0.5 * (known[1:] + known[:-1])]
    found = np.concatenate(times)
    if span is not None:
        low, high = (float(end) for end in span)
        inside = found[(found >= low) & (found <= high)]
        found = np.concatenate([inside, np.linspace(low, high, count)])
    return found


def differing(rates: Float[np.ndarray, "T S 2 y"]) -> np.ndarray:
    """Numbers of the times at which rates are not those of the first time.

    Args:
        rates: At every time, of every state, and the sizes that they are told beside;
            not finite where there are none.
    """
    finite = np.all(np.isfinite(rates), axis=(2, 3))
    good: np.ndarray = finite & finite[:1]
    own = rates[:, :, 0]
    sizes = rates[0, :, 1].max(axis=0, initial=0.0, where=good[0][:, None])
    far: np.ndarray = np.abs(own - own[:1]) > _SAME * sizes
    return np.nonzero(np.any(far & good[:, :, None], axis=(1, 2)))[0]
