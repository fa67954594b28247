"""The impact of a body with Coulomb friction, integrated over its normal impulse.

Routh's process: the velocity of the point that touches follows the impulse, friction
acts against the slip of that instant, and the restitution of the energy that
compression took ends it (Stronge). So the impulse pushes, lies in the friction cone,
and its work is never positive, whatever the body. Equations: docs/theory.md, (8.6) to
(8.10).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.linear_call import Linear, linear_call, shapes_of
from ..codegen.tracing import traced_once
from ..geometry.small_linear import dot, matvec, safe_norm, solve_2x2
from .impact_slip import Left, Sliding, bendable, slid, slip_of, turning

# What stands for a body that never slips: above 1 / eps, where G_nn + mu G_nt rounds to
# the latter, in float32, too
NEVER_SLIPS = 1e16
# What a straight way may leave out, over the speed of the impact. In float32 rounding
# is more than that: of the eight products and sums that the slip's turn is made of
_STRAIGHT, _ROUNDINGS = 1e-10, 8


class Impact(NamedTuple):
    """What an impact leaves, on axes (t1, t2, n): n out of the base.

    Attributes:
        impulse: Of the base on the body [N s], shape (3,).
        velocity: Of the body's point over the base [m/s], shape (3,): zero along the
            surface where it sticks, along n where it stays.
    """

    impulse: Float[Array, "3"]
    velocity: Float[Array, "3"]


def collided(
    velocity: Float[Array, "3"],
    response: Float[Array, "3 3"],
    friction: Float[Array, ""],
    restitution: Float[Array, ""],
    rest_speed: Float[Array, ""],
) -> Impact:
    """The impact of a point that comes in with a velocity.

    Args:
        velocity: Of the body's point over the base [m/s], axes (t1, t2, n).
        response: ``G``, its change by an impulse [m/s per N s]; symmetric, positive.
        friction: Of sliding [1]; ``NEVER_SLIPS`` for a body that never slips.
        restitution: Of the energy: the square root of the share of the work of
            compression that is given back [1].
        rest_speed: What would rebound slower stays in contact [m/s].

    Both modes of differentiation go forwards, as the loop has as many turns as the
    impact needs: along a tangent, or by one number after the other.
    """
    inputs = jnp.concatenate(
        [velocity, response.reshape(9), jnp.stack([friction, restitution])]
    )
    found = _collided(inputs, rest_speed)
    return Impact(found[:3], found[3:])


@jax.custom_jvp
def _collided(
    inputs: Float[Array, "14"], rest_speed: Float[Array, ""]
) -> Float[Array, "6"]:
    return _process_of(inputs, rest_speed, turning)


@_collided.defjvp
def _collided_jvp(
    primals: tuple[Float[Array, "14"], Float[Array, ""]],
    tangents: tuple[Float[Array, "14"], Float[Array, ""]],
) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
    found = _collided(*primals)
    return found, linear_call(_CHANGES, primals, tangents[:1], shapes_of([found]))[0]


def _pushed(residuals: Sequence[Array], tangents: Sequence[Array]) -> list[Array]:
    """Change of an impact along a change of its inputs; NaN where it is lost."""
    inputs, rest_speed = residuals
    # a way that is straight by symmetry has neighbours that turn
    process: Callable[[Array], Array] = lambda x: _process_of(x, rest_speed, bendable)
    found, moved = jax.jvp(process, (inputs,), tuple(tangents))
    return [jnp.where(jnp.isnan(found), jnp.nan, moved)]


def _pulled(residuals: Sequence[Array], cotangents: Sequence[Array]) -> list[Array]:
    """Cotangent of an impact's inputs."""
    size, dtype = residuals[0].size, residuals[0].dtype

    def column(_: None, unit: Array) -> tuple[None, Array]:
        return None, dot(_pushed(residuals, [unit])[0], cotangents[0])

    return [jax.lax.scan(column, None, jnp.eye(size, dtype=dtype))[1]]


_CHANGES = Linear(_pushed, _pulled)


def _process_of(
    x: Float[Array, "14"], rest_speed: Float[Array, ""], left: "Left"
) -> Float[Array, "6"]:
    return _process(x[:3], x[3:12].reshape(3, 3), x[12], x[13], rest_speed, left)


def _process(
    velocity: Float[Array, "3"],
    G: Float[Array, "3 3"],
    mu: Float[Array, ""],
    e: Float[Array, ""],
    rest_speed: Float[Array, ""],
    left: Left,
) -> Float[Array, "6"]:
    """Impulse and velocity behind an impact, in one array."""
    zero, none = jnp.zeros_like(mu), jnp.asarray(0)
    y = jnp.concatenate([velocity, jnp.zeros(4, mu.dtype)])
    comes = velocity[2] < 0.0
    speed = safe_norm(velocity)
    straight = max(_STRAIGHT, _ROUNDINGS * float(np.finfo(velocity.dtype).eps))
    least = straight * jnp.where(comes, speed, jnp.inf)
    begun = Sliding(y, zero, zero, zero, none, zero, y, zero + 1.0, none)
    c = slid(G, mu, e, begun, left, speed, least)
    lost = comes & (c.phase < 2) & (left(G, mu, c, speed) > least)
    now = _Now(c.y[:3], c.y[3:6], c.y[6], c.phase, c.goal, c.closed[:6])
    slip, way = slip_of(now.velocity)
    push = jnp.append(-mu * way, jnp.ones_like(mu))
    change = matvec(G, push)
    slows = -dot(way, change[:2])
    # without friction nothing stops a slip, nor holds one that is zero
    stops = (mu > 0.0) & ((slip == 0.0) | (slows > 0.0))
    until = jnp.where(stops, slip / jnp.where(slows > 0.0, slows, 1.0), jnp.inf)
    now = now.pushed(push, change, e, until)
    # what rounding and the straight way left of the slip goes as well
    rest = -solve_2x2(G[:2, :2], now.velocity[:2])
    up = now.velocity[2] + dot(G[:2, 2], rest)
    stopped = now._replace(
        velocity=jnp.append(jnp.zeros_like(rest), up),
        impulse=now.impulse + jnp.append(rest, zero),
    )
    stopped = stopped.pushed(*_without_slip(G, mu), e, jnp.inf)
    slipped = (now.phase == 2) | ~stops
    pick: Callable[[Array, Array], Array] = lambda a, b: jnp.where(slipped, a, b)
    end = jax.tree.map(pick, now, stopped)
    stays = end.velocity[2] < rest_speed
    closed = jnp.concatenate([end.closed[3:6], end.closed[:2], zero[None]])
    found = jnp.concatenate([end.impulse, end.velocity])
    found = jnp.where(stays, closed, found)
    # what does not come in is not hit
    apart = jnp.maximum(velocity[2], 0.0)
    apart = jnp.where(apart < rest_speed, 0.0, apart)
    missed = jnp.concatenate([jnp.zeros_like(velocity), velocity[:2], apart[None]])
    return jnp.where(lost, jnp.nan, jnp.where(comes, found, missed))


