"""Kane systems: what is refused, and what can be done with what is not."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.validation.checks import FieldError

G = 9.81


def swing(t, q, u, p):
    """Velocity of a pendulum's mass; its rod's length is the parameter."""
    return p["length"] * u[0] * jnp.stack([jnp.cos(q[0]), jnp.sin(q[0]), 0.0 * q[0]])


def weight(t, q, u):
    return jnp.array([0.0, -G, 0.0])


def motor(t, q, u, p):
    return p["torque"] * jnp.array([0.0, 0.0, 1.0])


def spin(t, q, u):
    return jnp.array([0.0, 0.0, 1.0]) * u[0]


def pendulum(length=1.0, torque=0.0, **changed):
    arguments = {
        "coordinates": 1,
        "speeds": 1,
        "kinematics": lambda t, q, u: u,
        "parts": [kane.Particle(1.0, swing)],
        "loads": [kane.Load(swing, weight), kane.Load(spin, motor)],
        "parameters": {"length": length, "torque": torque},
    }
    return kane.KaneSystem(**{**arguments, **changed})


def state(q, u):
    return kane.KaneState(jnp.atleast_1d(jnp.asarray(q, float)), jnp.atleast_1d(u))


plane = lambda t, q, u: [u[0], u[1], 0.0]
POINT = kane.Particle(1.0, plane)


def in_plane(**changed):
    """A particle in a plane."""
    arguments = {
        "coordinates": 2,
        "speeds": 2,
        "kinematics": lambda t, q, u: u,
        "parts": [POINT],
    }
    return kane.KaneSystem(**{**arguments, **changed})


def at_rest(system):
    return kane.KaneState(
        jnp.zeros(system.coordinates), jnp.zeros(len(system.independent))
    )


REFUSED = {
    "kinematics of another shape": (
        lambda: in_plane(kinematics=lambda t, q, u: u[:1]),
        r"KaneSystem.kinematics: returns shape \(1,\).*\(2,\)",
    ),
    "a velocity of another shape": (
        lambda: in_plane(parts=[POINT, kane.Particle(1.0, lambda t, q, u: u)]),
        r"KaneSystem.parts\[1\].velocity: returns shape \(2,\)",
    ),
    "a function of two arguments": (
        lambda: in_plane(kinematics=lambda t, q: q),
        r"KaneSystem.kinematics: has a signature.*\(t, q, u\)",
    ),
    "no function": (
        lambda: in_plane(parts=[kane.Particle(1.0, jnp.zeros(3))]),
        r"KaneSystem.parts\[0\].velocity: must be a function",
    ),
    "a function of NumPy": (
        lambda: in_plane(kinematics=lambda t, q, u: np.sin(np.asarray(u))),
        "KaneSystem.kinematics: cannot be traced by JAX",
    ),
    "no mass": (
        lambda: in_plane(parts=[kane.Particle(0.0, plane)]),
        r"KaneSystem.parts\[0\].mass: must be.*0",
    ),
    "an inertia that no body has": (
        lambda: in_plane(
            parts=[kane.RigidBody(1.0, np.diag([1.0, 1.0, 3.0]), plane, plane)]
        ),
        r"KaneSystem.parts\[0\].inertia",
    ),
    "no part": (lambda: in_plane(parts=[3.0]), r"KaneSystem.parts\[0\]: is no part"),
    "no load": (
        lambda: in_plane(loads=[weight]),
        r"KaneSystem.loads\[0\]: is no load",
    ),
    "a force of another shape": (
        lambda: in_plane(loads=[kane.Load(plane, lambda t, q, u: u)]),
        r"KaneSystem.loads\[0\].load: returns shape \(2,\)",
    ),
    "dependent speeds that are not there": (
        lambda: in_plane(constraints=lambda t, q, u: u[:1], dependent=(2,)),
        "KaneSystem.dependent: must be different numbers.*from 0 to 1",
    ),
    "dependent speeds without constraints": (
        lambda: in_plane(dependent=(1,)),
        "KaneSystem.dependent: are not determined by anything",
    ),
    "a configuration that determines nothing": (
        lambda: in_plane(configuration=lambda t, q, u: q[:1], dependent=None),
        "KaneSystem.dependent_coordinates: does not say what configuration determines",
    ),
    "more constraints than dependent speeds": (
        lambda: in_plane(constraints=lambda t, q, u: u, dependent=(1,)),
        r"KaneSystem.dependent: has 1 for the 2 rows that constraints returns.*\(1,\)",
    ),
    "forces for some of the speeds": (
        lambda: in_plane(generalized_forces=lambda t, q, u: u[:1]),
        "KaneSystem.generalized_forces: returns shape",
    ),
    "a start of another kind": (
        lambda: kane.simulate(in_plane(), [0.0], [0.0, 1.0]),
        "simulate.start: must be a KaneState",
    ),
    "a start of another shape": (
        lambda: kane.simulate(
            in_plane(), kane.KaneState(jnp.zeros(2), jnp.zeros(3)), [0.0, 1.0]
        ),
        r"simulate.start.u: must have shape \(2,\)",
    ),
    "dependent constraints": (
        lambda: kane.simulate(
            in_plane(
                constraints=lambda t, q, u: [u[0] + u[1], 2.0 * (u[0] + u[1])],
                dependent=(0, 1),
            ),
            kane.KaneState(jnp.zeros(2), jnp.zeros(0)),
            [0.0, 1.0],
        ),
        r"KaneSystem.constraints: do not determine.*t = 0, q = \[0.0, 0.0\]",
    ),
    "singular kinematics": (
        lambda: kane.simulate(
            in_plane(kinematics=lambda t, q, u: [u[0] / q[1], u[1]]),
            kane.KaneState(jnp.zeros(2), jnp.ones(2)),
            [0.0, 1.0],
        ),
        r"KaneSystem.kinematics: are singular at t = 0, q = \[0.0, 0.0\]",
    ),
    "a speed that moves no mass": (
        lambda: kane.simulate(
            in_plane(parts=[kane.Particle(1.0, lambda t, q, u: [u[0], 0.0, 0.0])]),
            kane.KaneState(jnp.zeros(2), jnp.ones(2)),
            [0.0, 1.0],
        ),
        "KaneSystem.parts: make a mass matrix that is not positive definite",
    ),
    "a velocity with squared speeds": (
        lambda: kane.simulate(
            in_plane(
                parts=[kane.Particle(1.0, lambda t, q, u: [u[0] ** 2, u[1], 0.0])]
            ),
            kane.KaneState(jnp.zeros(2), jnp.ones(2)),
            [0.0, 1.0],
        ),
        r"KaneSystem.parts\[0\].velocity: is not affine in the speeds",
    ),
    "linearizing by a dependent speed": (
        lambda: kane.linearize(
            in_plane(constraints=lambda t, q, u: u[:1] - u[1:], dependent=(1,)),
            0.0,
            kane.KaneState(jnp.zeros(2), jnp.zeros(1)),
            u_ind=(1,),
        ),
        r"linearize.u_ind: names dependent ones.*\(0,\)",
    ),
    "inputs without parameters": (
        lambda: kane.linearize(in_plane(), 0.0, at_rest(in_plane()), inputs=len),
        "linearize.inputs: has no parameters",
    ),
    "inputs that are computed": (
        lambda: kane.linearize(
            pendulum(0.7, 0.3), 0.0, state(0.4, 0.9), inputs=lambda p: 2 * p["torque"]
        ),
        "linearize.inputs: does not return entries.*return whole ones",
    ),
    "inputs that are not there": (
        lambda: kane.linearize(
            pendulum(0.7, 0.3), 0.0, state(0.4, 0.9), inputs=lambda p: p["none"]
        ),
        r"linearize.inputs: does not return entries.*\(KeyError\)",
    ),
    "another choice of speeds": (
        lambda: kane.rolling_disc(1.0, 1.0, (0.25, 0.5), "euler"),
        "rolling_disc.speeds: is no choice of speeds.*lean axes",
    ),
}


@pytest.mark.parametrize(("make", "words"), REFUSED.values(), ids=list(REFUSED))
def test_refused(make, words):
    with pytest.raises(FieldError, match=words):
        make()


def test_a_singular_place_on_the_way_ends_the_run():
    """q' = u / q: an end with a code and what was reached, no silent NaN."""
    system = in_plane(kinematics=lambda t, q, u: [u[0] / q[1], u[1]])
    start = kane.KaneState(jnp.array([0.0, 1.0]), jnp.array([1.0, -1.0]))
    run = kane.simulate(system, start, np.linspace(0.0, 2.0, 5), max_steps=10_000)
    assert run.code != rk.Code.COMPLETED
    assert run.reason
    assert not run.succeeded
    assert 0.9 < run.final_time < 1.1
    reached = run.time < run.final_time
    assert np.isfinite(np.asarray(run.q)[np.asarray(reached)]).all()


