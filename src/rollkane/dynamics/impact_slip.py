"""The part of an impact in which the body's point slips, and its slip may turn.

Integrated in a time in which it is smooth as the slip ends. Equations: docs/theory.md,
(8.6) to (8.10).
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codegen.tableau import weights_of
from ..codegen.tracing import traced_once
from ..geometry.small_linear import dot, matvec, safe_norm

# A step of the method of order 8, times the fastest rate of the slip's direction:
# 0.5^9 / 9! = 5e-9 at most, of which its error constant leaves a hundredth
_STEP = 0.5
_CLOSE = 500  # roundings, of an end's equation: its Newton step is below one
# Slip times turn, and how that changes with the body, fade by mu A_tt (docs/theory.md,
# (8.9)): 23 / 0.5 turns each at the fastest rate, and a fortieth of it is allowed for
_TURNS = 4000


class Sliding(NamedTuple):
    """The process while it slips, in a time of its own: ``dp = |u_t| ds``.

    ``y`` is velocity (3), impulse (3) and the work W of its normal part.
    """

    y: Float[Array, "7"]
    trial: Array  # next step
    low: Array  # of a search for the end of a phase: steps on both sides of it
    high: Array
    phase: Array  # 0: compression; 1: restitution; 2: ended
    goal: Array  # of W in restitution
    closed: Float[Array, "7"]  # where compression ended
    bent: Array  # at most, what is left of neighbours' turns since its way is straight
    speed: Array  # of the impact [m/s]
    turns: Array


def _push(mu: Float[Array, ""], u: Float[Array, " n"]) -> Float[Array, "3"]:
    """``j' = (-mu u_t, |u_t|)`` of a velocity: smooth as the slip ends."""
    return jnp.concatenate([-mu * u[:2], safe_norm(u[:2])[None]])


@traced_once
def _stepped(
    G: Float[Array, "3 3"],
    mu: Float[Array, ""],
    y: Float[Array, "7"],
    h: Float[Array, ""],
) -> tuple[Float[Array, "7"], Float[Array, "7"]]:
    """One step of an explicit method of order 8, and the rates at its end.

    ``u' = G j'``, ``W' = |u_t| u_n``: velocities follow from impulses. Written out: in
    a batch a loop over its stages takes fourteen times as long.
    """
    start, at = y[:3], y[:3]
    pushes, work = [_push(mu, start)], jnp.zeros_like(h)
    powers = [pushes[0][2] * start[2]]
    rows = weights_of(dfx.Dopri8(), "an impact").rows
    impulse = jnp.zeros_like(start)
    for row in rows:
        impulse, work = (h * _weighted(row, x) for x in (pushes, powers))
        at = start + matvec(G, impulse)
        pushes.append(_push(mu, at))
        powers.append(pushes[-1][2] * at[2])
    end = jnp.concatenate([at, y[3:6] + impulse, (y[6] + work)[None]])
    push = pushes[-1]
    return end, jnp.concatenate([matvec(G, push), push, powers[-1][None]])


def _weighted(weights: tuple[float, ...], x: list[Array]) -> Array:
    """Sum of some arrays, each times a number."""
    terms = [w * k for w, k in zip(weights, x, strict=True) if w]
    return sum(terms[1:], terms[0])


def turning(G: Float[Array, "3 3"], mu: Float[Array, ""], c: Sliding) -> Array:
    """What the slip's turn may yet change of the velocity [m/s], about.

    Zero without friction: the velocity is then linear in the normal impulse.
    """
    return jnp.where(mu > 0.0, _ahead(G, mu, c) * _angle(G, mu, c), 0.0)


def bendable(G: Float[Array, "3 3"], mu: Float[Array, ""], c: Sliding) -> Array:
    """What neighbours' turns, of other body or friction, may [m/s].

    They settle as the way itself does, often faster than the slip ends.
    """
    turns = (mu > 0.0) | (safe_norm(G[:2, 2]) > 0.0)
    slip = jnp.where(turns, _ahead(G, mu, c), 0.0)
    return jnp.maximum(slip * c.bent, turning(G, mu, c))


def _angle(
    G: Float[Array, "3 3"], mu: Float[Array, ""], c: Sliding
) -> Float[Array, ""]:
    """By which a slip turns from here, about: its turn over the rate of settling.

    Slip times turn fades by ``mu A`` across the slip also where that is more.
    """
    _, way = slip_of(c.y)
    across = _across(way)
    fades = jnp.maximum(_settling(G, mu, way), mu * _quadratic(G, across))
    fades = jnp.where(fades > 0.0, fades, _fastest(G, mu))
    return jnp.abs(dot(across, _pull(G, mu, way))) / fades


def _ahead(G: Float[Array, "3 3"], mu: Float[Array, ""], c: Sliding) -> Array:
    """What an angle of its direction may yet change of the velocity [m/s].

    That goes with the impulse until the slip ends, at most to that of the impact.
    """
    slip, way = slip_of(c.y)
    slows, fastest = -dot(way, _pull(G, mu, way)), _fastest(G, mu)
    ends = slows * c.speed > fastest * slip
    until = fastest * slip / jnp.where(ends, slows, 1.0)
    return jnp.where(ends | (slip == 0.0), until, jnp.maximum(slip, c.speed))


