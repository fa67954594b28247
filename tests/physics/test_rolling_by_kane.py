"""Bodies that roll on bodies, by contacts between free bodies: a third way."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane

from ..pairs_by_kane import by_kane, origins
from ..quick import slow_but
from ..random_pairs import CHAOTIC, KINDS, SEEDS, Pairs


def differences(kind, seed, span):
    """Of the places of all bodies [m], and the system with its run."""
    pairs = Pairs(kind, seed)
    times = np.linspace(0.0, span, 6)
    nested = rk.simulate(pairs.scene, pairs.start, times, rtol=1e-12)
    assert nested.code == rk.Code.COMPLETED
    rolling = by_kane(pairs, nested)
    assert not rolling.redundant
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-12)
    assert run.succeeded, run.reason
    seen = [pairs.motion_of(nested, path) for path in pairs.paths]
    off = np.abs(origins(pairs, run) - [motion.position for motion in seen]).max()
    return off, rolling, run, [motion.contact_force for motion in seen]


# a tilted cavity, a ground that turns, an edge; each compiles for half a minute
QUICK = ()  # each compiles for half a minute


@pytest.mark.parametrize("kind", slow_but(QUICK, KINDS))
def test_contacts_of_free_bodies_agree(kind):
    # as for the twin by Newton's equations
    assert differences(kind, 0, 1.0)[0] < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("turn", range(2))
@pytest.mark.parametrize("kind", KINDS)
def test_contacts_of_free_bodies_agree_for_five_seconds(kind, turn):
    seed = SEEDS.get(kind, range(1, 5))[turn]
    off, rolling, run, forces = differences(kind, seed, CHAOTIC.get(kind, 5.0))
    assert off < 1e-9
    # forces are as exact as places times the square of a rate of some 10 / s; of the
    # largest
    found = np.asarray(rolling.forces(run.time, run.state).force)
    error = np.abs(np.swapaxes(found, 0, 1) - np.asarray(forces)).max()
    assert error < 1e-7 * np.abs(found).max()


def test_masses_of_a_scene_are_parameters_of_its_system():
    """Of the body and of what it carries: by the core's own derivatives."""
    part = rk.SupportedBody(
        0.5,
        np.diag([0.002, 0.003, 0.004]),
        lambda a: jnp.stack([0.0 * a[0], 0.05 + a[0], 0.02 + 0.0 * a[0]]),
        lambda a: jnp.eye(3) + 0.0 * a[0],
        coordinates=1,
    )
    solid = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1), (0.0, 0.02, 0.01))
    scene = rk.Scene(solid, supported=part)
    rest = {"alpha": [0.01], "alpha_dot": [0.3]}
    state = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (1.0, 5.0, 2.0), np.zeros(3), **rest)
    system = kane.rolling_system(scene, state)
    chosen = lambda s: (s.body.mass, s.body.inertia, s.supported[0].mass)
    found = kane.linearize(system, 0.0, kane.kane_state(state), inputs=chosen).B

    def rates(numbers):
        changed = eqx.tree_at(chosen, scene, numbers)
        dot = rk.rolling_derivative(changed, 0.0, state)
        return jnp.concatenate([dot.angular_velocity, dot.alpha_dot])

    columns = jax.jacfwd(rates)(chosen(scene))
    right = jnp.concatenate([x.reshape(4, -1) for x in columns], axis=1)
    # an inertia is symmetric: of two entries the system may use either
    np.testing.assert_allclose(found[-4:, [0, 1, 5, 9, 10]], right[:, [0, 1, 5, 9, 10]],
                               rtol=1e-9, atol=1e-10)  # fmt: skip