def test_equations_of_a_pendulum():
    """M = m l^2, forcing = -m g l sin q + torque."""
    found = kane.kane_equations(pendulum(0.7, 0.3), 0.0, jnp.array([0.4]), jnp.ones(1))
    force = -G * 0.7 * np.sin(0.4) + 0.3
    np.testing.assert_allclose(found.mass_matrix, [[0.49]], rtol=1e-15)
    np.testing.assert_allclose(found.fr, [force], rtol=1e-14)
    np.testing.assert_allclose(found.forcing, [force], rtol=1e-14)
    np.testing.assert_allclose(found.kinetic_energy, 0.5 * 0.49, rtol=1e-15)
    np.testing.assert_array_equal(found.q_dot, [1.0])


def test_linearization_equals_differences():
    system, at = pendulum(0.7, 0.3), state(0.4, 0.9)
    found = kane.linearize(system, 0.0, at, inputs=lambda p: p["torque"])
    np.testing.assert_allclose(
        found.A, [[0.0, 1.0], [-G / 0.7 * np.cos(0.4), 0.0]], atol=1e-13
    )
    np.testing.assert_allclose(found.B, [[0.0], [1.0 / 0.49]], atol=1e-13)
    np.testing.assert_allclose(
        found.f, [0.9, (-G * 0.7 * np.sin(0.4) + 0.3) / 0.49], rtol=1e-13
    )
    named = kane.linearize(system, 0.0, at, inputs=lambda p: {"by": p["torque"]})
    np.testing.assert_array_equal(named.B, found.B)
    in_jit = jax.jit(lambda x: kane.linearize(system, 0.0, x).A)
    np.testing.assert_allclose(in_jit(at), found.A, atol=1e-13)


