"""What is not finite in the first rates of a run, in words."""

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import jax
import numpy as np

from ..validation.user_functions import GivenFunction, UserFunction
from .abstract_supported import AbstractRollingPart
from .contact_laws import accelerations
from .mass_matrix import assemble
from .rolling import contact_of
from .scene import Scene

# Name, remedy, and what gives its value.
_Part: TypeAlias = tuple[str, str, Callable[[], Any]]


def first_not_finite(scene: Scene, t: Any, state: Any) -> str:
    """Which part of a scene has no finite rates at a state, and what to do.

    Args:
        scene: With known numbers.
        t: Time [s].
        state: In contact or in flight, known.
    """
    at = f"at t = {float(t):g} s"
    for what, remedy, evaluated in _parts(scene, t, state):
        try:
            values = jax.tree.leaves(evaluated())
        except FloatingPointError:  # where JAX is told to look for NaN
            values = [np.nan]
        if not all(np.isfinite(np.asarray(x)).all() for x in values):
            return f"the start cannot be used: {what} is not finite {at}: {remedy}"
    return (
        "the start cannot be used: the first step had to be shorter than the clock "
        f"tells {at}: the rates, or a function of yours, change too fast there"
    )


def _parts(scene: Scene, t: Any, state: Any) -> Iterator[_Part]:
    """Name, remedy and value of each part, those first that the others depend on."""
    motion = scene.base.motion
    if motion is not None:
        remedy = "let its functions be finite and smooth at the first time"
        yield f"the motion of the base ({_named(motion)})", remedy, lambda: motion.at(t)
    if state.touches:
        yield from _of_surfaces(scene, state)
    order = sorted(range(len(scene.supported)), key=lambda k: _rolls(scene, k))
    for k, (part, alpha, rates) in zip(order, scene.shares(state), strict=True):
        remedy = "let its functions be finite and smooth at the first alpha"
        name = f"scene.supported[{k}] ({_named(part)})"
        yield name, remedy, lambda p=part, a=alpha, r=rates: p.carried(t, a, r)
        force = lambda p=part, a=alpha, r=rates: p.applied(
            t, a, r, p.carried(t, a, r).pairing
        )
        yield f"the force of {name}", remedy, force
    contact = contact_of(scene, t, state)
    yield (
        "the velocity of the contact",
        "the surfaces fit each other there, or the contact is at the end of one",
        lambda: (contact.velocity, contact.body_rates, contact.base_rates),
    )
    for k, load in enumerate(scene.loads):
        remedy = "let its function be finite at the start"
        wrench = lambda load=load: load.wrench(t, scene.body, contact)
        yield f"scene.loads[{k}] ({_named(load)})", remedy, wrench
    yield (
        "the accelerations",
        "some motion moves no mass, or no normal force fits the friction",
        lambda: (
            accelerations(
                scene, t, contact, assemble(scene, t, state, contact)
            ).angular_acceleration
        ),
    )


def _rolls(scene: Scene, k: int) -> bool:
    return isinstance(scene.supported[k], AbstractRollingPart)


def _of_surfaces(scene: Scene, state: Any) -> Iterator[_Part]:
    body, base = scene.body.surface, scene.base.surface
    in_charts = state.in_charts
    places = [("scene.base.surface", base, state.contact_on_base)]
    if scene.has_contact_coordinates or in_charts:
        places.append(("scene.body.surface", body, state.contact_on_body))
    for name, surface, u in places:
        found = surface.chart_geometry if in_charts else surface.geometry
        at = f"[{', '.join(f'{x:g}' for x in np.asarray(u))}]"
        name = f"{name} ({_named(surface)})"
        remedy = "let its function be finite there"
        yield (
            f"the position on {name} at {at}",
            remedy,
            lambda f=found, u=u: f(u).position,
        )
        remedy = "let its function be twice differentiable there, and its chart regular"
        yield (
            f"the curvature of {name} at {at}",
            remedy,
            lambda f=found, u=u: (f(u).frame, f(u).lengths, f(u).frame_rates),
        )


def _named(part: Any) -> str:
    """A kind by name, with the functions of the user's that it holds."""
    kinds = (UserFunction, GivenFunction)
    leaves = jax.tree.leaves(part, is_leaf=lambda x: isinstance(x, kinds))
    functions = [x.__name__ for x in leaves if isinstance(x, kinds)]
    return ": ".join([type(part).__name__, ", ".join(functions)][: 1 + bool(functions)])
