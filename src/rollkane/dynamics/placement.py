"""Put a body onto its base: find the contact, or say why there is none."""

from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codegen import prepare_calls
from ..codegen.compile_effort import for_few_operations, for_one_call
from ..geometry.local_geometry import LocalGeometry, from_normal
from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import cross, dot, matvec, matvec_transposed, norm
from ..geometry.surfaces import AbstractPointSurface, AbstractSurface, PointOfNormal
from ..kinematics.base_motion import AbstractBaseMotion
from ..kinematics.contact import body_to_base
from ..kinematics.coordinates import SlidingState, State, shared_parts
from ..kinematics.surface_fit import opening_of
from ..validation.checks import FieldError, is_traced, real, spoilt
from .abstract_supported import rolling_parts
from .clearance import Pose, clearance_at, may_touch_twice, pose_at
from .consistency import consistent, looseness
from .mass_matrix import assemble, field_of
from .placement_errors import (
    Placed,
    refuse_bad,
    refuse_needless,
    warn_of_pull,
)
from .rolling import contact_of
from .scene import Scene, require_scene
from .state_forms import check_rolling


def place(
    scene: Scene,
    orientation: Any,
    angular_velocity: Any,
    contact_on_base: Any,
    alpha: Any = (),
    alpha_dot: Any = (),
    *,
    supported: Any = (),
    base_normal: Any = None,
    near_on_body: Any = None,
    time: Any = 0.0,
    velocity: Any = None,
    slip: Any = None,
    allow_overlap: bool = False,
) -> State:
    """The state in which a body touches its base at a given point.

    Args:
        scene: What rolls on what.
        orientation: Unit quaternion, scalar first, body to fixed axes [1], shape (4,).
        angular_velocity: Absolute, FIXED axes [rad/s], shape (3,).
        contact_on_base: Contact point, base axes [m], shape (3,); a point of the
            base's surface.
        alpha: Coordinates of what is supported, shape (n,).
        alpha_dot: Their rates, shape (n,).
        supported: A state for each ``RollingBody`` of the scene, in their order, from
            its method ``place``; one alone need not be in a tuple.
        base_normal: Outward normal of the base at the contact [1], shape (3,); only
            where the base is a sharp edge, which has a fan of them.
        near_on_body: Body axes [m], shape (3,). Where several points of the body have
            the needed normal (a cylinder, a ring, a body that is not convex), take the
            one next to this; by default the outermost. Where the normal tells the
            point it changes nothing.
        time: When the motion starts [s]; matters only where the base moves.
        velocity: Of the body origin, FIXED axes [m/s], shape (3,), in a scene whose
            contact slips; by default that of rolling. It must keep the body on the
            base.
        slip: Instead of ``velocity``: of the body's point at the contact over the base,
            FIXED axes [m/s], shape (3,); its part along the normal is left out.
        allow_overlap: Whether the body may be in the base elsewhere. Else that is
            looked for where it is possible (not of two convex surfaces), on samples of
            both surfaces and then closer: a tenth to a few milliseconds a placement,
            and up to a second to compile; see :mod:`rollkane.dynamics.clearance`.

    Returns:
        The state, in pole-free coordinates; a ``SlidingState`` where the contact slips.
        Under ``RubberRolling`` a spin about the normal, relative to the base, is left
        out.

    Raises:
        FieldError: a quaternion that is not of unit length, a contact point off the
            base, a body that cannot touch the base so, surfaces that fit each other, a
            body that is in the base elsewhere, a velocity that leaves the base or that
            rolling determines. Of numbers that are traced (``jit``, ``vmap``,
            derivatives) the state becomes NaN instead, and a run from it ends with
            ``Code.BAD_START``.

    Warns:
        UserWarning: the contact would have to pull from the start on, because the loads
            pull the body off its base: the outward side of a surface may be the wrong
            one.

    Source: docs/theory.md, (1.4), ``n_body = -R^T n_base``.
    """
    remedy = "call place(scene, orientation, angular_velocity, contact_on_base)"
    require_scene("place.scene", scene, remedy)
    prepare_calls()  # a run follows
    dtype = scene.body.mass.dtype
    meanings = {
        "orientation": (orientation, 4, "a unit quaternion"),
        "angular_velocity": (angular_velocity, 3, "rad/s, fixed axes"),
        "contact_on_base": (contact_on_base, 3, "metres, base axes"),
        "alpha": (alpha, scene.coordinate_count, "one for each coordinate"),
        "alpha_dot": (alpha_dot, scene.coordinate_count, "one for each coordinate"),
        "time": ([time], 1, "seconds"),
        "base_normal": (base_normal, 3, "a direction, base axes"),
        "near_on_body": (near_on_body, 3, "metres, body axes"),
        "velocity": (velocity, 3, "m/s, fixed axes"),
        "slip": (slip, 3, "m/s, fixed axes"),
    }
    optional = "base_normal", "near_on_body", "velocity", "slip"
    refuse_needless(scene, {name: meanings[name][0] for name in optional})
    asked: dict[str, Any] = {
        name: None
        if value is None and name in optional
        else real(
            f"place.{name}", value, (count,), f"{count} numbers: {meaning}", dtype
        )
        for name, (value, count, meaning) in meanings.items()
    }
    asked["supported"] = _inner_states(scene, supported)
    looks = may_touch_twice(scene) and not allow_overlap
    placed = (_placed_looking if looks else _placed)(scene, asked)
    if not is_traced(placed):
        given = {name: value for name, (value, _, _) in meanings.items()}
        refuse_bad(placed, asked, given)
        warn_of_pull(scene, placed, asked)
    return placed.state