def test_dependent_speeds_and_coordinates():
    """A bead on a circle of radius 2, in Cartesian coordinates: a pendulum."""
    system = in_plane(
        loads=[kane.Load(plane, weight)],
        constraints=lambda t, q, u: [q[0] * u[0] + q[1] * u[1]],
        dependent=(1,),
        configuration=lambda t, q, u: [0.5 * (q[0] ** 2 + q[1] ** 2 - 4.0)],
        dependent_coordinates=(1,),
    )
    angle, rate = 0.3, 0.8
    q = 2.0 * jnp.array([np.sin(angle), -np.cos(angle)])
    u = 2.0 * rate * np.array([np.cos(angle), np.sin(angle)])
    start = kane.KaneState(q, jnp.array(u[:1]))
    np.testing.assert_allclose(kane.all_speeds(system, 0.0, start), u, rtol=1e-14)
    acceleration = -G / 2.0 * np.sin(angle)
    x_ddot = 2.0 * (np.cos(angle) * acceleration - np.sin(angle) * rate**2)
    found = kane.kane_derivative(system, 0.0, start)
    np.testing.assert_allclose(found.u, [x_ddot], rtol=1e-12)
    # small motions about the lowest place: x'' = -(g / 2) x
    bottom = kane.KaneState(jnp.array([0.0, -2.0]), jnp.zeros(1))
    linear = kane.linearize(system, 0.0, bottom)
    np.testing.assert_allclose(linear.A, [[0.0, 1.0], [-G / 2.0, 0.0]], atol=1e-13)


def test_a_large_system_goes_to_lineax():
    """Nine equal masses on springs between walls, against the mass-spring matrix."""
    n, m, k = 9, 0.5, 3.0
    parts = [kane.Particle(m, lambda t, q, u, i=i: [u[i], 0.0, 0.0]) for i in range(n)]
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    chain = kane.KaneSystem(
        n, n, lambda t, q, u: u, parts, generalized_forces=lambda t, q, u: -K @ q
    )
    start = kane.KaneState(jnp.linspace(-1.0, 1.0, n), jnp.zeros(n))
    found = kane.kane_derivative(chain, 0.0, start)
    np.testing.assert_allclose(found.u, -K @ start.q / m, atol=1e-13)


