"""Ends of profile intervals where the number's range ends near them.

A ball of inertia k m r^2 that rolls down a slope is at ``r w t + g sin(a) t^2 / (2 (1 +
k))``: of k the least chi2 by the first speed w is a closed form, and its profile's ends
are roots of a function of one number.
"""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

import rollkane as rk
from rollkane.identification.evaluation import Evaluation
from rollkane.identification.horizons import Search
from rollkane.identification.layout import Coordinates
from rollkane.identification.least_squares import minimize
from rollkane.identification.profiles import profile_interval
from rollkane.identification.transforms import Positive

RADIUS, SLOPE, GRAVITY, SIGMA = 0.1, 0.3, 9.81, 0.02
TIMES = np.linspace(0.0, 0.5, 12)


def _place(k, w):
    down = 0.5 * GRAVITY * np.sin(SLOPE) * TIMES**2 / (1.0 + k)
    return RADIUS * w * TIMES + down


def _chi2(k, samples):
    """Least by the speed, which the place is linear in."""
    left, slope = samples - _place(k, 0.0), RADIUS * TIMES
    return np.sum((left - slope * (slope @ left) / (slope @ slope)) ** 2) / SIGMA**2


def test_a_profile_ends_where_a_positive_number_could_not_go_by_its_deviations():
    """The lower end lies above zero, the estimate less two deviations below it."""
    noise = SIGMA * np.random.default_rng(5).standard_normal(TIMES.size)
    samples = _place(0.5, 1.0) + noise
    down = GRAVITY * np.array([np.sin(SLOPE), 0.0, -np.cos(SLOPE)])
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(RADIUS))
    scene = rk.Scene(body, loads=(rk.Gravity(down),))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.0))
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:1],
        jnp.asarray(samples)[:, None],
        sigma=SIGMA,
    )
    held = ((0.0, 1.0, 0.0), (1e-6, 100.0, 1e-6))
    free = [
        rk.Free("body.inertia", form="scale"),
        rk.Free("start.angular_velocity", prior=held),
    ]
    found = rk.fit(scene, start, rk.Record(TIMES, {"place": place}), free)
    low, high = found.interval("body.inertia", method="profile")
    best = optimize.minimize_scalar(
        lambda k: _chi2(k, samples), bounds=(0.1, 2.0), options={"xatol": 1e-10}
    )
    rise = stats.norm.ppf(0.975) ** 2
    ends = [
        optimize.brentq(lambda k: _chi2(k, samples) - best.fun - rise, *bracket)
        for bracket in ((1e-3, best.x), (best.x, 100.0))
    ]
    k, error = found.estimates["body.inertia"], found.standard_errors["body.inertia"]
    assert k[0, 0] < 1.96 * error[0, 0]
    # an end's rise is right to 2e-3: 1e-3 of the distance of a parabola, 2e-3 of a line
    inertia = np.array([low[0, 0], high[0, 0]]) / RADIUS**2
    np.testing.assert_allclose(inertia - best.x, ends - best.x, rtol=2e-3)


@pytest.mark.parametrize("firm", [False, True])
def test_a_firmly_held_number_hides_no_others(firm):
    """Where the model is linear, profiles end where linear intervals do.

    A place is known to 1e-5 of its size, and a speed hardly; the profile holds the
    place a thousand times as firmly, and a prior another number.
    """
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(RADIUS)))
    sigma, speed = 1e-5, 1e-4
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, speed, 0.0), (1.0, 0.0, 0.0))
    noise = sigma * np.random.default_rng(0).standard_normal(TIMES.size)
    samples = 1.0 + RADIUS * speed * TIMES + noise
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:1],
        jnp.asarray(samples)[:, None],
        sigma=sigma,
    )
    free = [
        rk.Free("start.contact_on_base[0]"),
        rk.Free("start.angular_velocity[1]"),
    ]
    if firm:
        held = 1e-12 * RADIUS
        free += [rk.Free("start.contact_on_base[1]", prior=(0.0, held))]
    found = rk.fit(scene, start, rk.Record(TIMES, {"place": place}), free)
    for one in free:
        known = found.interval(one.path)
        ends = found.interval(one.path, method="profile")
        middle = found.estimates[one.path]
        # a parabola's ends, whose rise is right to 2e-3, are right to 1e-3
        away = np.subtract(ends, middle), np.subtract(known, middle)
        np.testing.assert_allclose(*away, rtol=1e-3)


def test_entries_of_very_different_sizes_have_their_own_ends():
    """Small ones are no copies of each other, as the two halves of an inertia are.

    Misfits are logarithms over a deviation, and so ends are the entry times a factor.
    """
    size, deviation = jnp.array([1.0, 1e-10, 3e-10, 3e-10]), 0.1
    middle = np.log(np.asarray(size))
    evaluate = lambda z: Evaluation((z - middle) / deviation, np.eye(4) / deviation, 0)
    edges = np.full(4, -np.inf), np.full(4, np.inf)
    transform = Positive(size)
    entry = Coordinates(rk.Free("one"), None, transform, slice(0, 4), *edges)
    scale = np.ones(4)
    layout = SimpleNamespace(entries=[entry], size=4, scale=scale, box=(*edges, scale))
    minimum = minimize(evaluate, middle, *layout.box)
    problem = SimpleNamespace(layout=layout, evaluate=evaluate)
    layout.lower, layout.upper = edges
    layout.by_path = lambda of: {"one": of(entry)}
    found = SimpleNamespace(search=Search(minimum, [], None), problem=problem)
    low, high = profile_interval(found, "one", 0.95)
    # an end's rise is right to 2e-3, and its distance to 1e-3
    factor = np.exp(stats.norm.ppf(0.975) * deviation)
    np.testing.assert_allclose(np.log(low / size), -np.log(factor), rtol=1.1e-3)
    np.testing.assert_allclose(np.log(high / size), np.log(factor), rtol=1.1e-3)
