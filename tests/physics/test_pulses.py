"""Functions of time that jump: what is told of their kinks is not missed, nor wrong."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.validation.checks import FieldError

LEVEL, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
MASS, RADIUS = 2.0, 0.1
BALL = rk.Body(MASS, 0.4 * MASS * RADIUS**2 * np.eye(3), rk.Sphere(RADIUS))
BEGIN, LENGTH, END = 1.0, 1e-3, 3.0
KINKS = BEGIN, BEGIN + LENGTH
# Steps stay four numbers away from the pulse's ends, 2 x 4 x 2.2e-16 of a millisecond,
# and round a few more themselves.
CLOSE = 1e-11
# After the pulse a body of unit mass goes on at 1e-3 m/s for each newton.
WAY = LENGTH * (END - BEGIN - 0.5 * LENGTH)


def pulse(t, size):
    """A force along x for a millisecond."""
    on = (t >= KINKS[0]) & (t < KINKS[1])
    return jnp.stack([jnp.where(on, size, 0.0), 0.0 * t, 0.0 * t])


def push(t, point, size):
    del point
    return pulse(t, size)


def pushed(size, kinks=KINKS):
    force = rk.Force(push, parameters=size)
    return rk.Scene(BALL, loads=(rk.Gravity(), force), kinks=kinks)


def rolled(scene, **options):
    """Where a ball that was at rest comes to [m]; outputs tell nothing of the pulse."""
    start = rk.place(scene, LEVEL, STILL, STILL)
    run = rk.simulate(scene, start, (0.0, END), **options)
    return run.position[-1, 0]


@pytest.mark.parametrize(
    "options",
    [{"method": "native"}, {"method": "diffrax"}, {"modes": rk.Modes(friction=1e3)}],
    ids=["native", "diffrax", "modes"],
)
def test_a_pulse_on_a_body_at_rest_is_not_missed(options):
    """Alone, in a batch, and its derivatives: linear in the push."""

    def way(size):
        return rolled(pushed(size), **options)

    share = WAY / (1.4 * MASS)  # m + I / r^2
    assert float(way(500.0)) == pytest.approx(500.0 * share, rel=CLOSE)
    batch = jax.vmap(way)(jnp.array([1.0, 500.0]))
    np.testing.assert_allclose(batch, np.array([1.0, 500.0]) * share, rtol=CLOSE)
    assert float(jax.grad(way)(500.0)) == pytest.approx(share, rel=CLOSE)


def test_kinks_are_what_finds_it():
    """Without them the run is as if nothing pushed: what they are for."""
    assert float(rolled(pushed(500.0, None))) == 0.0


def test_a_motor_s_pulse_is_not_missed():
    """On a carried mass: its coordinate, and the reaction on the body."""

    def force(t, alpha, alpha_dot, size):
        return pulse(t, size)[:1] + 0.0 * alpha

    slider = rk.PointMasses(
        0.5,
        lambda alpha: jnp.stack([alpha[0], 0.0, 0.0])[None],
        force,
        parameters=3.0,
    )
    scene = rk.Scene(BALL, supported=slider, loads=(), kinks=KINKS)
    start = rk.place(scene, LEVEL, STILL, STILL, alpha=(0.0,), alpha_dot=(0.0,))
    run = rk.simulate(scene, start, (0.0, KINKS[1], END))
    assert run.succeeded
    # the slider's rate, then the ball's speed; it begins in the ball's centre
    whole = np.array([[0.5, 0.5], [0.5, 0.5 + 1.4 * MASS]])
    slid, _ = np.linalg.solve(whole, [3.0 * LENGTH, 0.0])
    # meanwhile it goes 3e-6 of 0.1 m, and what that changes goes with the square
    assert float(run.state.alpha_dot[1, 0]) == pytest.approx(slid, rel=3e-9)


def test_a_base_s_kinks_and_the_scene_s_are_one():
    """A base that starts off later, and a pulse; each moves the ball by itself."""
    late = 2.0

    def place(t):
        away = jnp.maximum(t - late, 0.0)
        return jnp.stack([0.5 * away**2, 0.0 * t, 0.0 * t])

    still = pushed(500.0)
    base = rk.Base(motion=rk.BaseMotion(place, kinks=[late]))
    both = rk.Scene(BALL, base, loads=still.loads, kinks=KINKS)
    share = 0.4 / 1.4  # I / (I + m r^2) of the base's motion is taken on
    wanted = 500.0 * WAY / (1.4 * MASS) + share * 0.5 * (END - late) ** 2
    assert float(rolled(both)) == pytest.approx(wanted, rel=CLOSE)


def test_an_ensemble_has_them():
    scenes = [pushed(1.0), pushed(500.0)]
    start = rk.place(scenes[0], LEVEL, STILL, STILL)
    many = rk.ensemble(scenes, start, (0.0, END))
    assert many.method == "native"
    ended = np.asarray(many.state.contact_on_base)[:, -1, 0]
    share = WAY / (1.4 * MASS)
    np.testing.assert_allclose(ended, np.array([1.0, 500.0]) * share, rtol=CLOSE)


def particle(size, kinks=KINKS):
    def velocity(t, q, u):
        return [u[0], 0.0, 0.0]

    return kane.KaneSystem(
        1,
        1,
        lambda t, q, u: u,
        [kane.Particle(MASS, velocity)],
        [kane.Load(velocity, lambda t, q, u, p: pulse(t, p))],
        parameters=size,
        kinks=kinks,
    )


HELD = {
    "floor": lambda t, h, count: jnp.floor(t / h).astype(int),
    "rounded": lambda t, h, count: jnp.round(t / h - 0.5).astype(int),
    "counted": lambda t, h, count: jnp.sum(t >= h * np.arange(1, count)),
}


@pytest.mark.parametrize("law", HELD)
@pytest.mark.parametrize(
    "h", [0.1, *(pytest.param(h, marks=pytest.mark.slow) for h in (0.02, 1.0 / 3.0))]
)
def test_a_force_that_is_held_from_sample_to_sample(law, h):
    """Whichever way the sample of a time is found: it rounds, beside the jump, too."""
    count = 9
    end = count * h

    def velocity(t, q, u):
        return [u[0], 0.0, 0.0]

    def held(t, q, u, forces):
        number = jnp.clip(HELD[law](t, h, count), 0, count - 1)
        return [forces[number], 0.0, 0.0]

    def way(forces):
        system = kane.KaneSystem(
            *(1, 1, lambda t, q, u: u, [kane.Particle(1.0, velocity)]),
            [kane.Load(velocity, held)],
            parameters=forces,
            kinks=h * np.arange(1, count),
        )
        start = kane.KaneState(q=jnp.zeros(1), u=jnp.zeros(1))
        return kane.simulate(system, start, (0.0, end)).q[-1, 0]

    forces = jnp.asarray(np.random.default_rng(0).standard_normal(count))
    shares = h * (end - h * (np.arange(count) + 0.5))
    # each jump is passed over, some nine numbers of 2.2e-16 of the time, of h
    close = count * 9 * 2.3e-16 * end / h * shares.max()
    assert float(way(forces)) == pytest.approx(float(shares @ forces), abs=10 * close)
    for derivative in (jax.grad(way), jax.jacfwd(way)):
        np.testing.assert_allclose(derivative(forces), shares, rtol=0, atol=close)


@pytest.mark.parametrize("method", ["native", "diffrax"])
def test_a_pulse_on_a_kane_system_at_rest_is_not_missed(method):
    start = kane.KaneState(q=jnp.zeros(1), u=jnp.zeros(1))

    def way(size):
        return kane.simulate(particle(size), start, (0.0, END), method=method).q[-1, 0]

    assert float(way(500.0)) == pytest.approx(500.0 * WAY / MASS, rel=CLOSE)
    assert float(jax.grad(way)(500.0)) == pytest.approx(WAY / MASS, rel=CLOSE)


def test_a_pulse_is_a_dependence_on_time():
    """Of a scene and of a system that do not move at any time that is looked at."""
    scene = pushed(500.0)
    with pytest.raises(FieldError, match="time"):
        rk.steady_motion(scene, rk.place(scene, LEVEL, STILL, STILL))
    start = kane.KaneState(q=jnp.zeros(1), u=jnp.zeros(1))
    with pytest.raises(FieldError, match="depends on time"):
        rk.steady_motion(particle(500.0), start)


def test_a_jump_at_a_place_has_its_derivative_between_two_runs():
    """As docs/mistakes.md advises: a ball that rolls into a wind at x = 0.5 m."""
    edge = rk.Event(lambda scene, t, state: state.contact_on_base[0] - 0.5)

    def wind(size):
        force = rk.Force(
            lambda t, point, p: p * jnp.array([1.0, 0.0, 0.0]), parameters=size
        )
        return rk.Scene(BALL, loads=(rk.Gravity(), force))

    def way(speed, size):
        still, windy = wind(0.0 * size), wind(size)
        turning = jnp.array([0.0, 1.0, 0.0]) * speed / RADIUS
        start = rk.place(still, LEVEL, turning, STILL)
        first = rk.simulate(still, start, (0.0, 2.0), stop=edge)
        times = jnp.stack([first.final_time, jnp.asarray(2.0)])
        return rk.simulate(windy, first.final_state, times).position[-1, 0]

    def wanted(speed, size):
        left = 2.0 - 0.5 / speed
        return 0.5 + speed * left + 0.5 * size / (1.4 * MASS) * left**2

    at = jnp.asarray(1.0), jnp.asarray(0.7)
    # steady and evenly accelerated: steps of order 8 are exact, up to rounding
    assert float(way(*at)) == pytest.approx(float(wanted(*at)), rel=CLOSE)
    slopes = jax.grad(way, (0, 1))(*at), jax.grad(wanted, (0, 1))(*at)
    np.testing.assert_allclose(*slopes, rtol=CLOSE)


@pytest.mark.parametrize("system", [False, True])
def test_a_controller_of_one_s_own_knows_no_kinks(system):
    controller = diffrax.PIDController(rtol=1e-6, atol=1e-8)
    run, model = rk.simulate, pushed(1.0)
    start = rk.place(model, LEVEL, STILL, STILL)
    if system:
        run, model = kane.simulate, particle(1.0)
        start = kane.KaneState(q=jnp.zeros(1), u=jnp.zeros(1))
    with pytest.raises(FieldError, match=r"stepsize_controller.*jump_ts"):
        run(model, start, (0.0, END), stepsize_controller=controller)


@pytest.mark.parametrize("made", [pushed, particle])
@pytest.mark.parametrize("kinks", [3.0, [[1.0]], [np.nan], "soon"])
def test_kinks_are_times(made, kinks):
    with pytest.raises(FieldError, match="kinks"):
        made(1.0, kinks)
