"""How fast a slip is that only begins, by the size of the scene that it is in."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..codegen.tracing import traced_once
from ..geometry.small_linear import dot
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
    if field is None:
        return jnp.full_like(body.mass, at_precision(ONSET, body.mass))
    return _onset_in(field, body.inertia, body.mass)


@traced_once
def _onset_in(
    field: Float[Array, "3"], inertia: Float[Array, "3 3"], mass: Float[Array, ""]
) -> Float[Array, ""]:
    least, onset = (at_precision(x, mass) for x in (LEAST_ONSET, ONSET))
    trace = inertia[0, 0] + inertia[1, 1] + inertia[2, 2]
    fourth = dot(field, field) * trace / mass  # power of the speed
    known = fourth > 0.0
    speed = jnp.sqrt(jnp.sqrt(jnp.where(known, fourth, 1.0)))
    share = jnp.minimum(speed, jnp.maximum(1.0, _LARGE * speed))
    return jax.lax.stop_gradient(jnp.maximum(onset * share, least))
