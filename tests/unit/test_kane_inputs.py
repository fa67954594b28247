"""Derivatives by parameters that a configuration looks at: what depends, follows."""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import rollkane as rk
from rollkane import kane
from rollkane.geometry.rotations import about_axis
from rollkane.kane.closure import bound_start

from ..quick import slow_but

# Of central differences: errors of STEP^2 = 1e-10 times a sixth of third derivatives,
# up to some thousand (of lengths above 0.3), and of roundings, 1e-14 / STEP of rates
# up to a hundred, 1e-7
STEP, DIFFERENCES = 1e-5, 1e-6


class Case(NamedTuple):
    """A system, coordinates that its dependent ones are about, and the rest."""

    system: kane.KaneSystem
    q: Any
    u: Any
    time: float = 0.0


def kept(configuration):
    """The rate of a configuration, of kinematics ``q' = u``."""

    def constraints(t, q, u, p):
        value = lambda t, q: jnp.stack(configuration(t, q, u, p))
        return jax.jvp(value, (t, q), (jnp.ones_like(t), u))[1]

    return constraints


def mechanism(configuration, dependent, by_multipliers=False, **given):
    count = 1 + max(dependent)
    return kane.KaneSystem(
        count,
        count,
        lambda t, q, u: u,
        constraints=kept(configuration),
        dependent=None if by_multipliers else dependent,
        configuration=configuration,
        dependent_coordinates=dependent,
        **given,
    )


def flywheel(k, inertia):
    """A body that turns with the k-th speed."""
    still = lambda t, q, u: [0.0, 0.0, 0.0]
    turning = lambda t, q, u: [0.0, 0.0, u[k]]
    return kane.RigidBody(1.0, inertia * np.eye(3), still, turning)


CRANK, MASS, INERTIA = {"l": 1.0, "r": 0.4, "k": 20.0}, 2.0, 0.3


def rod_of_length(t, q, u, p):
    x, y = q[1] - p["r"] * jnp.cos(q[0]), p["r"] * jnp.sin(q[0])
    return [x * x + y * y - p["l"] ** 2]


@functools.cache
def slider_crank(by_multipliers=False):
    """A crank's angle, and the place of the slider that its rod moves."""
    system = mechanism(
        rod_of_length,
        (1,),
        by_multipliers,
        parts=[
            kane.Particle(MASS, lambda t, q, u: [u[1], 0.0, 0.0]),
            flywheel(0, INERTIA),
        ],
        generalized_forces=lambda t, q, u, p: [0.0 * u[0], -p["k"] * (q[1] - 1.2)],
        parameters=CRANK,
    )
    return Case(system, [0.7, 1.27], [0.6, -0.2] if by_multipliers else [0.6])


def four_bars(t, q, u, p):
    x = p["r"] * jnp.cos(q[0]) + p["l"] * jnp.cos(q[1]) - p["s"] * jnp.cos(q[2])
    y = p["r"] * jnp.sin(q[0]) + p["l"] * jnp.sin(q[1]) - p["s"] * jnp.sin(q[2])
    return [x - p["d"], y]


def middle_of_the_coupler(t, q, u, p):
    x = -p["r"] * jnp.sin(q[0]) * u[0] - 0.5 * p["l"] * jnp.sin(q[1]) * u[1]
    y = p["r"] * jnp.cos(q[0]) * u[0] + 0.5 * p["l"] * jnp.cos(q[1]) * u[1]
    return [x, y, 0.0]


@functools.cache
def four_bar():
    system = mechanism(
        four_bars,
        (1, 2),
        parts=[
            kane.Particle(1.5, middle_of_the_coupler),
            flywheel(0, 0.2),
            flywheel(2, 0.4),
        ],
        loads=[kane.Load(middle_of_the_coupler, lambda t, q, u: [0.0, -9.81, 0.0])],
        generalized_forces=lambda t, q, u, p: [
            0.3 * u[1],
            0.0 * u[1],
            -p["k"] * (q[2] - 1.0),
        ],
        parameters={"r": 0.5, "l": 1.2, "s": 0.9, "d": 1.1, "k": 5.0},
    )
    return Case(system, [0.8, 0.2, 1.2], [1.1])


