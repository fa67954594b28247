"""Rubber rolling, slipping, resistance: Kane's method, energy and closed forms."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.codegen.compile_effort import for_one_call
from rollkane.dynamics import contact_laws, mass_matrix, observables, rolling
from rollkane.geometry.rotations import tangent_pair
from rollkane.kane import rolling_scene
from rollkane.kinematics.coordinates import shared_parts
from tests.random_scenes import stacked

from ..quick import slow_but

SEEDS = 12
# as in test_twins: 10^3 roundings of terms up to ten times larger
AGREE = 1e-10
COULOMB = rk.CoulombFriction(0.3, 0.1)
LAWS = {
    "rubber": rk.RubberRolling(),
    "rolling, dry resistance": rk.Rolling(),
    "rubber, dry resistance": rk.RubberRolling(),
    "viscous": rk.Slipping(rk.ViscousFriction(0.7)),
    "Coulomb": rk.Slipping(COULOMB),
    "Stribeck, dry resistance": rk.Slipping(rk.StribeckFriction(0.4, 0.2, 0.5, 0.1)),
}
# the others are parts of these
QUICK = ("Coulomb",)
RESISTING = (
    rk.RollingResistance(viscous=0.1, dry=0.02, regularization=0.5),
    rk.SpinningResistance(viscous=0.2, dry=0.01, regularization=0.5),
)
SPRING = rk.Potential(lambda p: 2.0 * jnp.sum(p * p) + jnp.sin(p[0]), (0.1, 0.2, 0.0))
AIR = rk.Drag(0.2, 0.1, 0.3, point=(0.1, 0.0, -0.1))


def under(law: str, scene, t, state):
    """A random scene under a law, and a state of it."""
    contact = LAWS[law]
    loads = (*scene.loads, SPRING, AIR)
    loads += RESISTING if "resistance" in law else ()
    scene = rk.Scene(scene.body, scene.base, scene.supported, loads, contact)
    state = rk.to_pole_free(scene, state, t)
    if isinstance(contact, rk.Slipping):
        fields = {f.name: getattr(state, f.name) for f in dataclasses.fields(state)}
        still = rk.contact_of(scene, t, rk.SlidingState(**fields, slip=jnp.zeros(3)))
        out, slip = still.rotation @ still.normal, jnp.array([0.5, -0.8, 0.3])
        state = rk.SlidingState(**fields, slip=slip - out * (out @ slip))
    return scene, state


def solution_of(scene, t, state):
    contact = rk.contact_of(scene, t, state)
    system = mass_matrix.assemble(scene, t, state, contact)
    return contact, contact_laws.accelerations(scene, t, contact, system)


def rolls(state):
    """The state without its slip."""
    return rk.State(**shared_parts(state))


def pair_of(scene, places, t, q, u):
    """Tangent pair of the surface at the contact, fixed axes."""
    contact = rolling_scene._Shared(places, False)(t, q, u, scene).contact
    return tangent_pair(contact.rotation @ contact.normal)


def system_of(scene, t, state, slips, rubber, force, moment):
    """A Kane system whose last two speeds are a slip along a tangent pair."""
    places, turning = rolling_scene._places(state), 3 + scene.coordinate_count

    def shared(t, q, u, scene):
        now = rolling_scene._Shared(places, False)(t, q, u[:turning], scene)
        if not slips:
            return now
        first, second = pair_of(scene, places, t, q, u[:turning])
        slip = u[-2] * first + u[-1] * second
        sliding = rk.SlidingState(**shared_parts(now.state), slip=slip)
        contact = rk.contact_of(scene, t, sliding)
        return now._replace(contact=contact, at_contact=now.at_contact + slip)

    def no_spin(t, q, u, now):
        return (now.contact.normal @ now.contact.relative_angular_velocity)[None]

    numbers = rolling_scene._mass, rolling_scene._inertia
    parts = [
        kane.RigidBody(*numbers, rolling_scene._of_body, rolling_scene._spin),
    ]
    for k, part in enumerate(rolling_scene._carried(scene, t, state)):
        parts += rolling_scene._carried_parts(k, part, state)
    loads = [
        *rolling_scene._loads(scene, parts),
        kane.Load(rolling_scene._of_contact, lambda t, q, u: force),
        kane.Load(rolling_scene._spin, lambda t, q, u: moment),
    ]
    return kane.KaneSystem(
        kane.kane_state(state).q.shape[0],
        turning + 2 * slips,
        rolling_scene._kinematics,
        parts,
        loads,
        constraints=no_spin if rubber else None,
        dependent=(2,) if rubber else (),  # the third speed follows
        generalized_forces=rolling_scene._springs if turning > 3 else None,
        parameters=scene,
        shared=shared,
    )


def twin(scene, t, state, force, moment):
    """Accelerations and rate of the slip by Kane's method, under a given contact.

    The turning of the tangent pair is differentiated by Kane's method itself; of the
    contact law it is told force and moment only.
    """
    plain = rk.Scene(scene.body, scene.base, scene.supported, scene.loads)
    slip, state = getattr(state, "slip", None), rolls(state)
    rubber = isinstance(scene.contact, rk.RubberRolling)
    system = system_of(plain, t, state, slip is not None, rubber, force, moment)
    own = kane.kane_state(state)
    if rubber:
        own = kane.KaneState(own.q, jnp.delete(own.u, 2))
        rates = kane.kane_derivative(system, t, own)
        speeds = lambda t, x: kane.all_speeds(system, t, x)
        moved = jnp.ones_like(t), rates
        return jax.jvp(speeds, (t, own), moved)[1], jnp.zeros(3)
    if slip is None:
        return kane.kane_derivative(system, t, own).u, jnp.zeros(3)
    places = rolling_scene._places(state)
    pair = lambda t, q: jnp.stack(pair_of(plain, places, t, q, own.u))
    along = pair(t, own.q) @ slip
    whole = kane.KaneState(own.q, jnp.concatenate([own.u, along]))
    rates = kane.kane_derivative(system, t, whole)
    slip_of = lambda t, q, speeds: speeds @ pair(t, q)
    moved = jnp.ones_like(t), rates.q, rates.u[-2:]
    return rates.u[:-2], jax.jvp(slip_of, (t, own.q, along), moved)[1]


@pytest.mark.parametrize("law", slow_but(QUICK, LAWS))
@pytest.mark.parametrize(
    "case",
    [
        ("ellipsoid in ellipsoid", -1),
        pytest.param(("rim on cylinder", -1), marks=pytest.mark.slow),
        pytest.param(("torus on graph", 1), marks=pytest.mark.slow),
        pytest.param(("revolution on torus", -1), marks=pytest.mark.slow),
    ],
    ids=lambda case: case[0],
)
def test_random_scenes(case, law):
    """Moving base, carried masses, every load: accelerations, force law, power."""

    def all_of(scene, t, state):
        scene, state = under(law, scene, t, state)
        contact, solution = solution_of(scene, t, state)
        state = dataclasses.replace(state, angular_velocity=contact.angular_velocity)
        rates = rk.rolling_derivative(scene, t, state)
        R = contact.rotation
        force = rolling.contact_force(scene, t, state)
        out = R @ contact.normal
        along = force - out * (out @ force)
        moment = jnp.zeros(3) if solution.moment is None else solution.moment
        slipping = isinstance(scene.contact, rk.Slipping)
        told = along if slipping else jnp.zeros(3)
        own, slip_rate = twin(scene, t, state, told, moment)
        found = jnp.concatenate([rates.angular_velocity, rates.alpha_dot])
        pairs = [(found, own)]
        if slipping:
            pairs.append((rates.slip, slip_rate))
            friction, slip = scene.contact.friction, contact.slip
            press = jnp.abs(-out @ force)
            ratio, by_itself = friction.ratio(slip), friction.force(slip)
            law_force = jnp.zeros(3) if ratio is None else press * ratio
            law_force = law_force if by_itself is None else law_force + by_itself
            pairs.append((R.T @ along, law_force))
        if solution.margin is not None:
            press = jnp.abs(-out @ force)
            resist = [x.moment_by_normal_force(contact) for x in scene.loads]
            resist = [press * x for x in resist if x is not None]
            if resist and not isinstance(scene.contact, rk.RubberRolling):
                pairs.append((moment, sum(resist)))
        if isinstance(scene.contact, rk.RubberRolling):
            spin = lambda t, w, q: _spin(scene, t, w, q, state)
            rate = jax.jvp(
                spin,
                (t, state.angular_velocity, state),
                (jnp.ones_like(t), rates.angular_velocity, _still(rates)),
            )[1]
            pairs.append((rate[None] + 1.0, jnp.ones(1)))
        energy = lambda t, s: observables.energy(scene, t, s)
        rate = jax.jvp(energy, (t, state), (jnp.ones_like(t), rates))[1]
        pairs.append((rate[None], observables.power(scene, t, state)[None]))
        return pairs

    found = for_one_call(lambda *c: jax.vmap(all_of)(*c))(*stacked(*case, SEEDS))
    for k, (a, b) in enumerate(found):
        a, b = np.asarray(a), np.asarray(b)
        assert np.isfinite(a).all(), k
        size = 1.0 + np.abs(b).max(axis=1, keepdims=True)
        assert (np.abs(a - b) < AGREE * size).all(), k


def _spin(scene, t, w, state, like):
    """Relative turning about the normal, by the contact of rolling."""
    plain = rk.Scene(scene.body, scene.base, scene.supported, scene.loads)
    contact = rk.contact_of(plain, t, dataclasses.replace(state, angular_velocity=w))
    return contact.normal @ contact.relative_angular_velocity


def _still(rates):
    """Rates of the places alone."""
    return dataclasses.replace(
        rates,
        angular_velocity=jnp.zeros_like(rates.angular_velocity),
        alpha_dot=jnp.zeros_like(rates.alpha_dot),
    )


UP = (1.0, 0.0, 0.0, 0.0)
BALL = rk.Body(6.0, 0.4 * 6.0 * 0.11**2 * np.eye(3), rk.Sphere(0.11))


def test_bowling_ball_slides_by_the_closed_form():
    """v = v0 - mu g t and r w = 5/2 mu g t until they meet; eps^2 / U^2 = 1e-10."""
    mu, v0, g = 0.2, 8.0, 9.81
    law = rk.Slipping(rk.CoulombFriction(mu, regularization=1e-5))
    scene = rk.Scene(BALL, contact=law)
    start = rk.place(scene, UP, (0, 0, 0), (0, 0, 0), velocity=(v0, 0.0, 0.0))
    rolls = 2.0 * v0 / (7.0 * mu * g)
    times = np.linspace(0.0, 0.8 * rolls, 9)
    run = rk.simulate(scene, start, times, rtol=1e-11)
    assert run.succeeded
    x = v0 * times - 0.5 * mu * g * times**2
    np.testing.assert_allclose(run.position[:, 0], x, atol=1e-9)
    spin = 2.5 * mu * g * times / 0.11
    np.testing.assert_allclose(run.angular_velocity[:, 1], spin, atol=1e-8)
    slip = v0 - 3.5 * mu * g * times
    np.testing.assert_allclose(run.slip[:, 0], slip, atol=1e-9)
    # and then it rolls with 5/7 of its speed, creeping within the regularization
    late = rk.simulate(
        rk.Scene(BALL, contact=rk.Slipping(rk.CoulombFriction(mu, 1e-3))),
        start,
        [0.0, 1.5 * rolls],
        rtol=1e-8,
    )
    v = 0.11 * late.angular_velocity[-1, 1]
    np.testing.assert_allclose(v, 5.0 / 7.0 * v0, rtol=1e-3)


def test_smooth_ball_goes_straight_on_a_turntable():
    """Without friction the table's turning is not felt."""
    table = rk.Base(rk.Plane(), rk.Spin(3.0))
    scene = rk.Scene(BALL, table, contact=rk.Slipping())
    start = rk.place(scene, UP, (1, 2, 3), (0.2, 0, 0), velocity=(0.5, 0.1, 0.0))
    run = rk.simulate(scene, start, np.linspace(0.0, 2.0, 5), rtol=1e-11)
    straight = np.add([0.2, 0.0, 0.11], np.outer(run.time, [0.5, 0.1, 0.0]))
    np.testing.assert_allclose(run.position, straight, atol=1e-10)
    np.testing.assert_allclose(run.angular_velocity, [[1, 2, 3]] * 5, atol=1e-12)


