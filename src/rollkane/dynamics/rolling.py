"""Rolling without slipping: the formulation that `simulate` uses.

One symmetric positive definite system per evaluation for angular acceleration and
alpha'', on body axes, about the contact point (docs/theory.md, (4.3)).
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import components, dot, matvec, matvec_transposed
from ..kinematics.contact import Contact, body_to_base
from ..kinematics.coordinates import Pair
from ..kinematics.voronets import AnyState, VoronetsState
from .abstract_supported import rates_of_rolling, rolling_parts
from .condensation import condensed, condenses
from .contact_laws import accelerations
from .mass_matrix import Masses, assemble
from .momentum import Solution, momentum_rate
from .scene import Scene

# a run towards Painleve's paradox ends just before it, with the normal force growing
# over all
LEAST_MARGIN = 1e-3

_Heading: TypeAlias = Callable[[Float[Array, "3"]], Float[Array, "2"]]


def contact_of(scene: Scene, t: Float[Array, ""], state: AnyState) -> Contact:
    """The contact of a scene's body.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: In pole-free or in Voronets coordinates.

    Returns:
        The contact; for a Voronets state a ``ChartContact``.
    """
    body, base, motion = scene.body.surface, scene.base.surface, scene.base.motion
    moving = lambda: None if motion is None else motion.at(t)
    return state.contact(Pair(body, base, moving, scene.contact.without_spin))


def watches_headings(scene: Scene) -> bool:
    """Whether a normal of a surface could pass where its inverse Gauss map jumps."""
    inner = any(watches_headings(part.scene) for part in rolling_parts(scene.supported))
    body, base = scene.body.surface, scene.base.surface
    turns = body.may_turn_over or base.may_turn_over
    return inner or turns or any(x is not None for x in _headings(scene))


def _headings(scene: Scene) -> tuple[_Heading | None, _Heading | None]:
    """Of the body's normal and of the base's, what must not be reversed by a step."""
    body, base = scene.body.surface, scene.base.surface
    return body.normal_heading(base.is_flat), base.normal_heading(False)


def headings(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> list[Float[Array, "3"]]:
    """What no step may reverse of the normals, for a scene that watches them.

    Parts of them (zero behind), or those of charts, which turn over at a pole; they
    vanish where the step that comes next may.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: In contact.
    """
    of_body, of_base = _headings(scene)
    body, base = scene.body.surface, scene.base.surface
    if isinstance(state, VoronetsState):
        ground = base.chart_geometry(state.contact_on_base)
        shell = body.chart_geometry(state.contact_on_body)
        own = shell.normal
    else:
        motion = scene.base.motion
        moving = None if motion is None else motion.at(t)
        to_base = body_to_base(rotation_matrix(state.orientation), moving)
        ground, shell = base.geometry(state.contact_on_base), None
        own = -matvec_transposed(to_base, ground.normal)
        if scene.has_contact_coordinates:
            shell = body.geometry(state.contact_on_body)
    both = (of_body, own), (of_base, ground.normal)
    found = [jnp.pad(part(normal), (0, 1)) for part, normal in both if part is not None]
    charts = (body, shell), (base, ground)
    found += [x.upright for s, x in charts if s.may_turn_over and x is not None]
    for part, own in zip(rolling_parts(scene.supported), state.supported, strict=True):
        found += headings(part.scene, t, own)
    return found


class Solved(NamedTuple):
    """What the forces of one instant determine.

    Attributes:
        contact: Of the body.
        masses: What is carried.
        solution: Accelerations.
        force: Gives the contact force [N], BODY axes, shape (3,).
    """

    contact: Contact
    masses: tuple[Masses, ...]
    solution: Solution
    force: Callable[[], Float[Array, "3"]]


def solved(scene: Scene, t: Float[Array, ""], state: AnyState) -> Solved:
    """Accelerations and contact force of a scene at one instant.

    Args:
        scene: What rolls on what, carrying what, under which loads.
        t: Time [s].
        state: Where the body is and how it turns.

    Source: docs/theory.md, (4.3), (6.2).
    """
    contact = contact_of(scene, t, state)
    if condenses(scene):
        found = condensed(scene, t, state, contact)
        force = lambda: found.force(scene, contact)
        return Solved(contact, found.system.masses, found.solution, force)
    system = assemble(scene, t, state, contact)
    solution = accelerations(scene, t, contact, system)
    force = lambda: momentum_rate(scene, contact, system).force(solution)
    return Solved(contact, system.masses, solution, force)


def rolling_derivative(scene: Scene, t: Float[Array, ""], state: AnyState) -> AnyState:
    """Rates of the state of a rolling body: the right-hand side itself.

    Args:
        scene: What rolls on what, carrying what, under which loads.
        t: Time [s].
        state: Where the body is and how it turns, in pole-free or in Voronets
            coordinates.

    Returns:
        Rates of every number of the state [its unit / s], as a state.

    Source: docs/theory.md, (4.3). Sign: the normal points out of each surface.
    """
    return _rates(scene, state, solved(scene, t, state))


def _rates(scene: Scene, state: AnyState, found: Solved) -> AnyState:
    w_dot, alpha_ddot, slid, *_ = found.solution
    pairings = [masses.part.pairing for masses in found.masses]
    pairings = [pairing for pairing in pairings if pairing is not None]
    if not pairings:
        return state.rates(found.contact, w_dot, alpha_ddot, slid)
    n = state.alpha.shape[0]
    rolling = components(alpha_ddot[n:])
    inner = rates_of_rolling(scene.supported, state.supported, pairings, rolling)
    return state.rates(found.contact, w_dot, alpha_ddot[:n], slid, inner)


class AtContact(NamedTuple):
    """What a run in modes asks of one instant.

    Attributes:
        rates: Of the state, as a state.
        press: As of :func:`press_and_pull` [N].
        pull: Likewise [N].
        turn: Slip times the rate at which friction turns it [m/s^2]; zero: not asked.
        margin: As of :func:`painleve_margin` [1].
        out: Outward normal of the body there, FIXED axes [1].
    """

    rates: Any
    press: Float[Array, ""]
    pull: Float[Array, "3"]
    turn: Float[Array, ""]
    margin: Float[Array, ""]
    out: Float[Array, "3"]


@eqx.filter_jit
def at_contact(scene: Scene, t: Float[Array, ""], state: AnyState) -> AtContact:
    """Rates and forces at once; inside of a program traced once, however often asked.

    Args:
        scene: What rolls or slips on what.
        t: Time [s].
        state: Where the body is and how it turns.
    """
    rates, contact, solution, force = _solved(scene, t, state)
    press, pull, out = _parted(contact, force)
    turn = jnp.zeros_like(press) if solution.turn is None else solution.turn
    endless = jnp.full((), jnp.inf, force.dtype)
    margin = endless if solution.margin is None else solution.margin
    return AtContact(rates, press, pull, turn, margin, out)


def contact_force(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, "3"]:
    """Force of the base on the body [N], FIXED axes, shape (3,).

    Source: docs/theory.md, (6.2), ``Rc = dP/dt - F``, with ``a_i = a_P + w' x s_i +
    dr_i/dalpha alpha'' + beta_i``.
    """
    return _solved(scene, t, state)[3]


def press_and_pull(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """Normal force [N], negative where it pulls; force along the surface [N], FIXED."""
    _, contact, _, force = _solved(scene, t, state)
    press, pull, _ = _parted(contact, force)
    return press, pull


def _parted(
    contact: Contact, force: Float[Array, "3"]
) -> tuple[Float[Array, ""], Float[Array, "3"], Float[Array, "3"]]:
    """Along the normal and the surface, and the normal, on fixed axes."""
    out = matvec(contact.rotation, contact.normal)
    press = -dot(force, out)
    return press, force + press * out, out


def _solved(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> tuple[AnyState, Contact, Solution, Float[Array, "3"]]:
    """Rates, contact, accelerations and contact force [N], fixed axes."""
    found = solved(scene, t, state)
    contact = found.contact
    force = matvec(contact.rotation, found.force())
    return _rates(scene, state, found), contact, found.solution, force


def painleve_margin(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, ""]:
    """What the normal force is divided by [1]; infinite where friction has no part.

    Where it is not positive no normal force fits the friction (Painleve's paradox):
    rates are NaN there, and a run ends just before.

    Source: docs/theory.md, (7.4).
    """
    return at_contact(scene, t, state).margin
