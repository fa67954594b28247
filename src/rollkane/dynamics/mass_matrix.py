"""The linear system of the accelerations: mass matrix and right-hand side.

Angular acceleration and alpha'' on body axes, about the contact point (docs/theory.md,
(4.3)).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import components, cross, dot, matvec, matvec_transposed
from ..kinematics.contact import Contact
from ..kinematics.voronets import AnyState
from .bodies import inertia_about
from .carried import Carried
from .loads import AbstractLoad
from .scene import Scene
from .supported import total

# products of more coordinates are one product of matrices: they would take minutes to
# compile one by one
_ONE_BY_ONE = 8


class Masses(NamedTuple):
    """One carried part about the contact point, and what drives it.

    Attributes:
        part: The part.
        arm: ``s = r - rho`` [m], body axes, shape (3, k).
        drive: ``m beta`` less the loads' fields [N], body axes, shape (3, k).
        torques: Of each rigid body among them, rate of its own angular momentum
            without w' and alpha'' [N m].
    """

    part: Carried
    arm: Float[Array, "3 k"]
    drive: Float[Array, "3 k"]
    torques: tuple[Float[Array, "3"], ...]

    def inertial_force(
        self, turn: Array, slid: Array | None, accelerations: list[Array]
    ) -> Float[Array, "3 k"]:
        """``m (a - g)`` of each mass [N], body axes.

        Args:
            turn: ``w'`` [rad/s^2], body axes.
            slid: Slip acceleration [m/s^2], body axes; None: it rolls.
            accelerations: Those of the part's own quasi-velocities.
        """
        push = cross(turn, self.arm)
        push = push if slid is None else push + slid[:, None]
        for partial, rate in zip(self.part.partials, accelerations, strict=True):
            push = push + rate * partial
        return self.part.mass[None] * push + self.drive


class System(NamedTuple):
    """The linear system ``[[Th, G], [G^T, Ma]] (w', alpha'') = rhs`` on body axes.

    Attributes:
        rows: Lower triangle by rows, row i with i + 1 entries.
        rhs: Its right-hand side, 3 + n entries.
        arm: Mass centre of the body alone from the contact point [m].
        proper: ``a_P - g``, what an accelerometer at the body's point of contact
            would show: its acceleration less the fields [m/s^2].
        force: Loads that act on the body as a force [N]; None for none.
        masses: What is carried.
    """

    rows: list[list[Array]]
    rhs: list[Array]
    arm: Float[Array, "3"]
    proper: Float[Array, "3"]
    force: Float[Array, "3"] | None
    masses: tuple[Masses, ...]


def assemble(
    scene: Scene, t: Float[Array, ""], state: AnyState, contact: Contact
) -> System:
    """Mass matrix and right-hand side of a scene.

    Source: docs/theory.md, (4.2), (4.3).
    """
    system = of_the_body(scene, t, contact)
    rows, right = system.rows, system.rhs
    masses: list[Masses] = []
    for supported, alpha, alpha_dot in scene.shares(state):
        carried = supported.carried(t, alpha, alpha_dot)
        part = masses_of(carried, contact, system.proper)
        own = supported.applied(t, alpha, alpha_dot, part.part.pairing)
        rows, right = _with_masses(rows, right, part, own)
        masses.append(part)
    right = with_generalized(right, scene, t, state)
    return system._replace(rows=rows, rhs=right, masses=tuple(masses))


def of_the_body(scene: Scene, t: Float[Array, ""], contact: Contact) -> System:
    """The system of the rolling body alone, under the loads that act on it."""
    body, w = scene.body, contact.angular_velocity
    c = body.center_of_mass - contact.body_point
    Th = inertia_about(body.mass, c, body.inertia)
    proper = contact.body_point_acceleration
    field = field_of(scene.loads)
    if field is not None:
        proper = proper - matvec_transposed(contact.rotation, field)
    rhs = cross(body.mass * proper, c) - cross(w, times_lower(Th, w))
    force = None
    for load in scene.loads:
        wrench = load.wrench(t, body, contact)
        if wrench is not None:
            rhs = rhs + wrench[1]
            force = wrench[0] if force is None else force + wrench[0]
    return System(Th, components(rhs), c, proper, force, ())


def with_generalized(
    right: list[Array], scene: Scene, t: Float[Array, ""], state: AnyState
) -> list[Array]:
    """Right-hand sides with the loads' generalized forces on all quasi-velocities."""
    for load in scene.loads:
        given = load.generalized(scene, t, state)
        if given is not None:
            right = [a + b for a, b in zip(right, given, strict=True)]
    return right


def field_of(loads: tuple[AbstractLoad, ...]) -> Float[Array, "3"] | None:
    """Sum of the fields of all loads [m/s^2], fixed axes; None for none."""
    fields = [load.field for load in loads if load.field is not None]
    return sum(fields[1:], fields[0]) if fields else None


def masses_of(part: Carried, contact: Contact, proper: Float[Array, "3"]) -> Masses:
    """``m beta``, ``beta = a_P - g + w x (w x s) + 2 w x r* + r**``, (4.2)."""
    w = contact.angular_velocity
    s = part.place - contact.body_point[:, None]
    coriolis = cross(w, cross(w, s) + 2.0 * part.velocity)
    drive = part.mass[None] * (coriolis + part.bias + proper[:, None])
    torques: list[Array] = []
    for turning in part.turnings:
        # angular momentum of a rigid part about its own mass centre, I_r (w + w_r)
        I_r, w_r = turning.inertia, turning.velocity
        W = w + w_r
        change = matvec(I_r, turning.bias + cross(w, w_r))
        torques.append(change + cross(W, matvec(I_r, W)))
    return Masses(part, s, drive, tuple(torques))


def _with_masses(
    rows: list[list[Array]], rhs: list[Array], masses: Masses, own: list[Array] | None
) -> tuple[list[list[Array]], list[Array]]:
    """The system with one more part: its coordinates come last."""
    part, s, drive, torques = masses
    m = part.mass[None]
    moment = total(cross(s, drive))
    for torque in torques:
        moment = moment + torque
    before = len(rows)
    rows = [list(row) for row in rows]
    rhs = [b - d for b, d in zip(rhs[:3], components(moment), strict=True)] + rhs[3:]
    own_inertia = [turning.inertia for turning in part.turnings]
    for i, row in enumerate(inertia_rows(part.mass, s, own_inertia)):
        rows[i] = [old + new for old, new in zip(rows[i], row, strict=True)]
    zero = jnp.zeros_like(rhs[0])
    pushes = [m * u for u in part.partials]
    products = _products(pushes, part.partials)
    for a, (u, push) in enumerate(zip(part.partials, pushes, strict=True)):
        coupling = total(cross(s, push))
        value = -_summed(dot(u, drive))
        mass_row = products[a]
        for turning, torque in zip(part.turnings, torques, strict=True):
            tilt = turning.partials[a]
            stored = matvec(turning.inertia, tilt)
            coupling = coupling + stored
            value = value - dot(tilt, torque)
            mass_row = [
                x + dot(stored, turning.partials[b]) for b, x in enumerate(mass_row)
            ]
        rows.append([*components(coupling), *[zero] * (before - 3), *mass_row])
        rhs.append(value if own is None else value + own[a])
    return rows, rhs


def _products(pushes: list[Array], partials: Sequence[Array]) -> list[list[Array]]:
    """Lower triangle of ``sum m dr/dalpha_a . dr/dalpha_b``."""
    count = len(partials)
    if count > _ONE_BY_ONE:
        both = jnp.stack(pushes), jnp.stack(partials)
        table = jnp.tensordot(*both, axes=((1, 2), (1, 2)))
        return [components(row)[: a + 1] for a, row in enumerate(components(table))]
    return [
        [_summed(dot(pushes[a], partials[b])) for b in range(a + 1)]
        for a in range(count)
    ]


def inertia_rows(
    mass: Float[Array, " k"],
    s: Float[Array, "3 k"],
    own_inertia: Sequence[Float[Array, "3 3"]],
) -> list[list[Array]]:
    """Lower triangle of ``sum m (|s|^2 I - s s^T)``, and of the rigid parts' own."""
    x, y, z = components(s)
    xx, yy, zz = (_summed(mass * a * a) for a in (x, y, z))
    rows = [
        [yy + zz],
        [-_summed(mass * x * y), xx + zz],
        [-_summed(mass * x * z), -_summed(mass * y * z), xx + yy],
    ]
    for own in own_inertia:
        rows = [[rows[i][j] + own[i, j] for j in range(i + 1)] for i in range(3)]
    return rows


def _summed(x: Float[Array, " k"]) -> Float[Array, ""]:
    if x.shape[0] > 8:
        return jnp.sum(x)
    parts = components(x)
    return sum(parts[1:], parts[0])


def times_lower(lower: list[list[Array]], v: Float[Array, "3"]) -> Float[Array, "3"]:
    """Symmetric matrix, given by its lower triangle, times a vector."""
    n, x = len(lower), components(v)
    rows = [[lower[max(i, j)][min(i, j)] * x[j] for j in range(n)] for i in range(n)]
    return jnp.stack([sum(row[1:], row[0]) for row in rows])
