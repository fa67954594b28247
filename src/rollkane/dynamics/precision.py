"""What bounds that are written for double precision are in another."""

import numpy as np
from jaxtyping import Array, Float

_DOUBLE = float(np.log(np.finfo(np.float64).eps))


def at_precision(bound: float, x: Float[Array, "..."] | np.ndarray) -> float:
    """A bound that stands for a share of the digits: that share of those of ``x``.

    Of 1e-9 more than half of the digits: 1e-4 in single precision.

    Args:
        bound: In double precision, below 1, of numbers in SI units or without a unit.
        x: Numbers of the precision that is asked for.
    """
    share = float(np.log(np.finfo(x.dtype).eps)) / _DOUBLE
    return bound if share == 1.0 else bound**share