def on_a_turning_rod(t, q, u, p):
    return [jnp.cos(p["W"] * t) * q[1] - jnp.sin(p["W"] * t) * q[0]]


@functools.cache
def turning_rod():
    """A particle on a rod that turns with time, at a rate that is an input."""
    velocity = lambda t, q, u: [u[0], u[1], 0.0]
    pull = lambda t, q, u, p: [-p["k"] * q[0], -p["k"] * q[1], 0.0]
    system = mechanism(
        on_a_turning_rod,
        (1,),
        parts=[kane.Particle(lambda p: p["m"], velocity)],
        loads=[kane.Load(velocity, pull)],
        parameters={"W": 1.3, "m": 2.0, "k": 1.0},
    )
    return Case(system, [0.5, 0.6], [0.2], 0.7)


def turned(q):
    return about_axis(0, q[3]) @ about_axis(1, q[4])


def turning(t, q, u):
    first = about_axis(1, q[4]).T @ jnp.array([1.0, 0.0, 0.0])
    return first * u[3] + jnp.array([0.0, 1.0, 0.0]) * u[4]


def centre(t, q, u, p):
    return q[:3] + turned(q) @ jnp.stack([0.0, 0.0, p["e"]])


def bowl(x, y):
    return 0.3 * x**2 + 0.5 * y**2


@functools.cache
def rolling_ball():
    """In a bowl that inputs turn and lift; its mass centre is beside its own by one."""
    velocity, p = lambda t, q, u: u[:3], {"e": 0.1, "slope": 0.2, "lift": 0.05}
    body = kane.RigidBody(1.5, np.diag([0.05, 0.06, 0.04]), velocity, turning)
    weight = kane.Load(velocity, lambda t, q, u: [0.0, 0.0, -9.81 * 1.5])
    kinematics = lambda t, q, u: u
    system = kane.KaneSystem(5, 5, kinematics, [body], [weight], parameters=p)
    ball = kane.Frame(centre, lambda t, q, u: turned(q))
    ground = kane.Frame(
        lambda t, q, u, p: [0.0, 0.0, p["lift"]],
        lambda t, q, u, p: about_axis(1, p["slope"]),
    )
    touching = kane.RollingContact(ball, rk.Sphere(0.3), ground, rk.Graph(bowl))
    q, u = [0.4, -0.1, 0.2, 0.3, 0.5], [0.0, 0.0, 0.0, 0.7, -0.4]
    rolling = kane.rolling_contacts(system, [touching], q, u)
    state = rolling.eliminated_state(rolling.start)
    return Case(rolling.eliminated, state.q, state.u)


CASES = {
    "slider-crank": slider_crank,
    "four-bar": four_bar,
    "turning rod": turning_rod,
    "rolling ball": rolling_ball,
}


@eqx.filter_jit
def closed(system, t, q):
    """Coordinates whose dependent ones fulfil the configuration, by Newton's method."""
    bound = np.asarray(system.dependent_coordinates)
    rest = jnp.zeros(system.speeds)
    held = lambda q: system.at(system.configuration, t, q, rest)
    for _ in range(8):  # from a tenth away; next to it two would do
        q = q.at[bound].add(-jnp.linalg.solve(jax.jacfwd(held)(q)[:, bound], held(q)))
    return q


@eqx.filter_jit
def rates(case, parameters, x):
    """Rates of the independent ones, x beside a state; the others have to follow."""
    system = eqx.tree_at(lambda s: s.parameters, case.system, parameters)
    free = np.asarray(system.independent_coordinates)
    t, q = jnp.asarray(case.time), jnp.asarray(case.q, float)
    q = closed(system, t, q.at[free].add(x[: len(free)]))
    u = jnp.asarray(case.u, float) + x[len(free) :]
    dot = kane.kane_derivative(system, t, kane.KaneState(q, u))
    return jnp.concatenate([dot.q[free], dot.u])


def differences(function, x):
    """Central ones, a column for each of x."""
    steps = STEP * np.eye(len(x))
    columns = [(function(x + d) - function(x - d)) / (2 * STEP) for d in steps]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("name", slow_but(set(CASES) - {"rolling ball"}, CASES))