class _Now(NamedTuple):
    """Where the process is; ``closed``: velocity and impulse as compression ended."""

    velocity: Float[Array, "3"]
    impulse: Float[Array, "3"]
    work: Array
    phase: Array
    goal: Array
    closed: Float[Array, "6"]

    def pushed(
        self,
        push: Float[Array, "3"],
        change: Float[Array, "3"],
        e: Float[Array, ""],
        until: Float[Array, ""] | float,
    ) -> "_Now":
        """Behind a push of constant direction, ``change`` of velocity for one N s.

        It lasts ``until`` a normal impulse, or to the end of the impact: the velocity
        is linear in p and W quadratic, so that both ends are roots of a quadratic.
        """
        u, rise = self.velocity[2], change[2]
        safe = jnp.where(rise > 0.0, rise, 1.0)
        close = jnp.where(rise > 0.0, -u / safe, jnp.inf)
        closes = (self.phase == 0) & (close < until)
        close = jnp.where(closes, close, 0.0)
        least = self.work + (u + 0.5 * rise * close) * close
        goal = jnp.where(closes, (1.0 - e * e) * least, self.goal)
        # restitution, from the end of compression or from here
        begun = jnp.where(closes, least, self.work)
        u = jnp.where(closes, 0.0, u)
        back = goal - begun
        reach = u * u + 2.0 * rise * back
        slow = u + _root(reach)
        more = jnp.where(slow > 0.0, 2.0 * back / jnp.where(slow > 0.0, slow, 1.0), 0.0)
        restores = closes | (self.phase == 1)
        ends = restores & (reach >= 0.0) & (close + more < until)
        last = jnp.where(ends, close + more, until)
        last = jnp.where((self.phase == 2) | jnp.isinf(last), 0.0, last)
        at_close = jnp.concatenate(
            [self.velocity + close * change, self.impulse + close * push]
        )
        phase = jnp.where(closes, 1, self.phase)
        start = self.velocity[2]
        return _Now(
            velocity=self.velocity + last * change,
            impulse=self.impulse + last * push,
            work=self.work + (start + 0.5 * rise * last) * last,
            phase=jnp.where(ends, 2, phase),
            goal=goal,
            closed=jnp.where(closes, at_close, self.closed),
        )


def _root(x: Float[Array, ""]) -> Float[Array, ""]:
    """Square root of what may be zero, where its derivative is taken as zero."""
    return jnp.where(x > 0.0, jnp.sqrt(jnp.where(x > 0.0, x, 1.0)), 0.0)


@traced_once
def _without_slip(
    G: Float[Array, "3 3"], mu: Float[Array, ""]
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Push along n of one N s on a point that does not slip, and its velocity's change.

    It sticks, or begins to slip along s: ``(mu G_tt + f) s = G_tn``, ``|s| = 1``, with
    f > 0 the rate of the slip.
    """
    A, b = G[:2, :2], G[:2, 2]
    eye = jnp.eye(2, dtype=A.dtype)
    holding = solve_2x2(A, b)
    sticks = dot(holding, holding) <= mu * mu
    of_slip = jnp.where(sticks, 0.0, mu) * A
    f = _rate_of_slip(of_slip, jnp.where(sticks, eye[0], b))
    s = solve_2x2(jnp.where(sticks, eye, of_slip + f * eye), b)
    along = jnp.where(sticks, -holding, -mu * s)
    push = jnp.append(along, jnp.ones_like(mu))
    rise = G[2, 2] + dot(b, along)
    return push, jnp.append(jnp.where(sticks, 0.0, f * s), rise)


def _rate_of_slip(A: Float[Array, "2 2"], b: Float[Array, "2"]) -> Float[Array, ""]:
    """The f > 0 with ``|(A + f)^-1 b| = 1``: Newton on ``1 / |s| - 1``, from below.

    That function of f is concave and rises, so that the iterates rise to the root.
    """
    eye = jnp.eye(2, dtype=A.dtype)

    def improved(f: Float[Array, ""], _: None) -> tuple[Float[Array, ""], None]:
        s = solve_2x2(A + f * eye, b)
        size = safe_norm(s)
        slope = dot(s, solve_2x2(A + f * eye, s)) / size**3
        return f + (1.0 - 1.0 / size) / slope, None

    trace = A[0, 0] + A[1, 1]
    least = jnp.maximum(safe_norm(b) - trace, 0.0)  # |s| >= |b| / (trace + f)
    f, _ = jax.lax.scan(improved, least, length=20)
    return f
