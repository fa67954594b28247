"""Rolling contacts between any bodies of a system, several at once.

A contact takes the place of constraints that a user would derive: where the bodies
touch becomes part of the coordinates, that they do not slip a velocity constraint, that
they touch a configuration, which the motion keeps to rounding.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import running_once
from ..geometry.surfaces import AbstractPointSurface, AbstractSurface
from ..kinematics.contact_place import check_surface
from ..validation.checks import FieldError, flag, is_traced, real
from ..validation.user_functions import GivenFunction
from .contact_functions import Shared, Slips, extended
from .contact_rates import Axes, Touching
from .contact_start import (
    chosen_of,
    closed_start,
    consistent_speeds,
    correction_of,
    known_poses,
    normals_of,
    root_of,
)
from .equations import reduced
from .given_states import checked_state, known_system, time_of, times_of
from .singular_states import refuse_start
from .system import KaneState, KaneSystem, Numbers
from .system_arguments import in_a_row


class Frame(eqx.Module):
    """Where the axes of a body's surface are; the bodies of contacts.

    Attributes:
        position: Of the surface's origin, function of (t, q, u) -> (3,) [m], FIXED
            axes; None: the fixed origin. It does not look at u.
        rotation: Its axes to fixed axes, function of (t, q, u) -> (3, 3) [1]; None: it
            does not turn.
    """

    position: Any = None
    rotation: Any = None


ground = Frame()


class RollingContact(eqx.Module):
    """Two bodies whose surfaces roll on each other.

    Attributes:
        body_a: Axes of the one (``Frame``).
        surface_a: Its surface, of any kind.
        body_b: Axes of the other, or ``ground``.
        surface_b: Its surface; best a plane or cavity, where A is a ball or wheel.
        without_spin: Whether they do not turn about the common normal, either.
        near: Where the contact is at the start, about [m], fixed axes, shape (3,);
            None: where B is nearest to A's origin.
        name: For errors and results; None: ``contacts[k]``.
    """

    body_a: Any
    surface_a: AbstractSurface
    body_b: Any
    surface_b: AbstractSurface
    without_spin: bool = eqx.field(static=True, default=False)
    near: Any = None
    name: str | None = eqx.field(static=True, default=None)


class ContactForces(NamedTuple):
    """Forces of contacts.

    Attributes:
        force: On body A of each contact [N], fixed axes, shape (contacts, 3).
        spin_torque: About the normal out of A, on A [N m], shape (contacts,): zero
            where turning about it is free.
    """

    force: Float[Array, "k 3"]
    spin_torque: Float[Array, " k"]


class RollingSystem(eqx.Module):
    """A system with contacts, and a start at which they hold.

    Attributes:
        system: For ``simulate``; its coordinates are those of the system without
            contacts, then the contact coordinates of each contact, on B and, where B's
            normal does not determine the point, on A; its state has all speeds.
        start: Nearest to the start that was given [m], [rad], [m/s] and [rad/s], as the
            system has them.
        eliminated: The same with dependent speeds as they are chosen at the start, for
            ``linearize`` and steady motions; see ``eliminated_state``.
        names: Of the contacts.
        redundant: Constraints that follow from others and were left out, by name.
        undetermined: Reactions that are not determined by the motion, by name; those
            that are given have the least sum of squares.
    """

    system: KaneSystem
    start: KaneState
    eliminated: KaneSystem
    names: tuple[str, ...] = eqx.field(static=True)
    redundant: tuple[str, ...] = eqx.field(static=True)
    undetermined: tuple[str, ...] = eqx.field(static=True)

    def eliminated_state(self, state: KaneState) -> KaneState:
        """A state of ``system`` as one of ``eliminated``: its independent speeds alone.

        Args:
            state: Coordinates and all speeds.
        """
        field = "RollingSystem.eliminated_state.state"
        state = checked_state(field, self.system, state)
        return KaneState(state.q, state.u[jnp.asarray(self.eliminated.independent)])

    def forces(self, time: Any, state: KaneState) -> ContactForces:
        """Forces of all contacts, at one state or along a motion.

        Args:
            time: [s], shape () or (T,).
            state: Coordinates and independent speeds, likewise.

        Source: docs/theory.md, (11.7).
        """
        return _along("forces", _forces, self, time, state)

    def gaps(self, time: Any, state: KaneState) -> Float[Array, " k"]:
        """What is open of each contact: gap [m] or tilt of normals [rad], largest.

        Args:
            time: [s], shape () or (T,).
            state: Coordinates and independent speeds, likewise.
        """
        return _along("gaps", _gaps, self, time, state)

    def slips(self, time: Any, state: KaneState) -> Float[Array, " k"]:
        """Velocity between the material points of each contact [m/s], largest part.

        Args:
            time: [s], shape () or (T,).
            state: Coordinates and independent speeds, likewise.
        """
        return _along("slips", _slips, self, time, state)


def rolling_contacts(
    system: KaneSystem,
    contacts: Iterable[RollingContact],
    q: Numbers,
    u: Numbers,
    *,
    time: float = 0.0,
    independent_coordinates: Sequence[int] = (),
    independent_speeds: Sequence[int] = (),
) -> RollingSystem:
    """A system whose bodies roll on each other or on the ground.

    Args:
        system: Its bodies as if nothing touched, with constraints of other kinds, if
            there are any.
        contacts: What touches what; closed chains and redundant contacts are allowed.
        q: The system's coordinates at the start, about: the nearest ones (by mass) at
            which all contacts close are taken.
        u: ALL of its speeds at the start, about, likewise.
        time: Of the start [s].
        independent_coordinates: Coordinates of the system that must not be chosen as
            dependent; for ``linearize``.
        independent_speeds: Speeds that must not be.

    Raises:
        FieldError: contacts that cannot be closed from there, that cannot all hold
            (with their rank), that leave nothing free; surfaces that fit each other, or
            lie inside each other.

    Source: docs/theory.md, (11.4) to (11.6).
    """
    system = known_system("rolling_contacts.system", system)
    contacts = in_a_row("rolling_contacts.contacts", contacts)
    t = time_of("rolling_contacts.time", time)
    own = real("rolling_contacts.q", q, (system.coordinates,), "every coordinate")
    speeds = real("rolling_contacts.u", u, (system.speeds,), "every speed")
    if is_traced(system, contacts, own, speeds, t):
        raise FieldError(
            "rolling_contacts.q",
            own,
            "is traced, and a start is found by numbers",
            "make the system outside of jit and vmap, and vary its parameters inside",
        )
    pairs, names = _pairs(system, contacts, own)
    shared = Shared(system, pairs)
    root = root_of(system, t, own, speeds)
    place = np.concatenate([own, *_places(shared, contacts, t, own)])
    corrections = correction_of(root)
    gaps, slips = _row_names(system, pairs, names)
    place, now = closed_start(shared, corrections, t, place, gaps)
    normals = normals_of(shared, t, jnp.asarray(place), names)
    wanted = consistent_speeds(now, root, np.asarray(speeds))
    along = _normal_rows(shared, normals, len(slips))
    kept = independent_coordinates, independent_speeds
    chosen = chosen_of(now, root, system.coordinates, kept, along)
    given = system, pairs, chosen, corrections.root, (gaps, slips)
    whole, eliminated = extended(*given, False), extended(*given, True)
    start = KaneState(jnp.asarray(place), jnp.asarray(wanted))
    if whole.implied is not None:
        refuse_start(whole, t, start)
    lost = np.linalg.svd(now.by_speeds.T)[2][len(chosen.rows) :]
    loose = np.abs(lost).max(axis=0, initial=0.0) > 1e-9
    return RollingSystem(
        whole,
        start,
        eliminated,
        tuple(names),
        tuple(name for k, name in enumerate(slips) if k not in chosen.rows),
        tuple(name for name, open_ in zip(slips, loose, strict=True) if open_),
    )


def _pairs(
    system: KaneSystem, contacts: tuple[RollingContact, ...], q: Array
) -> tuple[tuple[Touching, ...], list[str]]:
    """Contacts with their functions wrapped, and their names."""
    u = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    example: Any = jnp.zeros(()), q, u
    more = cast(Any, eqx.filter_eval_shape(system.more, *example))
    if not contacts:
        raise FieldError(
            "rolling_contacts.contacts", contacts, "are none", "give RollingContact"
        )

    def axes(field: str, frame: object) -> Axes:
        if not isinstance(frame, Frame):
            raise FieldError(field, frame, "is no body", "give a Frame, or ground")
        shapes = {"position": (3,), "rotation": (3, 3)}
        found = [
            None
            if getattr(frame, name) is None
            else GivenFunction(
                f"{field}.{name}",
                getattr(frame, name),
                shape,
                example,
                more,
                "(t, q, u)",
                "parameters" if system.shared is None else "shared",
            )
            for name, shape in shapes.items()
        ]
        return Axes(*found)

    pairs: list[Touching] = []
    names: list[str] = []
    for k, contact in enumerate(contacts):
        field = f"rolling_contacts.contacts[{k}]"
        _check_contact(field, contact)
        pairs.append(
            Touching(
                axes(f"{field}.body_a", contact.body_a),
                contact.surface_a,
                axes(f"{field}.body_b", contact.body_b),
                contact.surface_b,
                contact.without_spin,
            )
        )
        names.append(contact.name or f"contacts[{k}]")
    return tuple(pairs), names


def _check_contact(field: str, contact: object) -> None:
    if not isinstance(contact, RollingContact):
        raise FieldError(field, contact, "is no contact", "give RollingContact")
    check_surface(f"{field}.surface_a", contact.surface_a)
    check_surface(f"{field}.surface_b", contact.surface_b)
    flag(f"{field}.without_spin", contact.without_spin)


def _row_names(
    system: KaneSystem, pairs: tuple[Touching, ...], names: list[str]
) -> tuple[list[str], list[str]]:
    """Of the rows of configuration and of velocity constraints."""
    gaps = [f"configuration[{k}]" for k in range(len(system.dependent_coordinates))]
    slips = [f"constraints[{k}]" for k in range(system.constraint_count)]
    for name, pair in zip(names, pairs, strict=True):
        gaps += [f"{name}: gap along {axis} [m]" for axis in "xyz"]
        if not pair.by_normal:
            gaps += [f"{name}: tilt of the normals [rad]"] * 2
        slips += [f"{name}: velocity along {axis}" for axis in "xyz"]
        slips += [f"{name}: spin"] * pair.without_spin
    return gaps, slips


def _places(
    shared: Shared, contacts: tuple[RollingContact, ...], t: Array, q: Array
) -> list[np.ndarray]:
    """Contact coordinates to begin the search with."""
    found: list[np.ndarray] = []
    poses = known_poses(shared, t, q)
    each = zip(contacts, shared.pairs, poses, strict=True)
    for k, (contact, pair, pose) in enumerate(each):
        (p_a, R_a), (p_b, R_b) = pose
        near = p_a
        if contact.near is not None:
            field = f"rolling_contacts.contacts[{k}].near"
            near = real(field, contact.near, (3,), "a place [m]")
        on_b = pair.b.locate(R_b.T @ (near - p_b))
        found.append(np.asarray(on_b))
        if pair.by_normal:
            continue
        seen = R_a.T @ (near - p_a)
        if contact.near is None and isinstance(pair.a, AbstractPointSurface):
            normal = -R_a.T @ R_b @ pair.b.geometry(on_b).normal
            found.append(np.asarray(pair.a.find_normal(normal)))
        else:
            found.append(np.asarray(pair.a.locate(seen)))
    for k, place in enumerate(found):
        if not np.isfinite(place).all():
            raise FieldError(
                f"rolling_contacts.contacts[{k}].near",
                None,
                "is not given, and B has no place nearest to A's origin",
                "say where the contact is, about",
            )
    return found


def _normal_rows(shared: Shared, normals: np.ndarray, count: int) -> np.ndarray:
    """Velocities along normals, as combinations of all velocity constraints."""
    found = np.zeros((normals.shape[0], count))
    at = shared.base.constraint_count
    for k, pair in enumerate(shared.pairs):
        found[k, at : at + 3] = normals[k]
        at += 3 + pair.without_spin
    return found


def _along(
    name: str, function: Any, rolling: RollingSystem, time: Any, state: KaneState
) -> Any:
    field = f"RollingSystem.{name}"
    time = times_of(f"{field}.time", time)
    given = f"{field}.state", rolling.system, state
    return _mapped(function, rolling, time, checked_state(*given, lead=time.shape))


@for_one_call
@running_once()
def _mapped(of: Any, rolling: RollingSystem, time: Array, state: KaneState) -> Any:
    mapped = of
    for _ in range(state.q.ndim - 1):
        mapped = jax.vmap(mapped, in_axes=(None, 0, 0))
    return mapped(rolling, time, state)


def _gaps(rolling: RollingSystem, t: Array, state: KaneState) -> Array:
    system = rolling.system
    rest = jnp.zeros(system.speeds + system.auxiliary, state.q.dtype)
    now = system.more(t, state.q, rest)
    return jnp.stack([jnp.max(jnp.abs(c.gap.rows)) for c in now.contacts])


def _slips(rolling: RollingSystem, t: Array, state: KaneState) -> Array:
    equations = reduced(rolling.system, t, state)
    now = rolling.system.more(t, state.q, equations.u)
    return jnp.stack([jnp.max(jnp.abs(c.slip)) for c in now.contacts])


def _forces(rolling: RollingSystem, t: Array, state: KaneState) -> ContactForces:
    system = rolling.system
    equations = reduced(system, t, state)
    shared = cast(Shared, system.more(t, state.q, equations.u).shared)

    def slips(u: Array) -> Array:
        now = system.more(t, state.q, u)
        return Slips(shared.base.constraints, None)(t, state.q, u, now)

    C = cast(Array, jax.jacfwd(slips)(jnp.zeros_like(equations.u)))
    # not of auxiliary speeds: what holds these is no contact's
    m = system.speeds
    reaction = jnp.linalg.pinv(C[:, :m].T, rtol=1e-9) @ equations.lacking[:m]
    at = shared.base.constraint_count
    force: list[Array] = []
    torque: list[Array] = []
    for pair in shared.pairs:
        force.append(reaction[at : at + 3])
        spun = reaction[at + 3] if pair.without_spin else jnp.zeros_like(reaction[0])
        torque.append(spun)
        at += 3 + pair.without_spin
    return ContactForces(jnp.stack(force), jnp.stack(torque))
