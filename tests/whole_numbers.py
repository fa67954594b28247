"""Functions of a real number whose whole numbers leave their types, or nearly do."""

import jax
import jax.numpy as jnp

NARROW = "int8 int16 int32 uint8 uint16 uint32".split()  # noqa: SIM905


def wrapping(x, kind, scale):
    """What numbers of a type give where they do not fit into it; of one real number."""
    most, big = jnp.iinfo(kind).max, jnp.asarray(7, kind)
    i = jnp.floor(scale * x).astype(kind)
    j = jnp.asarray(most, kind) - i
    zero = (i > i).astype(kind)
    parts = [
        i * i * big + j,
        i - jnp.asarray(5, kind),
        -i,
        jnp.abs(i),
        jnp.square(j),
        ~i,
        jax.lax.div(i, zero),
        jax.lax.rem(j, zero),
        jax.lax.rem(j, big),
        jnp.maximum(i, j),
        jnp.where(x > 0.1, i, j),
        jax.lax.clamp(zero, i, big),
        jax.lax.shift_left(i, big),
        jax.lax.shift_right_arithmetic(i, big),
        jax.lax.shift_right_logical(i, jnp.asarray(3, kind)),
        (i & j) ^ (i | big),
    ]
    if jnp.issubdtype(kind, jnp.signedinteger):
        least = jnp.asarray(jnp.iinfo(kind).min, kind) + zero
        parts += [jax.lax.div(least, zero - jnp.asarray(1, kind)), jnp.sign(i)]
    other = [x.astype(y) for x, y in zip([i, j] * 3, NARROW, strict=True)]
    tests = [i < j, i >= j, i == j, i.astype(bool), x.astype(kind) > big]
    # divided by the largest, so that no part hides the others
    share = [part.astype(x.dtype) / most for part in parts]
    share += [part.astype(x.dtype) / jnp.iinfo(part.dtype).max for part in other]
    return jnp.stack([*share, *(part.astype(x.dtype) for part in tests)])


def noise(x):
    """Numbers of a generator of 64 bits, as users write one; of one real number."""
    i = jnp.floor(1000.0 * x).astype(jnp.result_type(int))
    i = (i * 1103515245 + 12345) % 2147483648
    i = (i * 1103515245 + 12345) % 2147483648
    return i.astype(x.dtype) / 2147483648


def least_and_most(x):
    """Numbers that no type holds, and none; of one real number."""
    outside = jnp.stack([1e30 * x, jnp.inf * x, jnp.nan * x, -3.5 + x])
    kinds = *NARROW, "int64"
    found = [outside.astype(kind).astype(x.dtype) for kind in kinds]
    sizes = [float(jnp.iinfo(kind).max) for kind in kinds]
    return jnp.concatenate([a / size for a, size in zip(found, sizes, strict=True)])
