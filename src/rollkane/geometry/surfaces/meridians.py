"""Meridians of surfaces of revolution, and what is found out about a known one."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...validation.checks import FieldError, is_traced, known_in_a_trace
from ...validation.user_functions import UserFunction

DENSE = 257  # points of a meridian, where it is searched as a whole
Meridian = Callable[[Float[Array, ""]], Float[Array, "2"]]  # radius and height [m]


def meridian_of(profile: UserFunction) -> Meridian:
    """The profile as a function of a scalar with values of shape (2,)."""

    def meridian(s: Array) -> Array:
        value: Any = profile(s[None])  # the user's, which may be a sequence
        if isinstance(value, (tuple, list)):
            entries = cast(Sequence[ArrayLike], value)
            value = jnp.stack([jnp.asarray(x) for x in entries])
        return value

    return meridian


def sampled(meridian: Meridian, domain: tuple[float, float]) -> np.ndarray:
    """Points of the meridian, shape (n, 2)."""
    along = np.linspace(domain[0], domain[1], DENSE, dtype=jnp.result_type(float))
    places = known_in_a_trace(jax.vmap(meridian), along)
    if is_traced(places):
        raise FieldError(
            "Revolution.poles",
            None,
            "cannot be found while the profile's parameters are traced",
            "give poles=(first, last) and rising= yourself",
        )
    return np.asarray(places)


def found_poles(places: np.ndarray) -> tuple[bool, bool]:
    """Which ends of a meridian are poles."""
    radius = np.abs(places[:, 0])
    near = 1e-6 * np.max(radius)  # far below any real hole, above rounding
    return bool(radius[0] < near), bool(radius[-1] < near)


def found_rising(places: np.ndarray) -> bool:
    """Whether a meridian rises; one that is closed, whether it goes anticlockwise.

    The area on its left, between it and the axis or the line between its ends, is
    ``int r dz``: positive where the outward side is the right one.
    """
    radius, height = places.T
    size = max(np.ptp(radius), np.ptp(height))
    rise = height[-1] - height[0]
    if abs(rise) > 1e-6 * size:
        return bool(rise > 0)
    between = radius - min(radius[0], radius[-1])  # an offset changes nothing
    area = np.sum(0.5 * (between[1:] + between[:-1]) * np.diff(height))
    if not abs(area) > 1e-6 * size * size:
        raise FieldError(
            "Revolution.rising",
            None,
            "cannot be found: the meridian ends at the height at which it begins, and "
            "encloses nothing",
            "give rising=True or rising=False: the outward normal of a meridian that "
            "rises points away from the axis, and True turns it likewise",
        )
    return bool(area > 0)


def refuse_tips(
    meridian: Meridian, domain: tuple[float, float], poles: tuple[bool, bool]
) -> None:
    """Refuse a known meridian that does not meet the axis at a right angle."""
    for s, is_pole in zip(domain, poles, strict=True):
        if not is_pole:
            continue
        derivative = cast(Callable[..., Array], jax.jacfwd(meridian))
        slope = known_in_a_trace(derivative, s)
        if is_traced(slope):
            continue
        r_1, z_1 = np.asarray(slope, float)
        # a thousandth of a radian is no rounding
        if not abs(z_1) <= 1e-3 * abs(r_1):
            raise FieldError(
                "Revolution.profile",
                (float(r_1), float(z_1)),
                f"does not meet the axis at a right angle at s = {float(s):g}, where "
                "radius and height change at these rates",
                "round the tip off, let the radius grow in proportion to s there, use "
                "Cone, or end the domain off the axis with poles=(False, False)",
            )
