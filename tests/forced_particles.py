"""Three particles on lines, under a force of the user's, by either loop."""

import jax
import jax.numpy as jnp
import numpy as np

from rollkane import kane
from rollkane.codegen import in_one_program
from rollkane.codegen.evaluation import evaluated


def both(function, x):
    """What it gives by a walk of single numbers, and by a program in C."""
    in_c = jax.jit(lambda x: in_one_program(function, x))
    return evaluated(function, x), in_c(x)


def assert_native_is_diffrax(force, parameters, end):
    """Where the particles come to, and its derivatives, are the same by both loops.

    Args:
        force: ``force(q, parameters)`` -> on the three coordinates.
        parameters: Array.
        end: Of the run [s]: some twenty steps.
    """

    def along(k):
        return lambda t, q, u: [u[k], 0.0, 0.0]

    def ended(parameters, method):
        system = kane.KaneSystem(
            *(3, 3, lambda t, q, u: u),
            [kane.Particle(1.0, along(k)) for k in range(3)],
            generalized_forces=lambda t, q, u, p: force(q, p),
            parameters=parameters,
        )
        start = kane.KaneState(jnp.array([0.4, -0.2, 0.3]), jnp.zeros(3))
        run = kane.simulate(system, start, (0.0, end), rtol=1e-11, method=method)
        return run.q[-1]

    for of in (ended, jax.jacfwd(ended), jax.jacrev(ended)):
        native, other = of(parameters, "native"), of(parameters, "diffrax")
        # some twenty steps, each wrong by 1e-11 of a size of one, by either loop
        np.testing.assert_allclose(native, other, atol=2 * 20 * 1e-11)