def _across(way: Float[Array, "2"]) -> Float[Array, "2"]:
    return jnp.stack([-way[1], way[0]])


def _pull(
    G: Float[Array, "3 3"], mu: Float[Array, ""], way: Float[Array, "2"]
) -> Float[Array, "2"]:
    """Change of the slip for one newton second of normal impulse [m/s]."""
    return G[:2, 2] - mu * matvec(G[:2, :2], way)


def _settling(
    G: Float[Array, "3 3"], mu: Float[Array, ""], way: Float[Array, "2"]
) -> Float[Array, ""]:
    """Rate at which the direction of a slip that goes straight settles."""
    return dot(way, _pull(G, mu, way)) + mu * _quadratic(G, _across(way))


def _quadratic(G: Float[Array, "3 3"], way: Float[Array, "2"]) -> Float[Array, ""]:
    """``A`` along a direction."""
    return dot(way, matvec(G[:2, :2], way))


# What a straight way would leave out [m/s], of response, friction and process.
Left: TypeAlias = Callable[[Array, Array, Sliding], Array]


def slip_of(
    velocity: Float[Array, " m"],
) -> tuple[Float[Array, ""], Float[Array, "2"]]:
    """Slip [m/s] and its direction, zero where it does not slip."""
    slip = safe_norm(velocity[:2])
    return slip, velocity[:2] / jnp.where(slip > 0.0, slip, 1.0)


def _fastest(G: Float[Array, "3 3"], mu: Float[Array, ""]) -> Float[Array, ""]:
    """A bound of the rates of the slip's direction and logarithm."""
    rate = mu * (G[0, 0] + G[1, 1]) + safe_norm(G[:2, 2])
    return jnp.where(rate > 0.0, rate, 1.0)


def slid(
    G: Float[Array, "3 3"],
    mu: Float[Array, ""],
    e: Float[Array, ""],
    start: Sliding,
    left: Left,
    least: Float[Array, ""],
) -> Sliding:
    """Until the impact has ended, or the slip goes straight: to its end, if any."""
    step = jax.lax.stop_gradient(_STEP / _fastest(G, mu))
    eps = np.finfo(G.dtype).eps

    def going(c: Sliding) -> Bool[Array, ""]:
        turns = left(G, mu, c) > least
        return turns & (c.phase < 2) & (c.turns < _TURNS)

    def turn(c: Sliding) -> Sliding:
        y, rates = _stepped(G, mu, c.y, c.trial)
        compresses = c.phase == 0
        end = jnp.where(compresses, y[2], y[6] - c.goal)
        rate = jnp.where(compresses, rates[2], rates[6])
        size = jnp.where(compresses, jnp.abs(c.y[2]), jnp.abs(c.goal - c.y[6]))
        newton = -end / jnp.where(rate == 0.0, 1.0, rate)
        ends = jnp.abs(end) <= _CLOSE * eps * size
        beyond = (end > 0.0) & ~ends
        searching = beyond | (c.high > 0.0)
        low = jnp.where(searching & ~beyond, c.trial, c.low)
        high = jnp.where(beyond, c.trial, c.high)
        # a bracket that has no number left between its sides has found it, too
        ends |= searching & (high - low <= 4.0 * eps * high)
        steps = ~searching & ~ends
        over = steps | ends
        tried = c.trial + newton
        inside = (tried > low) & (tried < high)
        tried = jnp.where(inside, tried, 0.5 * (low + high))
        at_end = y + newton * rates  # value zero: an end's derivative
        moved = jnp.where(ends, at_end, jnp.where(steps, y, c.y))
        zero = jnp.zeros_like(c.low)
        closes = ends & compresses
        goal = (1.0 - e * e) * at_end[6]
        # exp(-x) is less than this share
        x = jnp.maximum(_settling(G, mu, slip_of(c.y)[1]) * c.trial, 0.0)
        settles = over & (_ahead(G, mu, c) * _angle(G, mu, c) <= least)
        share = jnp.where(settles, 1.0 / (1.0 + x + 0.5 * x * x), 1.0)
        # e = 0 gives nothing back
        phase = jnp.where(ends, c.phase + 1, c.phase)
        phase = jnp.where(closes & (e == 0.0), 2, phase)
        return Sliding(
            y=moved,
            trial=jnp.where(over, step, tried),
            low=jnp.where(over, zero, low),
            high=jnp.where(over, zero, high),
            phase=phase,
            goal=jnp.where(closes, goal, c.goal),
            closed=jnp.where(closes, at_end, c.closed),
            bent=c.bent * jax.lax.stop_gradient(share),
            speed=c.speed,
            turns=c.turns + 1,
        )

    return jax.lax.while_loop(going, turn, start._replace(trial=step))