@for_one_call
def _placed(scene: Scene, asked: dict[str, Any]) -> Placed:
    return _examined(scene, asked, looks=False)


@for_one_call
def _placed_looking(scene: Scene, asked: dict[str, Any]) -> Placed:
    return _examined(scene, asked, looks=True)


def _examined(scene: Scene, asked: dict[str, Any], looks: bool) -> Placed:
    """A state from checked shapes, with everything that is wrong with it."""
    time, q = asked["time"][0], asked["orientation"]
    loose = looseness(q.dtype)
    motion = scene.base.motion
    moving = None if motion is None else (motion, time)
    where = {name: asked[name] for name in _WHERE}
    fit = cast(_Fit, _fit(scene.body.surface, scene.base.surface, moving, where))
    state = State(
        orientation=fit.orientation,
        angular_velocity=matvec_transposed(fit.rotation, asked["angular_velocity"]),
        contact_on_base=fit.on_base,
        contact_on_body=fit.on_body,
        alpha=asked["alpha"],
        alpha_dot=asked["alpha_dot"],
        supported=asked["supported"],
    )
    wrong = {
        "long": ~(jnp.abs(dot(q, q) - 1.0) < 2 * loose),
        "misses": fit.misses,
        "singular": fit.singular,
        "off_base": fit.off_base,
        "fits": fit.fits,
        "cuts": fit.cuts,
    }
    overlap = where = None
    if looks:
        surfaces = scene.body.surface, scene.base.surface
        found = clearance_at(*surfaces, fit.pose)
        overlap, where = -found.gap, found.place
        wrong["overlaps"] = overlap > loose * (found.size + norm(where))
    if scene.supported:
        wrong["massless"] = _massless(scene, time, state)
    if scene.contact.slips:
        state, leaves = _sliding(scene, time, state, asked, loose)
        wrong["leaves"] = leaves
    state = consistent(scene, time, state)
    bad = jnp.any(jnp.stack(list(wrong.values())))
    spoil: Callable[[Array], Array] = lambda x: spoilt(x, bad)
    state = jax.tree.map(spoil, state)
    return Placed(state, wrong, fit.nearest, overlap, where, _off(scene, fit))


def _off(scene: Scene, fit: "_Fit") -> Array:
    """By how much the fields of the loads pull the body off its base [m/s^2]."""
    field = field_of(scene.loads)
    return jnp.zeros(()) if field is None else dot(field, fit.out)


def _sliding(
    scene: Scene, time: Array, state: State, asked: dict[str, Any], loose: float
) -> tuple[SlidingState, Bool[Array, ""]]:
    """The state with a slip, and whether its velocity leaves the base."""
    zero = jnp.zeros_like(state.angular_velocity)
    start = SlidingState(**shared_parts(state), slip=zero)
    if asked["slip"] is not None:
        start = eqx.tree_at(lambda s: s.slip, start, asked["slip"])
    velocity = asked["velocity"]
    if velocity is None:
        return start, jnp.asarray(False)
    contact = contact_of(scene, time, state)
    turned = matvec(
        contact.rotation, cross(contact.angular_velocity, contact.body_point)
    )
    slip = velocity + turned
    j = contact.base_velocity
    if j is not None:
        slip = slip - matvec(contact.rotation, j)
    leaving = dot(slip, matvec(contact.rotation, contact.normal))
    size = jnp.sqrt(dot(velocity, velocity) + dot(turned, turned))
    start = eqx.tree_at(lambda s: s.slip, start, slip)
    return start, ~(jnp.abs(leaving) <= loose * size)


def _massless(scene: Scene, time: Array, state: State) -> Array:
    """Whether the mass matrix, scaled to a diagonal of ones, is not positive."""
    state = jax.lax.stop_gradient(state)
    rows = assemble(scene, time, state, contact_of(scene, time, state)).rows
    count = len(rows)
    matrix = jnp.stack(
        [
            jnp.stack([rows[max(i, j)][min(i, j)] for j in range(count)])
            for i in range(count)
        ]
    )
    matrix = jax.lax.stop_gradient(matrix)
    scale = jnp.sqrt(cast(Array, jnp.diagonal(matrix)))
    matrix = matrix / (scale[:, None] * scale[None, :])
    # the least eigenvalue is above what is taken off all of them where what is left is
    # positive: so say its pivots, to a rounding of each row
    index, whole = jnp.arange(count), jnp.eye(count, dtype=matrix.dtype)
    left = matrix - 100 * np.finfo(matrix.dtype).eps * whole

    def eliminate(left: Array, j: Array) -> tuple[Array, Array]:
        pivot = left[j, j]
        share = jnp.where(index > j, left[:, j] / pivot, 0.0)
        return left - share[:, None] * left[j][None], pivot

    return ~jnp.all(jax.lax.scan(eliminate, left, index)[1] > 0.0)


