"""Whether a driven scene repeats after a period."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..kinematics.coordinates import State, pack
from ..simulation.run import simulate
from ..simulation.run_checks import check_span
from ..validation.checks import FieldError
from .closing_newton import coordinates_of, scales
from .independent_coordinates import IndependentCoordinates
from .shooting import Shooting

# Of the rates: by how much they may differ after a period of what drives the scene.
# Both are taken at one state, so that no run's error is in it, only rounding (1e-13)
# and the last digits of a period that is given to nine.
_REPEATS = 1e-8
# How far beside the motion rates are compared, too, in changes of like size: so far
# that what moves states beside a rest is of its own size, and on every surface.
_ASIDE = 0.1


def check_repeats(shot: Shooting, start: State, period: float) -> None:
    """Refuse a period after which a driven scene is not as it was.

    Args:
        shot: Of a scene that depends on time.
        start: Of the motion.
        period: That is asked for [s].

    Raises:
        FieldError: it is none of the scene's.
    """
    first = shot.time
    check_span(shot.scene, np.asarray([first, first + 2.0 * period]))
    times = jnp.asarray(first + np.linspace(0.0, period, 9))
    run = simulate(shot.scene, start, times, rtol=1e-6)  # any states will do
    # no two coordinates alike, so that none takes another's part
    around = coordinates_of(shot, start)
    pattern = _ASIDE * np.cos(1.0 + np.arange(around.count))
    aside = jnp.asarray(pattern * scales(around, period))
    here, there = (
        np.asarray(_again(shot.scene, times, run.state, aside, jnp.asarray(shift)))
        for shift in (0.0, period)
    )
    good = np.isfinite(here) & np.isfinite(there)
    size = np.abs(here[good]).max(initial=1.0)
    change = np.abs(there - here)[good].max(initial=0.0)
    if change > _REPEATS * size:
        problem = (
            "is not one of the scene, which depends on time: its rates or its base's "
            f"rotation differ by {change:.2g} after it"
        )
        remedy = "give a whole number of periods of what drives the scene"
        raise FieldError("periodic_motion.period", period, problem, remedy)


@for_one_call
def _again(
    scene: Scene,
    times: Float[Array, " T"],
    states: State,
    aside: Float[Array, " n"],
    shift: Float[Array, ""],
) -> Float[Array, "T y"]:
    """Rates of states at other times, and how the base is turned then.

    Args:
        scene: What rolls on what.
        times: Of the states [s], shape (T,).
        states: Every array with a leading T.
        aside: Coordinates of others beside each of them: a rest may not see what the
            scene does, which moves all that is beside it.
        shift: Added to the times [s].
    """
    motion = scene.base.motion

    def one(t: Array, state: State) -> Array:
        beside = IndependentCoordinates(scene, t, state).state(aside)
        found = [pack(rolling_derivative(scene, t + shift, y)) for y in (state, beside)]
        turned = None if motion is None else motion.at(t + shift).rotation
        if turned is not None:
            found.append(turned.ravel())
        return jnp.concatenate(found)

    return jax.vmap(one)(times, states)
