"""Accelerations under a contact law: rolling, rubber rolling, slipping, resistance.

Rolling alone solves one system. Every further law adds a multiplier: the spin torque of
rubber, and the normal force where something is proportional to it. Accelerations are
affine in the multipliers, and so are the conditions that determine them.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.rotations import tangent_pair
from ..geometry.small_linear import (
    Entry,
    Solver,
    components,
    cross,
    dot,
    factored_spd,
    matvec_transposed,
    sign,
    solve_spd,
)
from ..kinematics.contact import Contact
from ..validation.checks import FieldError
from .directed_friction import Balance, DirectedFriction, first_way, settling_way
from .mass_matrix import System
from .momentum import (
    Solution,
    coupled_along,
    coupled_along_axes,
    momentum_rate,
    with_point,
)
from .scene import Scene, Slipping


def accelerations(
    scene: Scene, t: Float[Array, ""], contact: Contact, system: System
) -> Solution:
    """Accelerations of a scene under its contact law.

    Args:
        scene: What rolls on what.
        t: Time [s].
        contact: Its contact.
        system: Its mass matrix and right-hand side.

    Raises:
        FieldError: a law that the contact's coordinates do not have.

    Source: docs/theory.md, (4.3), (7.1) to (7.4).
    """
    law = scene.contact
    if (law.slips or law.without_spin) and contact.normal_rate is None:
        problem = "does not belong to a state that rolls without slipping"
        remedy = "use Rolling(), or a state of this scene in pole-free coordinates"
        raise FieldError("Scene.contact", law, problem, remedy)
    if not law.touches:
        return _flying(scene, contact, system)
    resisting = _resistance(scene, contact)
    if law.slips:
        return _slipping(scene, contact, system, resisting)
    pushes: list[_Push] = []
    if law.without_spin:
        pushes.append(_against_spin(contact, len(system.rows)))
    if resisting is not None:
        push = _by_normal_force(scene, contact, system, resisting, [])
        pushes.append(push._replace(one_sided=law.one_sided))
    if not pushes:
        return _parted(solve_spd(system.rows, system.rhs))
    x, multipliers, margin = _solve(factored_spd(system.rows), system.rhs, pushes)
    torques = [
        z * jnp.stack([x for x in push.force[:3] if x is not None])
        for z, push in zip(multipliers, pushes, strict=True)
    ]
    return _parted(x)._replace(moment=sum(torques[1:], torques[0]), margin=margin)


class _Push(NamedTuple):
    """A force of unknown size z, and the condition ``row . x + own z = value``.

    ``force`` and ``row`` have one entry for each acceleration, None where it is zero;
    ``signed`` says that z is a normal force, whose friction acts with its size, but for
    ``one_sided``.
    """

    force: list[Entry]
    row: list[Entry]
    own: float
    value: Array
    signed: bool
    one_sided: bool = False


def _against_spin(contact: Contact, count: int) -> _Push:
    """Spin torque about the normal: ``d/dt (w - w_c) . N = 0``."""
    N, Om = contact.normal, contact.relative_angular_velocity
    assert contact.normal_rate is not None
    value = -dot(Om, contact.normal_rate)
    base = contact.base
    if base is not None and base.angular_acceleration is not None:
        turned = matvec_transposed(contact.to_base, base.angular_acceleration)
        value = value + dot(N, turned)
    column = [*components(N), *[None] * (count - 3)]
    return _Push(column, column, 0.0, value, False)


def _by_normal_force(
    scene: Scene,
    contact: Contact,
    system: System,
    moment: Float[Array, "3"] | None,
    shares: Sequence[Entry],
) -> _Push:
    """What is proportional to the normal force ``N = -Rc . N``, for one newton."""
    P = momentum_rate(scene, contact, system)
    N = contact.normal
    torque = [None] * 3 if moment is None else components(moment)
    row = [*components(cross(P.first_moment, N)), *(dot(u, N) for u in P.columns)]
    force = [*torque, *[None] * len(P.columns), *shares]
    whole = [*row, *[None] * len(shares)]
    return _Push(force, whole, 1.0, -dot(P.known, N), True)


def _slipping(
    scene: Scene, contact: Contact, system: System, resisting: Float[Array, "3"] | None
) -> Solution:
    """Two more accelerations: of the point at the contact, along the surface."""
    P = momentum_rate(scene, contact, system)
    slip = contact.slip
    assert isinstance(scene.contact, Slipping)
    assert slip is not None
    friction = scene.contact.friction
    pair = tangent_pair(contact.normal)
    push = -P.known
    by_itself = friction.force(slip)
    if by_itself is not None:
        push = push + by_itself
    solve = with_point(P, system, coupled_along(P, pair))
    rhs = [*system.rhs, *(dot(push, e) for e in pair)]
    ratio = friction.ratio(slip)
    margin = moment = turn = None
    if ratio is None and resisting is None:
        x = solve(rhs)
    else:
        shares = [None, None] if ratio is None else [dot(ratio, e) for e in pair]
        push = _by_normal_force(scene, contact, system, resisting, shares)
        push = push._replace(one_sided=friction.one_sided)
        if isinstance(friction, DirectedFriction) and friction.decides:
            along = jnp.stack([dot(slip, e) for e in pair])
            push, turn = _as_it_begins(friction, solve, rhs, push, pair, along)
        x, (N,), margin = _solve(solve, rhs, [push])
        moment = None if resisting is None else N * resisting
        turn = None if turn is None else turn * jnp.abs(N)
    slid = x[-2] * pair[0] + x[-1] * pair[1]
    solution = _parted(x[:-2])._replace(slip_acceleration=slid, moment=moment)
    return solution._replace(margin=margin, turn=turn)


def _as_it_begins(
    friction: DirectedFriction,
    solve: Solver,
    rhs: list[Array],
    push: _Push,
    pair: tuple[Float[Array, "3"], Float[Array, "3"]],
    slip: Float[Array, "2"],
) -> tuple[_Push, Float[Array, ""]]:
    """The push of a slip that may only begin, and the slip's turn for one newton.

    ``slip`` is along the pair. With accelerations ``b + N (q - mu A s)`` along the
    surface and the normal force by ``N (1 - mu r . s) = v``, all times that and v:
    ``B - M s`` (docs/theory.md, (8.5)).
    """
    mu, force = friction.coefficient, push.force
    bare, answer = solve(rhs), solve([*force[:-2], None, None])
    one, others = jnp.ones_like(mu), [None] * (len(rhs) - 2)
    columns = [solve([*others, *last]) for last in ((one, None), (None, one))]
    end: Callable[[list[Array]], Array] = lambda x: jnp.stack(x[-2:])
    value = push.value - _dot(push.row, bare)
    sense = 1.0 if push.one_sided else sign(value)
    b, A = end(bare), jnp.stack([end(x) for x in columns], axis=1)
    r = sense * jnp.stack([_dot(push.row, x) for x in columns])
    own = push.own + sense * _dot(push.row, answer)
    w = sense * value
    M = mu * (w * A + b[:, None] * r[None])
    turns = mu * (A[0, 0] + A[1, 1])
    if friction.follows:
        return push, turns
    balance = Balance(M, own * b + w * end(answer))
    known = jnp.stack([dot(friction.direction, e) for e in pair])
    # zero in a lane that follows its slip: it need not find a way, and 0 times NaN is
    # NaN in reverse mode
    found = lambda: jnp.where(friction.begins, first_way(balance, known), 0.0)
    begun = lambda: -mu * settling_way(found(), slip, friction.onset)
    follows = lambda: jnp.stack([x for x in force[-2:] if x is not None])
    along = cast(Array, jax.lax.cond(friction.begins, begun, follows))
    picked = [*force[:-2], *components(along)]
    return push._replace(force=picked), turns


def _flying(scene: Scene, contact: Contact, system: System) -> Solution:
    """Three more accelerations: of the body origin, under the loads alone."""
    P = momentum_rate(scene, contact, system)
    solve = with_point(P, system, coupled_along_axes(P))
    x = solve([*system.rhs, *components(-P.known)])
    return _parted(x[:-3])._replace(slip_acceleration=jnp.stack(x[-3:]))


class Response(NamedTuple):
    """What one newton second at the contact point changes, vectors on BODY axes.

    Attributes:
        velocity: Of the body's point at the contact [m/s], shape (3, 3), a column for
            each direction of the impulse.
        others: Of the angular velocity [rad/s] and of alpha', shape (3 + n, 3).
    """

    velocity: Float[Array, "3 3"]
    others: Float[Array, "m 3"]


def impulse_response(scene: Scene, contact: Contact, system: System) -> Response:
    """Changes of all velocities by an impulse of the base on the body."""
    P = momentum_rate(scene, contact, system)
    solve, one = with_point(P, system, coupled_along_axes(P)), jnp.ones_like(P.mass)
    count = len(system.rows) + 3
    columns = [
        jnp.stack(solve([one if i == k else None for i in range(count)]))
        for k in range(count - 3, count)
    ]
    whole = jnp.stack(columns, axis=1)
    return Response(whole[-3:], whole[:-3])


def _parted(x: list[Array]) -> Solution:
    turn, own = jnp.stack(x[:3]), x[3:]
    return Solution(turn, jnp.stack(own) if own else jnp.zeros(0, turn.dtype))


def _resistance(scene: Scene, contact: Contact) -> Float[Array, "3"] | None:
    """Moment of all dry resistance for one newton of normal force [m], body axes."""
    moments = [load.moment_by_normal_force(contact) for load in scene.loads]
    moments = [moment for moment in moments if moment is not None]
    return sum(moments[1:], moments[0]) if moments else None


def _solve(
    solve: Solver, rhs: list[Array], pushes: list[_Push]
) -> tuple[list[Array], list[Array], Float[Array, ""] | None]:
    """Accelerations, sizes of the pushes, and the Painleve margin.

    The contact is bilateral: where it pulls, friction still acts against the motion,
    with the size of the normal force.
    """
    bare = solve(rhs)
    answers = [solve(push.force) for push in pushes]

    def sized(sense: float) -> tuple[list[Array], Array, Array]:
        """Sizes, what the normal force is a quotient of, and its divisor."""
        signs = [sense if push.signed else 1.0 for push in pushes]
        matrix = [
            [
                s * _dot(push.row, answer) + (push.own if i == k else 0.0)
                for k, (s, answer) in enumerate(zip(signs, answers, strict=True))
            ]
            for i, push in enumerate(pushes)
        ]
        left = [push.value - _dot(push.row, bare) for push in pushes]
        if len(pushes) == 1:
            return [left[0] / matrix[0][0]], left[0], matrix[0][0]
        # the first is the spin torque: eliminated
        (a, b), (c, d) = matrix
        top, margin = left[1] - c * left[0] / a, d - c * b / a
        N = top / margin
        return [(left[0] - b * N) / a, N], top, margin

    sizes, top, margin = sized(1.0)
    with_size = [push.signed and not push.one_sided for push in pushes]
    if not any(push.signed for push in pushes):
        margin = None
    else:
        other = sizes
        pulls = jnp.asarray(False)
        if any(with_size):
            other, _, other_margin = sized(-1.0)
            pulls = top < 0.0
            margin = jnp.where(pulls, other_margin, margin)
        sizes = [
            jnp.where(margin > 0.0, jnp.where(pulls, b, a), jnp.nan)
            for a, b in zip(sizes, other, strict=True)
        ]
    effective = [
        jnp.abs(z) if by_size else z
        for z, by_size in zip(sizes, with_size, strict=True)
    ]
    x = list(bare)
    for z, answer in zip(effective, answers, strict=True):
        x = [a + z * b for a, b in zip(x, answer, strict=True)]
    return x, effective, margin


def _dot(a: Sequence[Entry], b: list[Array]) -> Array:
    products = [x * y for x, y in zip(a, b, strict=True) if x is not None]
    return sum(products[1:], products[0])
