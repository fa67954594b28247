"""From pole-free to Voronets coordinates and back."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..dynamics.abstract_supported import refuse_rolling_parts
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene
from ..geometry.rotations import quaternion_of
from ..geometry.small_linear import dot, matvec_transposed, norm
from ..kinematics.coordinates import State
from ..kinematics.voronets import CHART_EDGE, AnyState, ChartContact, VoronetsState
from ..validation.checks import FieldError, refuse


def to_voronets(
    scene: Scene, state: AnyState, time: Any = 0.0, sign: int = -1
) -> VoronetsState:
    """The same state in Voronets coordinates.

    Args:
        scene: What rolls on what.
        state: State in either coordinates.
        time: When [s]; matters only where the base turns.
        sign: ``s`` of the result: -1 (both e3 out of the material) or +1 (e3 = +e3c:
            that of the base into it). The motion is the same.

    Returns:
        The state; angles in (-pi, pi].

    Raises:
        FieldError: a sign other than -1 and +1, a contact point that the chart of its
            surface does not reach, or at whose edge it lies.
    """
    refuse_rolling_parts("to_voronets.scene", scene.supported)
    if sign not in (-1, 1):
        raise FieldError("to_voronets.sign", sign, "must be -1 or +1", "give -1")
    time = jnp.asarray(time, state.angular_velocity.dtype)
    if isinstance(state, VoronetsState):
        if state.sign == sign:
            return state
        state = to_pole_free(scene, state, time)
    converted = in_charts(scene, time, state, sign)
    contact = contact_of(scene, time, state)
    seen = contact_of(scene, time, converted)
    assert isinstance(seen, ChartContact)
    reach = norm(seen.base_point - contact.base_point)
    reach = reach + norm(seen.body_point - contact.body_point)
    size = norm(contact.base_point) + norm(contact.body_point)
    loose = 1e-6 if time.dtype == jnp.float64 else 1e-3
    where = "to_voronets.state"
    on_body = refuse(
        converted.contact_on_body,
        ~(reach <= loose * (loose + size)),
        where,
        "touches at a point that the chart of its surface does not reach",
        "use pole-free coordinates, or give the surface another chart (Parametric)",
    )
    on_body = refuse(
        on_body,
        ~(seen.regularity > CHART_EDGE),
        where,
        "touches at the edge of a chart, such as the pole of longitude and latitude",
        "use pole-free coordinates, or turn the surface's axes",
    )
    return VoronetsState(
        contact_on_body=on_body,
        contact_on_base=converted.contact_on_base,
        angle=converted.angle,
        angular_velocity=converted.angular_velocity,
        alpha=converted.alpha,
        alpha_dot=converted.alpha_dot,
        sign=sign,
    )


def in_charts(
    scene: Scene, t: Float[Array, ""], state: State, sign: int = -1
) -> VoronetsState:
    """:func:`to_voronets` without its checks."""
    body, base = scene.body.surface, scene.base.surface
    contact = contact_of(scene, t, state)
    if scene.has_contact_coordinates:
        q = body.chart_coordinates(state.contact_on_body)
    else:
        q = body.chart_of_normal(contact.normal)
    q_c = base.chart_coordinates(state.contact_on_base)
    shell, ground = body.chart_geometry(q), base.chart_geometry(q_c)
    if sign > 0:
        ground = ground.turned_over()
    # the second row of S_th = Ec^T R_CB E is (cos, sin, 0)
    on_body = matvec_transposed(contact.to_base, ground.frame[:, 1])
    cos, sin = dot(on_body, shell.frame[:, 0]), dot(on_body, shell.frame[:, 1])
    return VoronetsState(
        contact_on_body=q,
        contact_on_base=q_c,
        angle=jnp.arctan2(sin, cos),
        angular_velocity=matvec_transposed(shell.frame, state.angular_velocity),
        alpha=state.alpha,
        alpha_dot=state.alpha_dot,
        sign=sign,
    )


def to_pole_free(scene: Scene, state: AnyState, time: Any = 0.0) -> State:
    """The same state in pole-free coordinates.

    Args:
        scene: What rolls on what.
        state: State in either coordinates.
        time: When [s]; matters only where the base turns.

    Returns:
        The state; its quaternion has unit length and either sign.
    """
    if isinstance(state, State):
        return state
    body, base = scene.body.surface, scene.base.surface
    time = jnp.asarray(time, state.angular_velocity.dtype)
    contact = contact_of(scene, time, state)
    on_body = jnp.zeros(0, contact.body_point.dtype)
    if scene.has_contact_coordinates:
        on_body = body.chart_inverse(state.contact_on_body)
    return State(
        orientation=quaternion_of(contact.rotation),
        angular_velocity=contact.angular_velocity,
        contact_on_base=base.chart_inverse(state.contact_on_base),
        contact_on_body=on_body,
        alpha=state.alpha,
        alpha_dot=state.alpha_dot,
    )