def test_rolling_resistance_stops_a_ball():
    """Viscous: w decays by c / (7/5 m r^2); dry: x'' = -5/7 f g / r while it rolls."""
    J = 1.4 * 6.0 * 0.11**2
    times = np.linspace(0.0, 1.0, 5)
    scene = rk.Scene(BALL, loads=(rk.Gravity(), rk.RollingResistance(viscous=0.05)))
    start = rk.place(scene, UP, (0, 10.0, 0), (0, 0, 0))
    run = rk.simulate(scene, start, times, rtol=1e-11)
    decay = 10.0 * np.exp(-0.05 / J * times)
    np.testing.assert_allclose(run.angular_velocity[:, 1], decay, rtol=1e-9)
    dry = rk.RollingResistance(dry=1e-3, regularization=1e-6)
    scene = rk.Scene(BALL, loads=(rk.Gravity(), dry))
    run = rk.simulate(scene, start, times, rtol=1e-11)
    slowed = 10.0 - 1e-3 * 6.0 * 9.81 / J * times
    np.testing.assert_allclose(run.angular_velocity[:, 1], slowed, rtol=1e-9)
    np.testing.assert_allclose(run.normal_force, 6.0 * 9.81, rtol=1e-12)


def test_rubber_ball_does_not_spin():
    """On a turntable it turns with the table about the normal, to rounding."""
    table = rk.Base(rk.Plane(), rk.Spin(3.0))
    scene = rk.Scene(BALL, table, contact=rk.RubberRolling())
    start = rk.place(scene, UP, (1.0, 2.0, 7.0), (0.2, 0, 0))
    run = rk.simulate(scene, start, np.linspace(0.0, 3.0, 7), rtol=1e-10)
    np.testing.assert_allclose(run.angular_velocity[:, 2], 3.0, rtol=1e-14)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("mu", [0.2, 3.0])
