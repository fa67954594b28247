"""The likelihood of a record as a pure function, for optimisers of the user's own."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics.consistency import with_contact_found
from ..dynamics.scene import Scene, require_scene
from ..hybrid.modes import Modes
from ..kinematics.coordinates import State
from ..simulation.run_options import RunOptions
from ..validation.checks import FieldError
from .parameters import Model
from .records import Record
from .residuals import grouped, residuals_of


def negative_log_likelihood(
    scene: Scene,
    start: State,
    record: Record,
    *,
    modes: Modes | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    max_steps: int | None = None,
    method: str = "auto",
) -> Float[Array, ""]:
    """Half of the sum of squared misfits over their deviations.

    For optax and the like: differentiable in forward and reverse mode by every float of
    the scene, the start and the modes; can be jitted and vmapped over them. A run that
    cannot go on counts as misfit.

    Args:
        scene: The model.
        start: State at the record's ``start_time``; of a body with explicit contact
            coordinates the contact on the body is where its orientation has it.
        record: What was measured; its channels have sigma. It is known, not traced.
        modes: How the contact may change in the run.
        rtol: Relative tolerance of the run [1]; see :func:`rollkane.simulate`.
        atol: Absolute tolerance.
        max_steps: Most steps of the run.
        method: Of the run.

    Returns:
        The negative logarithm of the likelihood, without its constant [1].

    Raises:
        FieldError: no scene, a channel without sigma, a start that does not belong to
            the scene.
    """
    require_scene("negative_log_likelihood.scene", scene)
    for name, channel in record.channels.items():
        if channel.sigma is None:
            field = f"Record.channels[{name!r}].sigma"
            raise FieldError(field, None, "is missing", "give the noise's deviation")
    groups = grouped(record, (), {})
    everything = tuple(jnp.ones(np.shape(g.time), bool) for g in groups)
    start = with_contact_found(scene, record.start_time, start)
    model = Model(scene, start, record.start_time, modes, record.channels)
    options = RunOptions(rtol, atol, max_steps, method)
    found = residuals_of(model, groups, everything, options)
    return 0.5 * jnp.sum(found.misfit**2)
