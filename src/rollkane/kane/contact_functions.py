"""Functions of a system whose bodies roll on each other, from those of its bodies.

Coordinates: the system's own, then the contact coordinates of each pair, on B and on A.
Modules, not closures, so that systems of the same kind share one compilation.
"""

from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import components, dot, matmul, matvec, solve_spd
from ..validation.user_functions import GivenFunction
from .contact_rates import (
    Moving,
    Places,
    Touching,
    all_poses,
    closed,
    directions_on,
    moving,
    velocity_between,
)
from .parts import Load, Particle, RigidBody
from .system import KaneSystem


class Instant(NamedTuple):
    """What the functions share.

    Attributes:
        more: What the system's own functions get behind (t, q, u).
        q: Its own coordinates.
        q_dot: Their rates.
        contacts: Of every pair.
        places: Contact coordinates of every pair.
        shared: What made this.
        parameters: Of the system.
    """

    more: Any
    q: Array
    q_dot: Array
    contacts: list[Moving]
    places: list[Places]
    shared: Any
    parameters: Any


class Shared(eqx.Module):
    """Evaluates everything that the functions share."""

    base: KaneSystem
    pairs: tuple[Touching, ...]

    def __call__(self, t: Array, q: Array, u: Array, parameters: Any) -> Instant:
        """Everything, at (t, q, u)."""
        base = self.base
        own, places = split(base, self.pairs, q)
        more = self.more(t, own, u, parameters)
        q_dot = base.kinematics(t, own, u, more)

        def poses(t: Array, q: Array) -> Any:
            return all_poses(self.pairs, t, q, u, self.more(t, q, u, parameters))

        found, moved = jax.jvp(poses, (t, own), (jnp.ones_like(t), q_dot))
        contacts = [
            moving(*each) for each in zip(self.pairs, found, moved, places, strict=True)
        ]
        return Instant(more, own, q_dot, contacts, places, self, parameters)

    def more(self, t: Array, q: Array, u: Array, parameters: Any) -> Any:
        """What the system's own functions get."""
        if self.base.shared is None:
            return parameters
        return self.base.shared(t, q, u, parameters)


def split(
    base: KaneSystem, pairs: tuple[Touching, ...], q: Array
) -> tuple[Array, list[Places]]:
    """A system's own coordinates, and the contact coordinates of every pair."""
    at, places = base.coordinates, cast("list[Places]", [])
    for pair in pairs:
        on_b, on_a = pair.coordinates
        middle, end = at + on_b, at + on_b + on_a
        places.append((q[at:middle], q[middle:end]))
        at = end
    return q[: base.coordinates], places


class Own(eqx.Module):
    """A function of the system's own."""

    function: GivenFunction

    def __call__(self, t: Array, q: Array, u: Array, now: Instant) -> Array:
        """Its value at (t, q, u)."""
        return self.function(t, now.q, u, now.more)


def kinematics(t: Array, q: Array, u: Array, now: Instant) -> Array:
    """Rates of the own and of the contact coordinates."""
    return jnp.concatenate([now.q_dot, *(contact.rates for contact in now.contacts)])


def _chosen(rows: Array, chosen: tuple[int, ...] | None) -> Array:
    """Some of the rows; without indices, which the loop in C does not take."""
    return rows if chosen is None else jnp.stack([rows[k] for k in chosen])


class Slips(eqx.Module):
    """Velocity constraints: the system's own, then the slips of every contact."""

    own: GivenFunction | None
    chosen: tuple[int, ...] | None = eqx.field(static=True)

    def __call__(self, t: Array, q: Array, u: Array, now: Instant) -> Array:
        """Its value at (t, q, u)."""
        rows = [] if self.own is None else [self.own(t, now.q, u, now.more)]
        rows += [contact.slip for contact in now.contacts]
        return _chosen(jnp.concatenate(rows), self.chosen)


class Gaps(eqx.Module):
    """Configuration: the system's own, then the gaps of every contact."""

    own: GivenFunction | None
    chosen: tuple[int, ...] | None = eqx.field(static=True)

    def __call__(self, t: Array, q: Array, u: Array, now: Instant) -> Array:
        """Its value at (t, q, u)."""
        rows = [] if self.own is None else [self.own(t, now.q, u, now.more)]
        rows += [contact.gap.rows for contact in now.contacts]
        return _chosen(jnp.concatenate(rows), self.chosen)


class Implied(eqx.Module):
    """Constraints that follow from others: slips, then gaps."""

    slips: Slips
    gaps: Gaps

    def __call__(self, t: Array, q: Array, u: Array, now: Instant) -> Array:
        """Its value at (t, q, u)."""
        parts = [rows(t, q, u, now) for rows in (self.slips, self.gaps) if rows.chosen]
        return jnp.concatenate(parts)