def test_inputs_move_all_that_depends_on_them(name):
    """B was that of dependent coordinates which stay: off the configuration."""
    case = CASES[name]()
    system, t = case.system, jnp.asarray(case.time)
    q, u = closed(system, t, jnp.asarray(case.q, float)), jnp.asarray(case.u, float)
    state = kane.KaneState(q, u)
    found = kane.linearize(system, case.time, state, inputs=lambda p: p)
    r, unravel = ravel_pytree(system.parameters)
    x = jnp.zeros(found.f.shape)
    by_state = differences(lambda x: rates(case, unravel(r), x), x)
    by_inputs = differences(lambda r: rates(case, unravel(r), x), r)
    close = functools.partial(
        np.testing.assert_allclose, rtol=DIFFERENCES, atol=DIFFERENCES
    )
    close(found.A, by_state)
    close(found.B, by_inputs)
    # inputs change nothing of the others: roundings of another program
    alone = kane.linearize(system, case.time, state)
    for of, right in ((found.A, alone.A), (found.f, alone.f)):
        np.testing.assert_allclose(of, right, rtol=1e-13, atol=1e-13)
    some = kane.linearize(
        system, case.time, state, q_ind=(), inputs=lambda p: sorted(p.items())[0][1]
    )
    moved = np.delete(by_inputs, np.s_[: len(system.independent_coordinates)], axis=0)
    close(some.B, moved[:, :1])


def test_a_slider_crank_by_its_lengths():
    """Of ``(J + m x'^2) a'' = -x' (m x'' w^2 + k (x - 1.2))`` with x(a, l, r)."""
    case, w = slider_crank(), 0.6

    def place(a, l, r):
        return r * jnp.cos(a) + jnp.sqrt(l**2 - (r * jnp.sin(a)) ** 2)

    def acceleration(l, r, k):
        x, slope = jax.value_and_grad(place)(0.7, l, r)
        bend = jax.grad(jax.grad(place))(0.7, l, r)
        force = -slope * (MASS * bend * w**2 + k * (x - 1.2))
        return force / (INERTIA + MASS * slope**2)

    right = jnp.stack(jax.grad(acceleration, (0, 1, 2))(1.0, 0.4, 20.0))
    state = kane.KaneState(jnp.stack([0.7, place(0.7, 1.0, 0.4)]), jnp.array([w]))
    chosen = lambda p: (p["l"], p["r"], p["k"])
    linearized = lambda state: kane.linearize(case.system, 0.0, state, inputs=chosen)
    expected = np.stack([np.zeros(3), right])
    # derivatives of order ten by the same program but for its order
    np.testing.assert_allclose(linearized(state).B, expected, rtol=0, atol=1e-12)
    in_jit = jax.jit(lambda state: linearized(state).B)(state)
    np.testing.assert_allclose(in_jit, expected, rtol=0, atol=1e-12)
    # as rk.linearize has it, by Newton's method
    names = tuple(f"parameters.{name}" for name in "lrk")
    model = rk.linearize(case.system, state, inputs=names)
    np.testing.assert_allclose(model.B, expected, rtol=0, atol=1e-12)


# ---- runs from a start that does not change with the parameters ----------------------

RUNS = {
    "slider-crank": slider_crank,
    "slider-crank by multipliers": lambda: slider_crank(True),
    "turning rod": turning_rod,
}


def start_of(case, parameters):
    """The start of a case, on the configuration that parameters have."""
    system = eqx.tree_at(lambda s: s.parameters, case.system, parameters)
    q = closed(system, jnp.asarray(case.time), jnp.asarray(case.q, float))
    return kane.KaneState(q, jnp.asarray(case.u, float))


def end(case, parameters, start):
    system = eqx.tree_at(lambda s: s.parameters, case.system, parameters)
    times = case.time + jnp.array([0.0, 0.5])
    run = kane.simulate(system, start, times, rtol=1e-11)
    return jnp.concatenate([*run.state.q, *run.u])


