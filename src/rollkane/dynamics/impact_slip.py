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


class Course(NamedTuple):
    """How straight a slip goes.

    Attributes:
        change: What its own turn may yet change of the velocity, about [m/s].
        ahead: What any angle of its direction may: it goes with the impulse until the
            slip ends, at most to that of the impact [m/s].
        settles: Rate at which its direction settles, where it goes straight.
    """

    change: Float[Array, ""]
    ahead: Float[Array, ""]
    settles: Float[Array, ""]

    @staticmethod
    def of(
        G: Float[Array, "3 3"],
        mu: Float[Array, ""],
        c: Sliding,
        speed: Float[Array, ""],
    ) -> "Course":
        """Of a response, a friction, a process and the speed of the impact."""
        slip, way = slip_of(c.y)
        across = jnp.stack([-way[1], way[0]])
        pull = G[:2, 2] - mu * matvec(G[:2, :2], way)  # of a newton second along n
        # slip times turn fades by the friction across the slip, also as the slip slows
        holds = mu * dot(across, matvec(G[:2, :2], across))
        slows, fastest = -dot(way, pull), _fastest(G, mu)
        settles = holds - slows
        fades = jnp.maximum(settles, holds)
        fades = jnp.where(fades > 0.0, fades, fastest)
        ends = slows * speed > fastest * slip
        until = fastest * slip / jnp.where(ends, slows, 1.0)
        ahead = jnp.where(ends | (slip == 0.0), until, jnp.maximum(slip, speed))
        return Course(ahead * jnp.abs(dot(across, pull)) / fades, ahead, settles)


def turning(
    G: Float[Array, "3 3"], mu: Float[Array, ""], c: Sliding, speed: Float[Array, ""]
) -> Float[Array, ""]:
    """What the slip's turn may yet change of the velocity, about [m/s].

    Zero without friction: the velocity is then linear in the normal impulse.
    """
    return jnp.where(mu > 0.0, Course.of(G, mu, c, speed).change, 0.0)


def bendable(
    G: Float[Array, "3 3"], mu: Float[Array, ""], c: Sliding, speed: Float[Array, ""]
) -> Float[Array, ""]:
    """What it may, and the turns of neighbours with other body or friction [m/s].

    They settle as the way itself does, often faster than the slip ends.
    """
    course = Course.of(G, mu, c, speed)
    turns = (mu > 0.0) | (safe_norm(G[:2, 2]) > 0.0)
    own = jnp.where(mu > 0.0, course.change, 0.0)
    return jnp.maximum(jnp.where(turns, course.ahead * c.bent, 0.0), own)


# What a straight way would leave out [m/s], of response, friction, process and speed.
Left: TypeAlias = Callable[[Array, Array, Sliding, Array], Array]


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
    speed: Float[Array, ""],
    least: Float[Array, ""],
) -> Sliding:
    """Until the impact has ended, or the slip goes straight: to its end, if any."""
    step = jax.lax.stop_gradient(_STEP / _fastest(G, mu))
    eps = np.finfo(G.dtype).eps

    def going(c: Sliding) -> Bool[Array, ""]:
        turns = left(G, mu, c, speed) > least
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
        course = Course.of(G, mu, c, speed)
        x = jnp.maximum(course.settles * c.trial, 0.0)
        # exp(-x) is less than this share
        straight = over & (course.change <= least)
        share = jnp.where(straight, 1.0 / (1.0 + x + 0.5 * x * x), 1.0)
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
            turns=c.turns + 1,
        )

    return jax.lax.while_loop(going, turn, start._replace(trial=step))