class Projection(eqx.Module):
    """Coordinates at which every contact closes, nearest to given ones.

    Bodies are moved along the normals, by what takes the least energy, and contacts go
    where the surfaces then are nearest. What is left is the square of what was open,
    times curvatures: roundings for 1e-8, which a run leaves in a hundred units of time.

    Attributes:
        mobility: ``M^-1`` of the start, shape (m, m).
        normals: Contacts whose normals do not follow from others.

    Source: docs/theory.md, (11.6).
    """

    mobility: Float[Array, "m m"]
    normals: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, t: Array, q: Array, u: Array, now: Instant) -> Array:
        """Its value at (t, q, u)."""
        shared = now.shared
        base, pairs = shared.base, shared.pairs
        rest = jnp.zeros_like(u)
        own, places = split(base, pairs, q)

        def normal_slips(u: Array) -> Array:
            q_dot = base.kinematics(t, own, u, now.more)
            _, moved = jax.jvp(poses, (t, own), (0.0 * t, q_dot))
            slips = [
                dot(normal, velocity_between(contact.gap, pair_moved))
                for normal, contact, pair_moved in zip(
                    normals, now.contacts, moved, strict=True
                )
            ]
            return jnp.stack([slips[k] for k in self.normals])

        def poses(t: Array, q: Array) -> Any:
            # at the place itself: now.more is of q as it was
            more = shared.more(t, q, rest, now.parameters)
            return all_poses(pairs, t, q, rest, more)

        found = poses(t, own)
        normals = [
            matvec(pose[0][1], contact.gap.normal)
            for pose, contact in zip(found, now.contacts, strict=True)
        ]
        slopes = jax.lax.stop_gradient(cast(Array, jax.jacrev(normal_slips)(rest)))
        spread = matmul(self.mobility, slopes.T)
        square = matmul(slopes, spread)
        rows = [components(square[k, : k + 1]) for k in range(len(self.normals))]
        resting = base.kinematics(t, own, rest, now.more)
        open_ = [
            dot(normal, contact.gap.rows[:3])
            for normal, contact in zip(normals, now.contacts, strict=True)
        ]
        wanted = components(jnp.stack([open_[k] for k in self.normals]))
        push = matvec(spread, jnp.stack(solve_spd(rows, wanted)))
        pushed = own + (base.kinematics(t, own, -push, now.more) - resting)
        found = poses(t, pushed)
        places = [closed(*each) for each in zip(pairs, found, places, strict=True)]
        own = pushed
        return jnp.concatenate([own, *(u for place in places for u in place)])


class Corrections(eqx.Module):
    """How the coordinates may be moved: bodies by the energy it takes, contacts freely.

    Attributes:
        root: ``M^-1/2`` of the start, times the square root of the largest moment:
            changes of the speeds' integrals that take the same energy, shape (m, m).
        reach: How much farther contacts are moved [1].
    """

    root: Float[Array, "m m"]
    reach: float = eqx.field(static=True)

    def __call__(self, t: Array, q: Array, u: Array, now: Instant) -> Array:
        """Its value at (t, q, u)."""
        base = now.shared.base
        rest = base.kinematics(t, now.q, 0.0 * u, now.more)
        columns = [
            base.kinematics(t, now.q, column, now.more) - rest for column in self.root.T
        ]
        blocks = [jnp.stack(columns, axis=1)]
        pairs = now.shared.pairs
        for pair, contact, place in zip(pairs, now.contacts, now.places, strict=True):
            steps = directions_on(pair, contact.gap, place)
            blocks += [self.reach * step for step in steps]
        return _diagonal(blocks)


def _diagonal(blocks: list[Array]) -> Array:
    """Blocks along the diagonal of a matrix."""
    width = sum(block.shape[1] for block in blocks)
    rows: list[Array] = []
    at = 0
    for block in blocks:
        behind = width - at - block.shape[1]
        rows.append(jnp.pad(block, ((0, 0), (at, behind))))
        at += block.shape[1]
    return jnp.concatenate(rows)


class Chosen(NamedTuple):
    """Which constraints count, and what they determine.

    Attributes:
        rows: Of the velocity constraints, as ``Slips`` orders them.
        speeds: That these determine.
        gaps: Of the configuration, as ``Gaps`` orders it.
        coordinates: That these determine.
        normals: Contacts whose normals do not follow from others.
    """

    rows: tuple[int, ...]
    speeds: tuple[int, ...]
    gaps: tuple[int, ...]
    coordinates: tuple[int, ...]
    normals: tuple[int, ...]


def extended(
    base: KaneSystem,
    pairs: tuple[Touching, ...],
    chosen: Chosen,
    root: Float[Array, "m m"],
    names: tuple[list[str], list[str]],
    eliminated: bool,
) -> KaneSystem:
    """The system with its contacts.

    Args:
        base: Without.
        pairs: What touches what.
        chosen: Which constraints count.
        root: ``M^-1/2`` at the start.
        names: Of all rows of the configuration and of the velocity constraints.
        eliminated: Whether dependent speeds are, else constraints act by multipliers.
    """

    def own(function: GivenFunction) -> Own:
        return Own(function)

    parts = [
        RigidBody(
            part.mass,
            part.inertia,
            own(part.velocity),
            own(part.angular_velocity),
            part.own_axes,
        )
        if isinstance(part, RigidBody)
        else Particle(part.mass, own(part.velocity))
        for part in base.parts
    ]
    loads = [Load(own(load.velocity), own(load.load)) for load in base.loads]
    forces = base.generalized_forces
    extra = sum(sum(pair.coordinates) for pair in pairs)
    gaps, slips = (
        tuple(k for k in range(len(all_rows)) if k not in some)
        for all_rows, some in zip(names, (chosen.gaps, chosen.rows), strict=True)
    )
    left = Implied(Slips(base.constraints, slips), Gaps(base.configuration, gaps))
    return KaneSystem(
        base.coordinates + extra,
        base.speeds,
        kinematics,
        parts,
        loads,
        constraints=Slips(base.constraints, chosen.rows),
        dependent=chosen.speeds if eliminated else None,
        configuration=Gaps(base.configuration, chosen.gaps),
        dependent_coordinates=chosen.coordinates,
        auxiliary=base.auxiliary,
        generalized_forces=None if forces is None else own(forces),
        parameters=base.parameters,
        shared=Shared(base, pairs),
        projection=None if eliminated else Projection(root @ root.T, chosen.normals),
        implied=left if slips or gaps else None,
        implied_names=[*(names[1][k] for k in slips), *(names[0][k] for k in gaps)],
    )
