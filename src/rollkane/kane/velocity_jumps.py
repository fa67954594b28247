"""Velocities that jump at a known time: an impact, which a motion does not have.

Loads may jump, and accelerations: steps end before such a time and begin behind it.
Where a support's velocity jumps, or what a constraint asks of speeds, impulses act, and
speeds that stay as they were (the independent ones, whichever were chosen) would be
those of no motion. Velocities are compared on both sides, at the start's coordinates.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import running_once
from ..validation.checks import FieldError, is_traced
from .equations import speeds_of
from .partial_velocities import partials_of
from .parts import RigidBody
from .system import KaneState, KaneSystem

# Numbers on each side, of the clock: as far as steps stay away, and some more
_BESIDE = 16.0
# of the largest velocity: what jumps by less is an error of a table, not an impact
_JUMPS = 1e-6
_NOTHING = 1e-12


def refuse_jumps(
    system: KaneSystem, times: Float[Array, " T"], start: KaneState
) -> None:
    """Refuse kinks at which velocities jump. Nothing is said of traced numbers.

    Args:
        system: The system.
        times: Of the outputs [s].
        start: Coordinates and independent speeds.

    Raises:
        FieldError: a velocity of a part, or what constraints ask of speeds, jumps.
    """
    if system.kinks is None or is_traced(system, times, start):
        return
    first, last = np.sort(np.asarray(times, float)[[0, -1]])
    kinks = np.asarray(system.kinks, float)
    kinks = kinks[(first < kinks) & (kinks < last)]
    if not kinks.size:
        return
    eps = float(np.finfo(start.q.dtype).eps)
    aside = _BESIDE * eps * (np.abs(kinks) + last - first)
    sides = jnp.asarray(np.stack([kinks - aside, kinks + aside]), start.q.dtype)
    for state in (start, _moving(start)):
        u, velocities = _velocities(system, sides, state)
        turning = (k for k, x in enumerate(system.parts) if isinstance(x, RigidBody))
        names = [f"parts[{k}].velocity" for k in range(len(system.parts))]
        names += [f"parts[{k}].angular_velocity" for k in turning]
        for name, velocity in zip(names, velocities, strict=True):
            at, size = _jump(velocity, kinks)  # speeds that move no mass may jump
            if size and _jump(u, kinks)[1]:
                _refuse("constraints", "asks for speeds that jump", at, size)
            if size:
                _refuse(name, "jumps", at, size)


def _moving(start: KaneState) -> KaneState:
    """The same place at other speeds: what asks for a share of them may jump."""
    drawn = np.random.default_rng(0).uniform(0.5, 1.5, start.u.shape)
    size = 1.0 + jnp.max(jnp.abs(start.u), initial=0.0)
    return KaneState(start.q, start.u + size * jnp.asarray(drawn, start.u.dtype))


@for_one_call
@running_once()
def _velocities(
    system: KaneSystem, sides: Float[Array, "2 k"], state: KaneState
) -> tuple[Array, list[Array]]:
    """All speeds, and velocities of points and bodies, on both sides of each kink."""

    def at(t: Array) -> Any:
        partials = partials_of(system, t, state.q)
        u = speeds_of(system, partials, state.u).u
        return u, [*partials.at("points", u), *partials.at("turnings", u)]

    return jax.vmap(jax.vmap(at))(sides)


def _jump(values: Array, kinks: np.ndarray) -> tuple[float, float]:
    """The first kink at which values jump, and by how much; zero: at none."""
    before, behind = np.asarray(values, float)
    jumps = np.abs(behind - before).max(axis=1, initial=0.0)
    size = np.maximum(np.abs(before), np.abs(behind)).max(axis=1, initial=0.0)
    loose = max(_JUMPS, 1e3 * float(np.finfo(np.asarray(values).dtype).eps))
    # where constraints do not determine speeds there, nothing is known
    found = np.flatnonzero(jumps > loose * size + _NOTHING)
    if not found.size:
        return 0.0, 0.0
    return float(kinks[found[0]]), float(jumps[found[0]])


def _refuse(name: str, what: str, at: float, size: float) -> None:
    raise FieldError(
        f"KaneSystem.{name}",
        size,
        f"{what} at the kink t = {at:g}: that is an impact, which this motion does not "
        "have",
        "let the velocity change in a short time, or end the run there and begin "
        "another one with the speeds that the impact leaves",
    )