def test_painleve_is_reported_and_not_clipped(mu, way):
    """A rod that is pushed foot first jams: no normal force fits.

    By hand, with m = 1, I = 1/3, the foot's place (-c, -h) from the mass centre, slip
    along y: N (1 + 3 c (c + way mu h)) = g, over the same without friction.
    """
    rod = rk.Body(1.0, np.diag([1 / 3, 1e-3, 1 / 3]), rk.Sphere(0.01, (0, -1.0, 0)))
    lean = 0.9
    upright = (np.cos(lean / 2), np.sin(lean / 2), 0.0, 0.0)
    scene = rk.Scene(rod, contact=rk.Slipping(rk.CoulombFriction(mu, 1e-6)))
    start = rk.place(scene, upright, (0, 0, 0), (0, 0, 0), velocity=(0, way, 0))
    c, h = np.cos(lean), np.sin(lean) + 0.01
    expected = (1.0 + 3.0 * c * (c + way * mu * h)) / (1.0 + 3.0 * c * c)
    margin = rolling.painleve_margin(scene, jnp.zeros(()), start)
    np.testing.assert_allclose(margin, expected, rtol=1e-11)  # (eps / U)^2
    run = rk.simulate(scene, start, [0.0, 0.05], rtol=1e-8)
    if expected < 0.0:
        assert run.code == rk.Code.PAINLEVE
        assert "Painleve" in run.reason
    else:
        assert run.succeeded