@pytest.mark.parametrize("name", slow_but(["slider-crank"], RUNS))
def test_gradients_of_runs_keep_to_the_configuration(name):
    """They were those of motions beside it: by the length of a rod zero."""
    case = RUNS[name]()
    start = start_of(case, case.system.parameters)
    r, unravel = ravel_pytree(case.system.parameters)
    of_closed = jax.jit(lambda r: end(case, unravel(r), start_of(case, unravel(r))))
    right = differences(of_closed, r)
    assert np.abs(right).max() > 1.0
    for derivative in (jax.jacfwd, jax.jacrev):
        found = jax.jit(derivative(lambda r: end(case, unravel(r), start)))(r)
        # runs of a hundred steps to 1e-11 over 2 STEP beside the differences' own
        np.testing.assert_allclose(found, right, rtol=1e-5, atol=1e-4)
    # nothing is added where the start is given as a function of the parameters
    np.testing.assert_allclose(jax.jacfwd(of_closed)(r), found, rtol=0, atol=1e-7)


def lengths(l):
    return {**CRANK, "l": l}


def test_starts_of_traced_numbers_are_moved_to_the_configuration():
    """Where known ones are refused; they were runs of broken rods."""
    case = slider_crank()
    start = start_of(case, CRANK)
    run = jax.jit(jax.vmap(lambda l: end(case, lengths(l), start)))
    several = jnp.array([0.9, 1.0, 1.3])
    for l, found in zip(several, run(several), strict=True):
        right = end(case, lengths(l), start_of(case, lengths(l)))
        # the same start to roundings, and what a motion makes of them
        np.testing.assert_allclose(found, right, rtol=0, atol=1e-12)
    # and one that might be left, to the last bit
    beside = eqx.tree_at(lambda s: s.q, start, start.q.at[1].add(1e-12))
    alone = jax.jit(lambda l: end(case, lengths(l), beside))(jnp.asarray(1.0))
    np.testing.assert_array_equal(alone, end(case, CRANK, beside))


def test_linear_models_of_traced_numbers_are_those_on_the_configuration():
    """They were of a state beside it: derivatives of A by a length partial ones."""
    case = slider_crank()
    start = start_of(case, CRANK)

    def slope(l, state):
        system = eqx.tree_at(lambda s: s.parameters, case.system, lengths(l))
        return kane.linearize(system, 0.0, state).A[1, 0]

    several = jnp.array([0.9, 1.0, 1.3])
    along = jax.vmap(jax.value_and_grad(lambda l: slope(l, start)))
    of_closed = lambda l: slope(l, start_of(case, lengths(l)))
    for l, found, by_length in zip(several, *along(several), strict=True):
        # A of order ten by the same equations, at the same place to roundings
        np.testing.assert_allclose(found, of_closed(l), rtol=0, atol=1e-12)
        right = (of_closed(l + STEP) - of_closed(l - STEP)) / (2 * STEP)
        np.testing.assert_allclose(by_length, right, rtol=DIFFERENCES)


def test_starts_that_the_configuration_does_not_determine_stay():
    """A slider's place, as its rod is upright, or is not long enough to be there."""
    case, rtol = slider_crank(), jnp.asarray(1e-9)
    place = jax.jit(lambda q, l: bound_start(at(l), jnp.zeros(()), state(q), rtol).q)
    at = lambda l: eqx.tree_at(lambda s: s.parameters, case.system, lengths(l))
    state = lambda q: kane.KaneState(q, jnp.asarray(case.u))
    for q, l in (([np.pi / 2, 0.0], 0.4), ([np.pi / 2, 0.3], 0.2)):
        q, l = jnp.asarray(q), jnp.asarray(l)
        found = place(q, l)
        np.testing.assert_array_equal(found, q)
        assert np.isfinite(jax.jacfwd(place, argnums=(0, 1))(q, l)[1]).all()


def test_second_derivatives_keep_to_the_configuration():
    """Of the place x(a, l) of a slider, and its third: a step for each order."""
    case, rtol = slider_crank(), jnp.asarray(1e-9)
    start = start_of(case, CRANK)

    def found(l):
        system = eqx.tree_at(lambda s: s.parameters, case.system, lengths(l))
        return bound_start(system, jnp.zeros(()), start, rtol).q[1]

    def right(l):
        height = CRANK["r"] * jnp.sin(0.7)
        return CRANK["r"] * jnp.cos(0.7) + jnp.sqrt(l**2 - height**2)

    for _ in range(3):
        found, right = jax.grad(found), jax.grad(right)
        # derivatives of order one
        np.testing.assert_allclose(found(1.0), right(1.0), rtol=0, atol=1e-13)