def period_shift(length, torque):
    """Where the pendulum is after one second."""
    run = kane.simulate(
        pendulum(length, torque), state(0.4, 0.9), [0.0, 1.0], rtol=1e-10
    )
    return run.q[-1, 0]


def test_gradients_by_parameters_equal_differences():
    end = jax.jit(jax.value_and_grad(period_shift, argnums=(0, 1)))
    at, step = jnp.array([0.7, 0.3]), 1e-4
    gradient = np.array(end(*at)[1])
    for k, found in enumerate(gradient):
        change = step * np.eye(2)[k]
        difference = (end(*(at + change))[0] - end(*(at - change))[0]) / (2 * step)
        # the third derivative is of order ten: 1e-7; the solve: 1e-10 / 1e-4
        np.testing.assert_allclose(found, difference, rtol=1e-5)


def test_lanes_of_a_batch_are_single_runs():
    lengths = jnp.array([0.5, 0.7, 1.1])
    ends = jax.vmap(lambda length: period_shift(length, 0.3))(lengths)
    alone = [period_shift(length, 0.3) for length in lengths]
    np.testing.assert_allclose(ends, alone, rtol=1e-8)


def test_shared_quantities_stand_in_for_parameters():
    """What ``shared`` gives is evaluated for the functions, and differentiable."""

    def shared(t, q, u, p):
        return {"along": jnp.stack([jnp.cos(q[0]), jnp.sin(q[0]), 0.0 * q[0]]), **p}

    quick = lambda t, q, u, now: now["length"] * u[0] * now["along"]
    with_shared = pendulum(
        parts=[kane.Particle(1.0, quick)],
        loads=[kane.Load(quick, weight)],
        shared=shared,
    )
    plain = pendulum()
    for system in (with_shared, plain):
        found = kane.kane_derivative(system, 0.0, state(0.4, 0.9))
        np.testing.assert_allclose(found.u, [-G * np.sin(0.4)], rtol=1e-14)


def test_a_closure_over_a_traced_number_is_differentiated():
    def acceleration(length):
        swing = lambda t, q, u: (
            length * u[0] * jnp.stack([jnp.cos(q[0]), jnp.sin(q[0]), 0.0 * q[0]])
        )
        system = kane.KaneSystem(
            1,
            1,
            lambda t, q, u: u,
            [kane.Particle(1.0, swing)],
            [kane.Load(swing, weight)],
        )
        return kane.kane_derivative(system, 0.0, state(0.4, 0.9)).u[0]

    found = jax.grad(acceleration)(0.7)
    np.testing.assert_allclose(found, G / 0.49 * np.sin(0.4), rtol=1e-13)


def test_a_known_start_inside_jit_is_checked_all_the_same():
    """Known numbers in the middle of a trace: refused at once."""
    bad = in_plane(parts=[kane.Particle(1.0, lambda t, q, u: [u[0], 0.0, 0.0])])
    start = at_rest(bad)

    @jax.jit
    def run(x):
        return kane.simulate(bad, start, [0.0, 1.0]).q[-1] * x

    with pytest.raises(FieldError, match="not positive definite"):
        run(1.0)


def test_systems_of_one_kind_share_a_compilation():
    """A scene's system of other numbers is traced no second time."""
    traced = []

    @eqx.filter_jit
    def derivative(system, start):
        traced.append(1)
        return kane.kane_derivative(system, 0.0, start)

    for radius in (0.1, 0.2):
        body = rk.Body(1.0, 0.4 * radius**2 * np.eye(3), rk.Sphere(radius))
        scene = rk.Scene(body, loads=(rk.Gravity(),))
        start = rk.place(scene, [1.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0], np.zeros(3))
        found = derivative(kane.rolling_system(scene, start), kane.kane_state(start))
        np.testing.assert_allclose(found.u, 0.0, atol=1e-12)
    assert len(traced) == 1
