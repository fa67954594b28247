"""Put a body onto its base: find the contact, or say why there is none."""

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .checks import FieldError, is_traced, real, refuse
from .contact import body_to_base
from .coordinates import SlidingState, State, shared_parts
from .geometry import LocalGeometry, from_normal
from .mass_matrix import assemble
from .one_call import for_one_call
from .rolling import contact_of
from .rotations import rotation_matrix
from .scene import Scene, Slipping
from .small_linear import cross, dot, matvec, matvec_transposed, norm
from .surfaces import AbstractPointSurface, PointOfNormal


def place(
    scene: Scene,
    orientation: Any,
    angular_velocity: Any,
    contact_on_base: Any,
    alpha: Any = (),
    alpha_dot: Any = (),
    *,
    base_normal: Any = None,
    near_on_body: Any = None,
    time: Any = 0.0,
    velocity: Any = None,
    slip: Any = None,
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
        base_normal: Outward normal of the base at the contact [1], shape (3,). Needed
            only where the base is a sharp edge, which has a fan of them.
        near_on_body: Body axes [m], shape (3,). Where several points of the body have
            the needed normal (a cylinder, a body that is not convex), take the one
            next to this; by default the outermost.
        time: When the motion starts [s]; matters only where the base moves.
        velocity: Of the body origin, FIXED axes [m/s], shape (3,), in a scene whose
            contact slips; by default that of rolling. It must keep the body on the
            base.
        slip: Instead of ``velocity``: of the body's point at the contact over the base,
            FIXED axes [m/s], shape (3,); its part along the normal is left out.

    Returns:
        The state, in pole-free coordinates; a ``SlidingState`` where the contact slips.

    Raises:
        FieldError: a quaternion that is not of unit length, a contact point off the
            base, a body that cannot touch the base so, surfaces that fit each other, a
            velocity that leaves the base or that rolling determines.
            Under ``vmap`` the lane becomes NaN instead and ``simulate`` marks it.

    Source: theory, section 7, ``n_body = -R^T n_base``.
    """
    dtype = scene.body.mass.dtype
    loose = _looseness(dtype)
    orientation = refuse(
        _number(dtype, "orientation", orientation, 4, "a unit quaternion"),
        lambda q: ~(abs((q * q).sum() - 1.0) < 2 * loose),
        "place.orientation",
        "must be a quaternion of unit length",
        "divide it by its length; scalar first, body to fixed axes",
    )
    spin = _number(dtype, "angular_velocity", angular_velocity, 3, "rad/s, fixed axes")
    point = _number(dtype, "contact_on_base", contact_on_base, 3, "metres, base axes")
    hints = [
        None if value is None else _number(dtype, name, value, 3, meaning)
        for name, value, meaning in (
            ("base_normal", base_normal, "a direction, base axes"),
            ("near_on_body", near_on_body, "metres, body axes"),
        )
    ]
    numbers = [
        _number(dtype, name, value, scene.coordinate_count, "one for each coordinate")
        for name, value in (("alpha", alpha), ("alpha_dot", alpha_dot))
    ]
    time = _number(dtype, "time", [time], 1, "seconds")[0]
    fit = _fit(scene, orientation, spin, point, hints, loose, time)
    orientation = refuse(
        fit.orientation,
        fit.misses,
        "place.orientation",
        "the body cannot touch the base so: no single point of its surface has the "
        "normal that the contact needs",
        "turn the body, or (for a surface by your own function) widen its domain",
    )
    state = State(
        orientation=orientation,
        angular_velocity=fit.angular_velocity,
        contact_on_base=_checked_contact(fit, point),
        contact_on_body=fit.on_body,
        alpha=numbers[0],
        alpha_dot=numbers[1],
    )
    if scene.coordinate_count:
        state = _with_mass(scene, time, state)
    if isinstance(scene.contact, Slipping):
        return _sliding(scene, time, state, velocity, slip)
    for name, given in (("velocity", velocity), ("slip", slip)):
        if given is not None:
            raise FieldError(
                f"place.{name}",
                given,
                "follows from the angular velocity where the body rolls",
                "leave it out, or give Scene(contact=Slipping(...))",
            )
    return state


def _sliding(scene: Scene, time: Array, state: State, velocity, slip) -> SlidingState:
    """The state with a slip, or with that of a velocity of the body's origin."""
    start = SlidingState(
        **shared_parts(state), slip=jnp.zeros_like(state.angular_velocity)
    )
    if velocity is not None and slip is not None:
        raise FieldError(
            "place.slip", slip, "follows from velocity", "give one of both"
        )
    dtype, unit = start.slip.dtype, "m/s, fixed axes"
    if slip is not None:
        given = _number(dtype, "slip", slip, 3, unit)
        slip = _along_surface(scene, time, start, given)
        start = eqx.tree_at(lambda s: s.slip, start, slip)
    if velocity is not None:
        given = _number(dtype, "velocity", velocity, 3, unit)
        found, leaving, size = _slip_of(scene, time, state, given)
        found = refuse(
            found,
            ~(abs(leaving) <= _looseness(dtype) * size),
            "place.velocity",
            "would take the body off the base, or into it",
            "leave out its part along the normal",
        )
        start = eqx.tree_at(lambda s: s.slip, start, found)
    return start


@for_one_call
def _along_surface(scene: Scene, time: Array, state: State, slip: Array) -> Array:
    contact = contact_of(scene, time, state)
    out = matvec(contact.rotation, contact.normal)
    return slip - out * dot(slip, out)


@for_one_call
def _slip_of(scene: Scene, time: Array, state: State, velocity: Array):
    """Slip on fixed axes, how fast it leaves the base, and the size of the speeds."""
    contact = contact_of(scene, time, state)
    turned = matvec(
        contact.rotation, cross(contact.angular_velocity, contact.body_point)
    )
    slip = velocity + turned
    j = contact.base_velocity
    if j is not None:
        slip = slip - matvec(contact.rotation, j)
    out = matvec(contact.rotation, contact.normal)
    size = jnp.sqrt(dot(velocity, velocity) + dot(turned, turned))
    return slip, dot(slip, out), size


def _with_mass(scene: Scene, time: Array, state: State) -> State:
    """The state, unless a coordinate of it moves no mass."""
    alpha = refuse(
        state.alpha,
        _massless(scene, time, state),
        "Scene.supported",
        "makes the mass matrix singular at this alpha: some motion of the coordinates "
        "moves no mass",
        "let every coordinate move a mass by itself, and start where it does",
    )
    return eqx.tree_at(lambda s: s.alpha, state, alpha)


@for_one_call
def _massless(scene: Scene, time: Array, state: State) -> Array:
    """Whether the mass matrix, scaled to a diagonal of ones, is not positive."""
    rows = assemble(scene, time, state, contact_of(scene, time, state)).rows
    count = len(rows)
    matrix = jnp.stack(
        [
            jnp.stack([rows[max(i, j)][min(i, j)] for j in range(count)])
            for i in range(count)
        ]
    )
    scale = jnp.sqrt(jnp.diagonal(matrix))
    matrix = matrix / (scale[:, None] * scale[None, :])
    # a Cholesky factor loses half the digits of the least eigenvalue
    return ~(jnp.linalg.eigvalsh(matrix)[0] > 100 * jnp.finfo(matrix.dtype).eps)


class _Fit(eqx.Module):
    """Where two surfaces touch, and whether they can."""

    orientation: Array
    angular_velocity: Array
    on_base: Array  # contact coordinates
    on_body: Array
    nearest: Array  # point of the base next to the asked one [m], base axes
    off_base: Array  # truth values: what is wrong
    misses: Array
    singular: Array
    fits: Array
    cuts: Array


def _checked_contact(fit: _Fit, point: Array) -> Array:
    """Contact coordinates on the base, unless the two surfaces cannot touch there."""
    field = "place.contact_on_base"
    on_base = refuse(
        fit.on_base,
        fit.singular,
        field,
        "a surface or its chart is singular where they touch (a tip without a tangent "
        "plane, or the pole of a chart, where two coordinates count for one)",
        "touch elsewhere, or describe the surface without poles, for example with "
        "of_direction=True",
    )
    on_base = refuse(
        on_base,
        fit.off_base,
        field,
        f"{_list(point)} is off the base's surface, whose nearest point is "
        f"{_list(fit.nearest)}",
        "give a point of the surface [m], in base axes",
    )
    on_base = refuse(
        on_base,
        fit.fits,
        field,
        "the surfaces fit each other here (relative curvature 0): they touch along a "
        "line or an area, and the contact point is not determined",
        "turn the body, move the contact, or change a radius",
    )
    return refuse(
        on_base,
        fit.cuts,
        field,
        "the body would cut into the base here, which bends towards the body more "
        "sharply than the body itself",
        "use a smaller body or a flatter base, or turn the inside of one round",
    )


def _looseness(dtype) -> float:
    """How far a user's rounded numbers may be off, relative [1]: half the digits."""
    return 1e-6 if dtype == jnp.float64 else 1e-3


def _number(dtype, name: str, value: Any, count: int, meaning: str) -> Array:
    array = real(f"place.{name}", value, (count,), f"{count} numbers: {meaning}")
    return array if array.dtype == dtype else array.astype(dtype)


def _list(value: Array) -> str:
    return "the point" if is_traced(value) else str(np.asarray(value).tolist())


@for_one_call
def _fit(scene: Scene, orientation, spin, point, hints, loose: float, time) -> _Fit:
    base, body = scene.base.surface, scene.body.surface
    edge_normal, near = hints
    if edge_normal is None:
        on_base = base.locate(point)
    else:
        on_base = edge_normal / norm(edge_normal)
    ground = base.geometry(on_base)
    orientation = orientation / norm(orientation)
    rotation = rotation_matrix(orientation)
    motion = scene.base.motion
    to_base = body_to_base(rotation, None if motion is None else motion.at(time))
    normal = -matvec_transposed(to_base, ground.normal)
    point_of_normal = body.normal_map(base.is_flat)
    if isinstance(body, AbstractPointSurface) and point_of_normal is None:
        on_body = body.find_normal(normal, near)
        shell = body.geometry(on_body)
    else:
        on_body = jnp.zeros(0, normal.dtype)
        shell = from_normal(cast(PointOfNormal, point_of_normal), normal)
    tangents = [matvec_transposed(to_base, ground.frame[:, a]) for a in range(2)]
    mixing = jnp.stack(
        [jnp.stack([dot(shell.frame[:, m], t) for t in tangents]) for m in range(2)]
    )
    still = jax.lax.stop_gradient((shell, ground, mixing))
    opening, curving = _opening(*still)
    regular = jnp.minimum(still[0].regularity, still[1].regularity)
    gap, reach, misfit = jax.lax.stop_gradient(
        (norm(point - ground.position), norm(point), norm(shell.normal - normal))
    )
    rounding = jnp.finfo(point.dtype).eps
    placed = jnp.all(jnp.isfinite(shell.position))
    return _Fit(
        orientation=orientation,
        angular_velocity=matvec_transposed(rotation, spin),
        on_base=on_base,
        on_body=on_body,
        nearest=ground.position,
        off_base=~(gap <= loose * (1.0 + reach)),
        misses=~(placed & (misfit <= loose)) & jnp.all(jnp.isfinite(ground.frame)),
        singular=~(regular > 1e-3 * loose),
        fits=~(jnp.abs(curving) > 100 * rounding),  # a determinant of unit columns
        cuts=~(opening > -1e4 * rounding),  # an edge opens by zero, up to rounding
    )


def _opening(shell: LocalGeometry, ground: LocalGeometry, mixing) -> tuple:
    """How two touching surfaces part: least opening, and relative curvature.

    The columns of ``[[K_b, T K_c], [-L_b, T L_c]]`` (theory 8.1) are scaled to unit
    length, so that edges and planes count alike; the determinant vanishes exactly
    where the surfaces fit. The opening of a motion with equal travels
    ``L_b x_b = T L_c x_c`` is ``(L_b x_b) . (K_b x_b + T K_c x_c)``.
    """
    K_b, L_b = -shell.frame_rates, shell.lengths
    K_c, L_c = -mixing @ ground.frame_rates, mixing @ ground.lengths
    body, base = jnp.concatenate([K_b, -L_b]), jnp.concatenate([K_c, L_c])
    system = jnp.concatenate([body, base], axis=1)
    system = system / jnp.linalg.norm(system, axis=0, keepdims=True)
    free = jnp.linalg.svd(jnp.concatenate([-L_b, L_c], axis=1))[2][2:].T
    opening = (L_b @ free[:2]).T @ (K_b @ free[:2] + K_c @ free[2:])
    largest = jnp.max(jnp.abs(opening))
    least = jnp.linalg.eigvalsh(0.5 * (opening + opening.T))[0]
    return least / jnp.where(largest > 0, largest, 1.0), jnp.linalg.det(system)
