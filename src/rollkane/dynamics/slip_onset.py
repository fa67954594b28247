"""How fast a slip is that only begins, by the size of the scene that it is in."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .directed_friction import LEAST_ONSET, ONSET
from .mass_matrix import field_of
from .precision import at_precision
from .scene import Scene

# Of a scene whose own speed is over one metre a second by as much, an onset of that
# many metres a second serves: it would take steps shorter than the clock in one of 1e6
_LARGE = 1e-3


def onset_of(scene: Scene) -> Float[Array, ""]:
    """Until what speed a slip only begins [m/s]; of no derivative.

    ``ONSET`` of a scene whose own speed is a metre a second: that of a fall by the
    radius of gyration, ``sqrt(g k)``. What friction leaves out goes with the square of
    the onset, over the speeds that there are: of one size it would be lost in a scene
    of a metre, and 3e-6 of a motion of 1 cm/s. A larger one keeps it, as there may be
    slow slips in it. Without a field of gravity, which says nothing, too.

    Source: docs/theory.md, (8.5).
    """
    body, field = scene.body, field_of(scene.loads)
    least = at_precision(LEAST_ONSET, body.mass)
    onset = jnp.full_like(body.mass, at_precision(ONSET, body.mass))
    if field is None:
        return onset
    trace = body.inertia[0, 0] + body.inertia[1, 1] + body.inertia[2, 2]
    squared = field[0] * field[0] + field[1] * field[1] + field[2] * field[2]
    fourth = squared * trace / body.mass  # power of the speed
    known = fourth > 0.0
    speed = jnp.sqrt(jnp.sqrt(jnp.where(known, fourth, 1.0)))
    share = jnp.minimum(speed, jnp.maximum(1.0, _LARGE * speed))
    return jax.lax.stop_gradient(jnp.maximum(onset * share, least))
