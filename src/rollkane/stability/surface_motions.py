"""Rigid motions that carry a surface into itself, found from its samples.

A motion is a twist (v, w): ``v + w x p`` at the point p. The contact coordinates follow
it by an affine law ``u' = M u + b`` in every coordinates of the catalogue (a pair, a
direction, a point), so that its flow is exact.
"""

from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..geometry.surfaces import AbstractSurface

# Of samples whose rounding is some 1e-13: a surface that misses its own symmetry by
# more than this share of its size has none.
LOOSE = {8: 1e-9, 4: 1e-4}
_MOST = 60  # samples looked at


class SurfaceMotions(NamedTuple):
    """Rigid motions that carry a surface into itself.

    Attributes:
        twists: Velocity of the origin [m/s] and angular velocity [rad/s], owner's axes,
            one row for each motion, shape (K, 6).
        maps: ``[[M, b], [0, 0]]`` of the contact coordinates, shape (K, k + 1, k + 1).
    """

    twists: np.ndarray
    maps: np.ndarray


class _Samples(NamedTuple):
    u: Any  # arrays of JAX, then of NumPy
    position: Any
    frame: Any
    lengths: Any
    frame_rates: Any
    steps: Any  # rates of u by unit local rates, (S, k, 2)


def seeds(surface: AbstractSurface) -> np.ndarray:
    """Contact coordinates over a surface, shape (S, k)."""
    return _thinned(np.asarray(surface.samples()))


def _thinned(u: np.ndarray) -> np.ndarray:
    """A few of many, off any grid's pattern."""
    if u.shape[0] <= _MOST:
        return u
    chosen = np.random.default_rng(0).choice(u.shape[0], _MOST, replace=False)
    return u[np.sort(chosen)]


@for_one_call
def _sampled(surface: AbstractSurface, u: Array) -> _Samples:
    def one(u: Array) -> _Samples:
        g = surface.geometry(u)
        axes = jnp.eye(2, dtype=u.dtype)
        steps = [surface.coordinate_rates(u, g, axis) for axis in axes]
        across = jnp.stack(steps, axis=1)
        return _Samples(u, g.position, g.frame, g.lengths, g.frame_rates, across)

    return jax.vmap(one)(u)


def surface_motions(surface: AbstractSurface) -> SurfaceMotions:
    """All rigid motions that carry a surface into itself.

    Those along and about the owner's axes stand by themselves where there are such.

    Args:
        surface: Of a body or a base; one of the user's, too.
    """
    dtype = jax.tree.leaves((surface, jnp.zeros(())))[0].dtype
    u = jnp.asarray(seeds(surface), dtype)
    found = [np.asarray(x, float) for x in _sampled(surface, u)]
    parts = [np.reshape(x, (x.shape[0], -1)) for x in found]
    good = np.all(np.isfinite(np.concatenate(parts, axis=1)), axis=1)
    samples = _Samples(*(x[good] for x in found))
    k, loose = u.shape[1], LOOSE[np.dtype(dtype).itemsize]
    none = SurfaceMotions(np.zeros((0, 6)), np.zeros((0, k + 1, k + 1)))
    if samples.u.shape[0] < 12:
        return none
    size = float(np.median(np.linalg.norm(samples.position, axis=1))) or 1.0
    normal, p = samples.frame[:, :, 2], samples.position / size
    rows = np.concatenate([normal, np.cross(p, normal)], axis=1)
    null = null_space(rows, loose * np.sqrt(rows.shape[0]))
    twists: list[np.ndarray] = []
    maps: list[np.ndarray] = []
    for twist in echelon(null):
        v, w = twist[:3] * size, twist[3:]
        made = _coordinate_map(samples, v, w, size, loose)
        if made is not None:
            # by unit angular velocity, or by unit velocity where nothing turns
            unit = float(np.linalg.norm(w)) or float(np.linalg.norm(v))
            twists.append(np.concatenate([v, w]) / unit)
            maps.append(made / unit)
    return SurfaceMotions(np.stack(twists), np.stack(maps)) if twists else none


def _coordinate_map(
    samples: _Samples, v: np.ndarray, w: np.ndarray, size: float, loose: float
) -> np.ndarray | None:
    """The affine law of the coordinates under a twist; None: they have none."""
    tangents = samples.frame[:, :, :2]
    moved = np.einsum("sia,si->sa", tangents, v + np.cross(w, samples.position))
    turned = np.cross(w, samples.frame[:, :, 2])
    turned = np.einsum("sia,si->sa", tangents, turned)
    rates: list[np.ndarray] = []
    for k in range(samples.u.shape[0]):
        both = np.concatenate([samples.lengths[k] / size, -samples.frame_rates[k]])
        wanted = np.concatenate([moved[k] / size, turned[k]])
        x = np.linalg.lstsq(both, wanted, rcond=loose)[0]
        if np.max(np.abs(both @ x - wanted)) > loose * max(1.0, np.abs(wanted).max()):
            return None
        rates.append(samples.steps[k] @ x)
    u, u_dot = samples.u, np.stack(rates)
    known = np.concatenate([u, np.ones((u.shape[0], 1))], axis=1)
    law = np.linalg.lstsq(known, u_dot, rcond=loose)[0]
    if np.max(np.abs(known @ law - u_dot)) > loose * max(1.0, np.abs(u_dot).max()):
        return None
    law[np.abs(law) < loose * np.abs(law).max()] = 0.0
    return np.concatenate([law.T, np.zeros((1, u.shape[1] + 1))])


def null_space(rows: np.ndarray, loose: float) -> np.ndarray:
    """Unit vectors that all rows leave at zero, shape (K, columns)."""
    if not rows.shape[1]:
        return np.zeros((0, 0))
    if rows.shape[0] > rows.shape[1]:
        # which has the same; the left vectors of many rows would fill the memory
        rows = cast(np.ndarray, np.linalg.qr(rows, mode="r"))
    _, values, right = np.linalg.svd(rows, full_matrices=True)
    full = np.zeros(rows.shape[1])
    full[: values.size] = values
    return right[full <= loose]


def echelon(rows: np.ndarray) -> np.ndarray:
    """The same space by rows of which each has a place that no other has.

    By Gauss and Jordan with complete pivoting: axes stand alone where they can. In the
    order of these places.
    """
    a: np.ndarray = np.array(rows, float)
    places: list[int] = []
    first = np.linspace(1.0, 1.0 - 1e-6, a.shape[1])
    for k in range(a.shape[0]):
        left: np.ndarray = np.abs(a[k:]) * first
        row, column = divmod(int(np.argmax(left)), a.shape[1])
        a[[k, k + row]] = a[[k + row, k]]
        a[k] /= a[k, column]
        weights = np.array(a[:, column])
        weights[k] = 0.0
        a -= np.outer(weights, a[k])
        places.append(column)
    a[np.abs(a) < 1e-8 * np.abs(a).max(initial=1.0)] = 0.0
    return a[np.argsort(places)]
