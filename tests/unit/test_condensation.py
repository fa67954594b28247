"""Coordinates eliminated part by part, against one system for all of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen.dependence import reached_numbers
from rollkane.dynamics.condensation import condensed, condenses
from rollkane.dynamics.contact_laws import accelerations
from rollkane.dynamics.coordinate_functions import Apart
from rollkane.dynamics.mass_matrix import assemble
from rollkane.dynamics.momentum import momentum_rate
from rollkane.dynamics.rolling import contact_of

from ..quick import slow_but

LEVEL = np.array([0.9, 0.3, -0.2, 0.1]) / np.sqrt(0.95)
RNG = np.random.default_rng(20)
BODY = rk.Body(1.0, 0.01 * np.diag([1.0, 1.2, 0.9]), rk.Ellipsoid((0.2, 0.15, 0.1)))
PLACES, RAILS = RNG.normal(size=(2, 5, 3)) * 0.05
PLANES = RNG.normal(size=(2, 5, 3)) * 0.7


def springs(a):
    return 5.0 * jnp.sum(a * a) + 0.3 * a[0] * a[1]


def damped(t, a, a_dot):
    return -0.1 * a_dot + 0.2 * jnp.sin(t) * a[::-1]


def on_rails(a, rails):
    """Curved ones: places, partial derivatives and biases all count."""
    return PLACES + a[:, None] * rails + (a * a)[:, None] * rails[:, ::-1]


def on_planes(a):
    x = a.reshape(5, 2)
    return PLACES + x[:, :1] * PLANES[0] + jnp.sin(x[:, 1:]) * PLANES[1]


def on_planes_by_axis(a):
    return PLACES + a[:5, None] * PLANES[0] + jnp.sin(a[5:, None]) * PLANES[1]


def free(a):
    return PLACES[:2] + a.reshape(2, 3) + 0.3 * a.reshape(2, 3)[:, ::-1] ** 2


def masses(position, count, n, **functions):
    return rk.PointMasses(
        0.05 + 0.1 * RNG.random(count), position, coordinates=n, **functions
    )


def pendulum(arm):
    def rotation(a):
        c, s, zero = jnp.cos(a[0]), jnp.sin(a[0]), 0.0 * a[0]
        return jnp.array([[c, -s, zero], [s, c, zero], [zero, zero, 1.0 + zero]])

    position = lambda a: (
        0.05 * jnp.stack([jnp.cos(a[0]), jnp.sin(a[0]), arm + 0 * a[0]])
    )
    return rk.SupportedBody(0.2, 1e-3 * np.diag([1, 2, 2.5]), position, rotation)


SCENES = {
    "rails": (masses(on_rails, 5, 5, parameters=RAILS, force=damped),),
    "planes": (masses(on_planes, 5, 10, potential=springs),),
    "planes by axis": (masses(on_planes_by_axis, 5, 10),),
    "free in space": (masses(free, 2, 6),),
    "many parts": (
        pendulum(0.2),
        rk.Prescribed(
            masses(lambda a: a[:, None] * RAILS[:1], 1, 1), lambda t: t[None]
        ),
        masses(on_rails, 5, 5, parameters=RAILS, potential=springs),
        masses(lambda a: a[0] * RAILS, 5, 1),
    ),
}


def swaying(t):
    return jnp.stack([0.1 * jnp.sin(3.0 * t), 0.0 * t, 0.05 * t * t])


def moved(name):
    """A scene on a moving ground with a control law, and some state of it."""
    ground = rk.Graph(lambda x, y: 0.3 * x**2 + 0.1 * y**2)
    scene = rk.Scene(
        BODY, rk.Base(ground, rk.BaseMotion(swaying)), supported=SCENES[name]
    )
    n = sum(part.count for part in scene.supported)
    law = lambda t, state: jnp.linspace(-1.0, 1.0, 3 + n) * (t + state.alpha[0])
    own = {"alpha": RNG.normal(size=n) * 0.1, "alpha_dot": RNG.normal(size=n)}
    turn = np.array([0.3, 1.0, -0.5])
    start = rk.place(scene, LEVEL, turn, [0.1, 0.0, 0.003], time=0.7, **own)
    return rk.with_feedback(scene, law), start


@pytest.mark.parametrize("name", slow_but(["planes by axis", "free in space"], SCENES))
def test_one_system_gives_the_same(name):
    scene, state = moved(name)
    assert condenses(scene)

    @jax.jit
    def both(scene, t, state):
        contact = contact_of(scene, t, state)
        found = condensed(scene, t, state, contact)
        system = assemble(scene, t, state, contact)
        solution = accelerations(scene, t, contact, system)
        force = momentum_rate(scene, contact, system).force(solution)
        pairs = zip(found.solution[:2], solution[:2], strict=True)
        return [*pairs, (found.force(scene, contact), force)]

    for one, other in both(scene, jnp.asarray(0.7), state):
        # some 200 roundings of sums, times the mass matrix's condition of some 1e3
        scale = np.max(np.abs(other))
        np.testing.assert_allclose(one, other, rtol=0, atol=5e-11 * scale)


def test_runs_are_native_and_keep_their_energy():
    part = masses(on_rails, 5, 5, parameters=RAILS, potential=springs)
    scene = rk.Scene(BODY, supported=part)
    rest = {"alpha": np.zeros(5), "alpha_dot": RNG.normal(size=5)}
    start = rk.place(scene, [1, 0, 0, 0], [0.5, 1.0, 2.0], [0.0, 0.0, 0.0], **rest)
    run = rk.simulate(scene, start, (0.0, 2.0), rtol=1e-12)
    assert run.method == "native"
    energy = np.asarray(run.energy)
    # some thousand steps of 1e-12 of the velocities
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_the_program_does_not_grow_with_the_masses():
    def equations(count):
        rails = np.ones((count, 3)) * 0.1
        part = rk.PointMasses(
            np.ones(count), lambda a, p: p + a[:, None] * p, None, None, rails, count
        )
        scene = rk.Scene(BODY, supported=part)
        rest = {"alpha": np.zeros(count), "alpha_dot": np.zeros(count)}
        start = rk.place(scene, [1, 0, 0, 0], [0.5, 1, 2], [0, 0, 0], **rest)
        program = jax.make_jaxpr(rk.rolling_derivative)(scene, 0.0, start)
        return len(program.eqns)

    assert equations(40) == equations(20)


def test_what_moves_what_is_read_off_the_program():
    lone = lambda function, n, k=5: masses(function, k, n).apart
    assert lone(on_planes, 10) == Apart(2, 5, by_mass=True)
    assert lone(on_planes_by_axis, 10) == Apart(2, 5, by_mass=False)
    assert lone(free, 6, 2) == Apart(3, 2, by_mass=True)
    # one mass is moved by its neighbour's coordinate, and seldom
    tied = lambda a: PLACES + (a + jnp.where(a[0] > 5.0, a[0], 0.0))[:, None] * RAILS
    assert lone(tied, 5) is None
    chain = lambda a: PLACES + jnp.cumsum(a)[:, None] * RAILS
    assert lone(chain, 5) is None
    # what multiplies a coordinate may be changed later: it is no known zero
    mixed = lambda a, p: PLACES + (p @ a)[:, None] * RAILS
    assert masses(mixed, 5, 5, parameters=np.eye(5)).apart is None
    assert lone(lambda a: PLACES + (np.eye(5) @ a)[:, None] * RAILS, 5) is not None


def test_a_lookup_depends_on_the_table_and_the_index():
    def looked(x, given):
        which = jnp.clip(x[2], 0.0, 1.0).astype(int)
        return jax.lax.dynamic_slice(x, (which,), (1,)) * given

    reached = reached_numbers(looked, 4, jnp.ones(()))
    assert reached.tolist() == [[True, True, True, True]]


LAWS = {"slipping": rk.Slipping(rk.CoulombFriction(0.1)), "rubber": rk.RubberRolling()}


@pytest.mark.parametrize("law", LAWS)
def test_other_contact_laws_are_solved_in_one_system(law):
    scene = rk.Scene(BODY, supported=SCENES["rails"], contact=LAWS[law])
    assert not condenses(scene)
