"""Rates of two contact points that roll on each other, without charts.

Which of them are unknowns depends on what cannot vanish there (docs/theory.md, (3.5)).
All vectors are on BODY axes.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry, travel
from ..geometry.small_linear import (
    components,
    dot,
    matmul,
    matvec,
    matvec_transposed,
    solve_2x2,
    solve_4x4,
)
from ..geometry.surfaces import AbstractSurface

Pair = tuple[Float[Array, "3"], Float[Array, "3"]]  # of tangent vectors
# velocity of the contact point along the body, rates on the body, rates on the base
Rolled = tuple[Float[Array, "3"], Float[Array, "2"], Float[Array, "2"]]
# of body, base, rotation from body to base axes, n x Om, and slip
Roll = Callable[[LocalGeometry, LocalGeometry, Array, Array, Array | None], Rolled]


def tangents_in_body(ground: LocalGeometry, rotation: Float[Array, "3 3"]) -> Pair:
    """The base's tangent pair on body axes."""
    return (
        matvec_transposed(rotation, ground.frame[:, 0]),
        matvec_transposed(rotation, ground.frame[:, 1]),
    )


def along_base(
    slip: Float[Array, "3"] | None, velocity: Float[Array, "3"]
) -> Float[Array, "3"]:
    """Velocity of the contact point along the base."""
    return velocity if slip is None else velocity + slip


def _on_pair(pair: Pair, vector: Float[Array, "3"]) -> Float[Array, "2"]:
    return jnp.stack([dot(pair[0], vector), dot(pair[1], vector)])


def from_pair(pair: Pair, steps: Float[Array, "2"]) -> Float[Array, "3"]:
    """The vector with these parts along a tangent pair."""
    first, second = components(steps)
    return first * pair[0] + second * pair[1]


def rolling_unknowns(body: AbstractSurface, base: AbstractSurface) -> Roll:
    """Which unknowns are solved for, where the body has contact coordinates."""
    if base.is_flat:
        return _roll_on_plane
    return _roll_as_wire if body.is_wire else _roll_on_base


def roll_by_normal(
    shell: LocalGeometry,
    ground: LocalGeometry,
    pair: Pair,
    turning: Float[Array, "3"],
    slip: Float[Array, "3"] | None,
) -> tuple[Float[Array, "3"], Float[Array, "2"]]:
    """By the body's normal (K_b = 1): ``(L_c + L_b K_c) x_c = L_b r + U``."""
    lengths_b = shell.lengths
    system = ground.lengths - matmul(lengths_b, ground.frame_rates)
    rhs = matvec(lengths_b, _on_pair(pair, turning))
    if slip is not None:
        rhs = rhs + _on_pair(pair, slip)
    x_base = solve_2x2(system, rhs)
    velocity = from_pair(pair, matvec(ground.lengths, x_base))
    return velocity if slip is None else velocity - slip, x_base


def _roll_on_plane(
    shell: LocalGeometry,
    ground: LocalGeometry,
    rotation: Float[Array, "3 3"],
    turning: Float[Array, "3"],
    slip: Float[Array, "3"] | None,
) -> Rolled:
    """Explicit contact coordinates, on a plane: ``K_b x_b = r``."""
    del ground
    pair = shell.frame[:, 0], shell.frame[:, 1]
    x_body = solve_2x2(-shell.frame_rates, _on_pair(pair, turning))
    velocity = travel(shell, x_body)
    return velocity, x_body, matvec(rotation[:2], along_base(slip, velocity))


def _roll_on_base(
    shell: LocalGeometry,
    ground: LocalGeometry,
    rotation: Float[Array, "3 3"],
    turning: Float[Array, "3"],
    slip: Float[Array, "3"] | None,
) -> Rolled:
    """Explicit contact coordinates.

    ``(K_b L_b^-1 T L_c + T K_c) x_c = r + K_b L_b^-1 U``, where ``T[m, a] = e_m . t_a``
    takes the base's tangent pair to the body's.
    """
    pair = shell.frame[:, 0], shell.frame[:, 1]
    tangents = tangents_in_body(ground, rotation)
    mixing = jnp.stack([_on_pair(tangents, e) for e in pair])
    steps = matmul(mixing, ground.lengths)
    columns = [solve_2x2(shell.lengths, steps[:, a]) for a in range(2)]
    own = jnp.stack(columns, axis=1)  # L_b^-1 T L_c
    system = -matmul(shell.frame_rates, own) - matmul(mixing, ground.frame_rates)
    rhs = _on_pair(pair, turning)
    if slip is None:
        x_base = solve_2x2(system, rhs)
        return from_pair(pair, matvec(steps, x_base)), matvec(own, x_base), x_base
    left_out = solve_2x2(shell.lengths, _on_pair(pair, slip))  # L_b^-1 U
    x_base = solve_2x2(system, rhs - matvec(shell.frame_rates, left_out))
    velocity = from_pair(pair, matvec(steps, x_base)) - slip
    return velocity, matvec(own, x_base) - left_out, x_base


def _roll_as_wire(
    shell: LocalGeometry,
    ground: LocalGeometry,
    rotation: Float[Array, "3 3"],
    turning: Float[Array, "3"],
    slip: Float[Array, "3"] | None,
) -> Rolled:
    """Body that is a wire: ``K_b x_b + T K_c x_c = r``, ``T L_c x_c - L_b x_b = U``."""
    pair = shell.frame[:, 0], shell.frame[:, 1]
    tangents = tangents_in_body(ground, rotation)
    mixing = jnp.stack([_on_pair(tangents, e) for e in pair])
    steps = matmul(mixing, ground.lengths)
    turns = -matmul(mixing, ground.frame_rates)
    above = jnp.concatenate([-shell.frame_rates, turns], axis=1)
    below = jnp.concatenate([-shell.lengths, steps], axis=1)
    across = _on_pair(pair, turning)
    along = jnp.zeros_like(across) if slip is None else _on_pair(pair, slip)
    x = solve_4x4(jnp.concatenate([above, below]), jnp.concatenate([across, along]))
    return from_pair(pair, matvec(shell.lengths, x[:2])), x[:2], x[2:]
