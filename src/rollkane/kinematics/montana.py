"""Contact kinematics of two surfaces that roll on each other (Montana's maps).

For planning and manipulation: no masses, no forces. A moves over B, on whose axes its
pose is; A's own axes hold what turns with it. Built on :mod:`.contact`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..geometry.surfaces import AbstractSurface
from ..validation.checks import flag, is_traced, real, spoilt
from .contact_place import number, placed
from .rolling_pair import Drive, Place, RollingKinematics, Turned, driven, rolled
from .surface_fit import fit_of, refuse_fit


def rolling_kinematics(
    surface_a: AbstractSurface,
    surface_b: AbstractSurface,
    contact_on_b: Any,
    angular_velocity: Any,
    *,
    orientation: Any = None,
    contact_on_a: Any = None,
    angle: ArrayLike | None = None,
    slip: Any = None,
    angular_acceleration: Any = None,
    slip_rate: Any = None,
    without_spin: bool = False,
) -> RollingKinematics:
    """Rates of both contact points and of the pose of a surface that rolls on another.

    Where A is, is said by its orientation, or by its contact coordinates and the
    angle, or by both coordinates and an orientation, which the smallest turn then
    makes agree. Can be jitted, mapped and differentiated.

    Args:
        surface_a: What rolls, on its own axes.
        surface_b: What it rolls on, at rest on its own axes.
        contact_on_b: Contact coordinates on B, shape (m,).
        angular_velocity: Of A against B, A's axes [rad/s], shape (3,).
        orientation: Quaternion, scalar first, A's axes to B's, any length [1].
        contact_on_a: Contact coordinates on A; may be left out where the normal
            determines the point of A.
        angle: The contact angle ``theta`` [rad] in the charts of both; in place of
            the orientation.
        slip: Velocity of A's material point over B [m/s], B's axes, shape (3,); None:
            it rolls.
        angular_acceleration: Rate of ``angular_velocity`` [rad/s^2], A's axes; asks for
            what is of second order.
        slip_rate: Rate of ``slip`` as seen from B [m/s^2]; None: none.
        without_spin: Whether turning about the normal is left out.

    Raises:
        FieldError: of known numbers: coordinates of other shapes or off their
            surface, normals that are not opposite, surfaces that fit each other, so
            that the rates are not determined. Traced ones become NaN.

    Source: docs/theory.md, (11.1), (11.2).
    """
    where = "rolling_kinematics"
    flag(f"{where}.without_spin", without_spin)
    at = placed(
        where, surface_a, surface_b, contact_on_b, (orientation, angle), contact_on_a
    )
    w = _vector(f"{where}.angular_velocity", angular_velocity, "rad/s")
    U = _vector(f"{where}.slip", slip, "m/s")
    second = None
    if angular_acceleration is not None or slip_rate is not None:
        w_dot = _vector(
            f"{where}.angular_acceleration", angular_acceleration, "rad/s^2"
        )
        second = w_dot, _vector(f"{where}.slip_rate", slip_rate, "m/s^2")
    drive = Turned(surface_a, surface_b, without_spin)
    return _checked(where, drive, at, (w, U), second)


def rolling_along(
    surface_a: AbstractSurface,
    surface_b: AbstractSurface,
    contact_on_b: Any,
    contact_rate: Any,
    *,
    on: str = "b",
    orientation: Any = None,
    contact_on_a: Any = None,
    angle: ArrayLike | None = None,
    spin: ArrayLike = 0.0,
    contact_acceleration: Any = None,
    spin_rate: ArrayLike = 0.0,
) -> RollingKinematics:
    """The rolling that moves the contact at a given rate: Montana's maps inverted.

    Args:
        surface_a: What rolls, on its own axes.
        surface_b: What it rolls on.
        contact_on_b: Contact coordinates on B, shape (m,).
        contact_rate: Rate of the contact coordinates on one surface [1/s].
        on: Which: ``"a"`` or ``"b"``.
        orientation: Quaternion, scalar first, A's axes to B's, any length [1].
        contact_on_a: Contact coordinates on A; may be left out where the normal
            determines the point of A.
        angle: The contact angle ``theta`` [rad]; in place of the orientation.
        spin: Angular velocity of A against B about the normal out of A [rad/s].
        contact_acceleration: Rate of ``contact_rate`` [1/s^2]; asks for what is of
            second order.
        spin_rate: Rate of ``spin`` [rad/s^2].

    Raises:
        FieldError: what :func:`rolling_kinematics` raises; a sharp edge as the other
            surface, along which the contact's velocity does not say how it turns.

    Source: docs/theory.md, (11.3).
    """
    where = "rolling_along"
    drive = driven(where, surface_a, surface_b, on)
    at = placed(
        where, surface_a, surface_b, contact_on_b, (orientation, angle), contact_on_a
    )
    count = (surface_b if on == "b" else surface_a).coordinate_count

    def rates(name: str, value: Any) -> Array:
        return real(f"{where}.{name}", value, (count,), "one rate for each coordinate")

    first = rates("contact_rate", contact_rate), number(f"{where}.spin", spin)
    second = None
    if contact_acceleration is not None:
        more = rates("contact_acceleration", contact_acceleration)
        second = more, number(f"{where}.spin_rate", spin_rate)
    return _checked(where, drive, at, first, second)


@for_one_call
def _evaluated(
    drive: Drive, at: Place, given: Any, second: Any
) -> tuple[RollingKinematics, Array]:
    """First and second order, and how well the surfaces determine them [1]."""
    first = rolled(drive, at, given)
    at = first.orientation, first.contact_on_b, at[2]
    shell, ground = (
        s.geometry(u)
        for s, u in ((drive.a, first.contact_on_a), (drive.b, first.contact_on_b))
    )
    fit = fit_of(shell, ground, first.rotation)
    if second is None:
        return first, fit
    own = first.contact_on_a_rate[: at[2].shape[0]]
    rates = (first.orientation_rate, first.contact_on_b_rate, own)

    def again(at: Place, given: Any) -> tuple[Array, ...]:
        now = rolled(drive, at, given)
        found = now.velocity, now.contact_velocity, now.angular_velocity
        return *found, now.contact_on_a_rate, now.contact_on_b_rate

    a, v, w, on_a, on_b = jax.jvp(again, (at, given), (rates, second))[1]
    names = "acceleration", "contact_acceleration", "angular_acceleration"
    more = ("contact_on_a_acceleration", "contact_on_b_acceleration")
    values = dict(zip(names + more, (a, v, w, on_a, on_b), strict=True))
    fields = {name: getattr(first, name) for name in first.__dataclass_fields__}
    return RollingKinematics(**(fields | values)), fit


def _checked(
    where: str, drive: Drive, at: Place, given: Any, second: Any
) -> RollingKinematics:
    found, fit = _evaluated(drive, at, given, second)
    fit = refuse_fit(f"{where}.surface_b", fit, drive.b)
    if not is_traced(fit):
        return found
    bad = jnp.isnan(fit)

    def one(x: Any) -> Any:
        return spoilt(x, bad) if eqx.is_inexact_array(x) else x

    return jax.tree.map(one, found)


def _vector(field: str, value: Any, unit: str) -> Array:
    if value is None:
        return jnp.zeros(3)
    return real(field, value, (3,), f"three numbers [{unit}]")