class _Fit(eqx.Module):
    """Where two surfaces touch, and whether they can."""

    orientation: Array
    rotation: Array  # body to fixed axes
    on_base: Array  # contact coordinates
    on_body: Array
    pose: Pose  # of the body
    nearest: Array  # point of the base next to the asked one [m], base axes
    out: Array  # normal out of the base [1], fixed axes
    off_base: Array  # truth values: what is wrong
    misses: Array
    singular: Array
    fits: Array
    cuts: Array


def _inner_states(scene: Scene, given: Any) -> tuple[State, ...]:
    """States of the bodies that roll on the body; refused if they are not theirs."""
    field, bodies = "place.supported", rolling_parts(scene.supported)
    remedy = "place each by its RollingBody's method: scene.supported[0].place(...)"
    if not bodies:
        remedy = "leave it out: no RollingBody is in the scene"
    try:
        states = (given,) if isinstance(given, State) else tuple(given)
    except TypeError as error:
        raise FieldError(field, given, "must be a State, or several", remedy) from error
    check_rolling(bodies, states, field, remedy)
    for k, state in enumerate(states):
        numbers = jax.tree.leaves(state)
        if not is_traced(numbers) and not all(np.isfinite(x).all() for x in numbers):
            raise FieldError(f"{field}[{k}]", state, "must be finite", remedy)
    return states


_WHERE = "orientation", "contact_on_base", "base_normal", "near_on_body"


@for_few_operations  # known then, too, where only masses or speeds are traced
def _fit(
    body: AbstractSurface,
    base: AbstractSurface,
    moving: tuple[AbstractBaseMotion, Float[Array, ""]] | None,
    asked: dict[str, Any],
) -> _Fit:
    orientation, point = asked["orientation"], asked["contact_on_base"]
    normal, loose = asked["base_normal"], looseness(point.dtype)
    on_base = base.locate(point) if normal is None else base.at_edge(point, normal)
    ground = base.geometry(on_base)
    orientation = orientation / norm(orientation)
    rotation = rotation_matrix(orientation)
    base_at = None if moving is None else moving[0].at(moving[1])
    to_base = body_to_base(rotation, base_at)
    normal = -matvec_transposed(to_base, ground.normal)
    point_of_normal = body.normal_map(base.is_flat)
    if isinstance(body, AbstractPointSurface) and point_of_normal is None:
        on_body = body.find_normal(normal, asked["near_on_body"])
        shell = body.geometry(on_body)
    else:
        on_body = jnp.zeros(0, normal.dtype)
        shell = from_normal(cast(PointOfNormal, point_of_normal), normal)
    still = jax.lax.stop_gradient((shell, ground, _mixing(shell, ground, to_base)))
    opening, curving = opening_of(*still)
    of_body = jnp.ones(2, normal.dtype)
    if on_body.shape[0]:
        of_body = body.units(on_body)
    regular = jnp.minimum(
        still[0].regularity_by(jax.lax.stop_gradient(of_body)),
        still[1].regularity_by(jax.lax.stop_gradient(base.units(on_base))),
    )
    gap, reach, size, misfit = jax.lax.stop_gradient(
        (
            norm(point - ground.position),
            norm(point),
            norm(shell.position),
            norm(shell.normal - normal),
        )
    )
    rounding = np.finfo(point.dtype).eps
    placed = jnp.all(jnp.isfinite(shell.position))
    return _Fit(
        orientation=orientation,
        rotation=rotation,
        on_base=on_base,
        on_body=on_body,
        pose=pose_at(to_base, ground.position, shell.position),
        nearest=ground.position,
        out=-matvec(rotation, normal),
        # what it is moved by is little of the body, or a rounding of the place
        off_base=~(gap <= loose * (reach + 10.0 * size)),
        misses=~(placed & (misfit <= loose)) & jnp.all(jnp.isfinite(ground.frame)),
        singular=~(regular > 1e-3 * loose),
        fits=~(jnp.abs(curving) > 100 * rounding),  # a determinant of unit columns
        cuts=~(opening > -1e4 * rounding),  # an edge opens by zero, up to rounding
    )


def _mixing(
    shell: LocalGeometry, ground: LocalGeometry, to_base: Float[Array, "3 3"]
) -> Float[Array, "2 2"]:
    """Components of the base's tangents on those of the body."""
    tangents = [matvec_transposed(to_base, ground.frame[:, a]) for a in range(2)]
    return jnp.stack(
        [jnp.stack([dot(shell.frame[:, m], t) for t in tangents]) for m in range(2)]
    )
