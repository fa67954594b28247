"""The rolling that follows a given curve of the contact, in time."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..geometry.surfaces import AbstractSurface
from ..integration.backends import check_method, run_by, without_native
from ..integration.integrate import checked_times, tolerances
from ..integration.plans import Problem
from ..integration.prepared import prepared
from ..kinematics.contact_place import aligned
from ..kinematics.montana import rolling_along
from ..kinematics.rolling_pair import RollingKinematics, driven, rolled
from ..validation.checks import FieldError, is_traced
from ..validation.codes import Code, reason_of
from ..validation.user_functions import GivenFunction


class _Path(eqx.Module):
    """What rolls where: the contact's curve on one surface, and the spin."""

    surface_a: AbstractSurface
    surface_b: AbstractSurface
    curve: GivenFunction
    spin: GivenFunction
    on: str = eqx.field(static=True)

    def at(self, t: Array, state: "_Rolled") -> RollingKinematics:
        """Kinematics of first order."""
        drive = driven("rolling_path", self.surface_a, self.surface_b, self.on)

        def along(t: Array) -> Array:
            return self.curve(t, None)

        place, rate = jax.jvp(along, (t,), (jnp.ones_like(t),))
        q, other = state.orientation, state.contact
        by_normal = self.surface_a.normal_map(self.surface_b.is_flat) is not None
        if self.on == "a":
            q, _ = aligned(self.surface_a, self.surface_b, q, place, other)
            place, other = other, place[:0] if by_normal else place
        return rolled(drive, (q, place, other), (rate, self.spin(t, None)))


class _Rolled(eqx.Module):
    """What is integrated: the orientation, and the contact on the other surface."""

    orientation: Float[Array, "4"]
    contact: Float[Array, " k"]


def _rates(path: _Path, t: Array, state: _Rolled) -> _Rolled:
    now = path.at(t, state)
    other = now.contact_on_a_rate if path.on == "b" else now.contact_on_b_rate
    return _Rolled(now.orientation_rate, other[: state.contact.shape[0]])


def _quickness(state: _Rolled) -> Array:
    return jnp.zeros_like(state.orientation)


def _sizes(state: _Rolled) -> _Rolled:
    def one(x: Array) -> Array:
        return jnp.ones_like(x)

    return jax.tree.map(one, state)


_PROBLEM = Problem(
    _rates,
    _quickness,
    _sizes,
    lambda path: (None, False),
)


def rolling_path(
    surface_a: AbstractSurface,
    surface_b: AbstractSurface,
    curve: Callable[[Any], Any],
    times: Any,
    *,
    on: str = "b",
    contact: Any = None,
    orientation: Any = None,
    angle: Any = None,
    spin: Callable[[Any], Any] | None = None,
    rtol: float = 1e-10,
    method: str = "auto",
) -> RollingKinematics:
    """The rolling whose contact follows a given curve on one of two surfaces.

    Args:
        surface_a: What rolls, on its own axes.
        surface_b: What it rolls on.
        curve: ``curve(t)`` -> contact coordinates on one surface, shape (k,).
        times: Output times [s], shape (T,), strictly monotonic.
        on: On which surface the curve is, ``"a"`` or ``"b"``.
        contact: Contact coordinates on the other surface at ``times[0]``; may be left
            out where the normal determines the point of A.
        orientation: Quaternion at ``times[0]``, A's axes to B's, any length [1].
        angle: Contact angle at ``times[0]`` [rad], in place of the orientation.
        spin: ``spin(t)`` -> angular velocity of A about its outward normal against B
            [rad/s]; None: it does not spin.
        rtol: Relative tolerance of a step [1].
        method: ``"native"``, ``"diffrax"`` or ``"auto"``, as in ``rollkane.simulate``.

    Returns:
        Kinematics of first order at every time, with a leading T.

    Raises:
        FieldError: what :func:`rolling_along` raises at the start; a curve that the
            contact cannot follow to the last time.

    Source: docs/theory.md, (11.3).
    """
    check_method(method)
    time = jnp.zeros(())
    driven("rolling_path", surface_a, surface_b, on)
    shape = ((surface_a if on == "a" else surface_b).coordinate_count,)
    spin = _still if spin is None else spin
    given = GivenFunction("rolling_path.curve", curve, shape, (time,), None, "t")
    about = GivenFunction("rolling_path.spin", spin, (), (time,), None, "t")
    times = checked_times(times, time.dtype)
    place = given(times[0], None)
    on_a, on_b = (place, contact) if on == "a" else (contact, place)
    zero = jnp.zeros_like(place)
    first = rolling_along(
        surface_a,
        surface_b,
        on_b,
        zero,
        on=on,
        contact_on_a=on_a,
        orientation=orientation,
        angle=angle,
    )
    path = _Path(surface_a, surface_b, given, about, on)
    by_normal = surface_a.normal_map(surface_b.is_flat) is not None
    other = first.contact_on_b
    if on == "b":
        other = first.contact_on_a[:0] if by_normal else first.contact_on_a
    start = _Rolled(first.orientation, other)
    rtol, atol = tolerances(rtol, None, times.dtype)
    options = ("solver", "stepsize_controller", "adjoint", "saveat", "dt0", "max_steps")
    unset: Any = dict.fromkeys((*options, "progress_meter"))
    ready = prepared(_PROBLEM, path, times, rtol=rtol, atol=atol, **unset)
    run = functools.partial(ready, start)
    kind = "rolling path", on
    outcome, *_ = run_by(method, without_native(None, {}), kind, (path, start), run)
    _refuse_stopped(outcome.code, curve)
    return _along(path, outcome.time, outcome.state)


def _still(t: Array) -> Array:
    return jnp.zeros_like(t)


@for_one_call
def _along(path: _Path, times: Array, states: _Rolled) -> RollingKinematics:
    return jax.vmap(path.at)(times, states)


def _refuse_stopped(code: Array, curve: Any) -> None:
    if is_traced(code) or int(code) == Code.COMPLETED:
        return
    raise FieldError(
        "rolling_path.curve",
        curve,
        f"cannot be followed to the last time: {reason_of(code)}",
        "end it before, or keep off places where the surfaces fit each other",
    )
