"""No change of contact is missed: runs in modes against a simulation of their events.

Families of motions, each drawn by its number; motions in which a change hangs on less
than a margin are drawn again, by the simulation alone.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from tests import event_simulation as exact
from tests.event_search import GrazingError, Margin

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
G, R, MASS, REST_SPEED = 9.81, 0.11, 6.0, 1e-3
BALL = rk.Body(MASS, 0.4 * MASS * R**2 * np.eye(3), rk.Sphere(R))
FEW, MANY = 2, 2001  # output times
SWITCHES = 128  # the busiest motion has about 90

# [s]; between the simulation, exact to 1e-12, and a run with rtol 1e-9, whose slides
# end 1e-7 apart at most
CLOSE = 1e-6
# [s], and of final states [1]; between two runs that differ in their steps alone
SAME = 1e-7

# A thousandth of what CLOSE allows, at speeds near 1 m/s and accelerations near g; the
# time is ten times CLOSE.
MARGIN = Margin(gap=1e-7, speed=1e-6, acceleration=1e-4, time=1e-5, approach=0.02)
# What a ball let go higher by STEP may change in a time [s]: a chain of landings that
# makes more than 1e4 of an error shows roundings of 1e-12 as 1e-8.
STEP, SPREAD = 1e-9, 1e-5


class Motion(NamedTuple):
    """What the library is given, and what it must find."""

    numbers: tuple
    until: float
    events: exact.Events
    slip: np.ndarray | None = None  # at the end [m/s]


class Seen(NamedTuple):
    """What a run found."""

    code: jax.Array
    count: jax.Array
    time: jax.Array
    before: jax.Array
    after: jax.Array
    final: jax.Array
    slip: jax.Array


def seen(run: rk.Trajectory) -> Seen:
    last = jax.tree.map(lambda x: x[-1:], run.state)
    end = dataclasses.replace(run, time=run.time[-1:], state=last)
    final = end.position, end.angular_velocity, end.slip
    s = run.switches
    numbers = s.count, s.time, s.before, s.after
    return Seen(run.code, *numbers, jnp.concatenate(final, axis=1)[0], end.slip[0])


def simulated(scene, start, times, **modes):
    modes = rk.Modes(rest_speed=REST_SPEED, switches=SWITCHES, **modes)
    return seen(rk.simulate(scene, start, times, modes=modes, rtol=1e-9))


def shaken(t, p, way=(0.0, 0.0, 1.0)):
    """A plate's place: amplitude [m], rate [rad/s] and phase in p."""
    return p[0] * jnp.sin(p[1] * t + p[2]) * jnp.array(way)


def shaken_sideways(t, p):
    return shaken(t, p, (1.0, 0.0, 0.0))


def plate(p):
    """Position, velocity and acceleration, in NumPy."""
    A, w, phase = p
    return (
        lambda t: A * np.sin(w * t + phase),
        lambda t: A * w * np.cos(w * t + phase),
        lambda t: -A * w * w * np.sin(w * t + phase),
    )


def on_plate(p, motion=shaken) -> rk.Scene:
    moving = rk.BaseMotion(position=motion, parameters=p)
    return rk.Scene(BALL, rk.Base(rk.Plane(), moving))


def bounced(numbers, times):
    p, height, e = numbers
    scene = on_plate(p)
    place = jnp.stack([0.0 * height, 0.0 * height, height + R])
    start = rk.release(scene, UP, STILL, place, STILL)
    return simulated(scene, start, times, friction=0.3, restitution=e)


def bouncing(rng, *_) -> Motion:
    amplitude, frequency = rng.uniform(0.005, 0.03), rng.uniform(2.0, 12.0)
    p = np.array([amplitude, 2.0 * np.pi * frequency, rng.uniform(0.0, 2.0 * np.pi)])
    height, e = rng.uniform(0.01, 0.2), rng.uniform(0.2, 0.9)
    if height - plate(p)[0](0.0) < 1e-3:
        raise GrazingError("is in the plate, or less than 1 mm over it")
    given = {"gravity": G, "rest_speed": REST_SPEED, "until": 1.0, "restitution": e}
    drop = functools.partial(exact.bouncing_ball, *plate(p), **given)
    events, beside = drop(height=height, margin=MARGIN), drop(height=height + STEP)
    if codes(events) != codes(beside) or far(events, beside) > SPREAD:
        raise GrazingError("depends on a rounding")
    return Motion((p, height, e), 1.0, events)


def dipped(numbers, times):
    p, e = numbers
    scene = on_plate(p)
    start = rk.place(scene, UP, STILL, STILL)
    return simulated(scene, start, times, friction=0.3, restitution=e)


def dipping(rng, _, share) -> Motion:
    """Peak accelerations of 1.0005 to 1.05 g."""
    rate = 2.0 * np.pi * rng.uniform(2.0, 8.0)
    peak = G * (1.0 + 5e-4 * 100.0**share)
    p, e = np.array([peak / rate**2, rate, 0.0]), rng.uniform(0.2, 0.8)
    given = {"gravity": G, "rest_speed": REST_SPEED, "until": 1.0, "restitution": e}
    events = exact.normal_force_dips(*plate(p), **given, margin=MARGIN)
    return Motion((p, e), 1.0, events)


def hills_by(xp):
    """A hill, a field of hills and a bowl, of which two have no height."""

    def height(x, y, p):
        squared = x * x + y * y
        hill = p[0] * xp.exp(-0.5 * squared / p[1] ** 2)
        return hill + p[2] * xp.cos(p[3] * x) * xp.cos(p[3] * y) + 0.5 * p[4] * squared

    return height


HILLS = hills_by(jnp)


def threw(numbers, times):
    p, place, velocity, e = numbers
    ground = rk.Graph(HILLS, parameters=p, domain=((-2.0, 2.0), (-2.0, 2.0)))
    scene = rk.Scene(BALL, rk.Base(ground))
    start = rk.release(scene, UP, STILL, place, velocity)
    return simulated(scene, start, times, friction=0.0, restitution=e)


def throwing(rng, number, _) -> Motion:
    """Up to three landings; every third motion has a hill, a field of them, a bowl."""
    kinds = (0.05, 0.3, 0), (0.01, 0.05, 2), (0.5, 5.0, 4)
    p = np.array([0.0, rng.uniform(0.1, 0.4), 0.0, rng.uniform(10.0, 30.0), 0.0])
    low, high, place = kinds[number % 3]
    p[place] = rng.uniform(low, high)
    ground = functools.partial(hills_by(np), p=p)
    x, y = rng.uniform(-0.3, 0.3, 2)
    beside = np.linspace(-R, R, 23)
    top = ground(x + beside[:, None], y + beside).max()
    center = np.array([x, y, top + R + rng.uniform(0.05, 0.4)])
    velocity, e = rng.uniform(-1.2, 1.2, 3), rng.uniform(0.3, 0.9)
    given = {"restitution": e, "gravity": G, "until": 1.0, "landings": 4}
    events = exact.thrown_ball(ground, R, center, velocity, **given, margin=MARGIN)
    until = 1.0
    if len(events) == 4:
        until = 0.5 * (events[2][0] + events[3][0])
    return Motion((p, center, velocity, e), until, events[:3])


def slipped(numbers, times):
    p, mu = numbers
    scene = on_plate(p, shaken_sideways)
    start = rk.place(scene, UP, STILL, STILL)
    return simulated(scene, start, times, friction=mu)


def slipping(rng, _, share) -> Motion:
    """Rolling that asks for 1.0005 to 1.3 times what friction holds."""
    frequency, mu = rng.uniform(1.0, 5.0), rng.uniform(0.05, 0.4)
    rate = 2.0 * np.pi * frequency
    amplitude = (1.0 + 5e-4 * 600.0**share) * exact.FREED * mu * G / rate**2
    events = exact.shaken_ball(amplitude, frequency, mu, G, 1.0, MARGIN)
    return Motion((np.array([amplitude, rate, 0.0]), mu), 1.0, events)


def slid(numbers, times):
    """On a plane that falls towards -y: gravity is turned instead."""
    slip, mu, slope = numbers
    down = jnp.stack([0.0 * slope, -jnp.sin(slope), -jnp.cos(slope)])
    loads = (rk.Gravity(G * down),)
    slips = rk.Scene(BALL, loads=loads, contact=rk.Slipping(rk.CoulombFriction(mu)))
    start = rk.place(slips, UP, STILL, STILL, slip=slip)
    return simulated(rk.Scene(BALL, loads=loads), start, times, friction=mu)


def sliding(rng, number, _) -> Motion:
    """Every fourth without friction; the first turns by more than 90 degrees."""
    size, angle = rng.uniform(0.1, 5.0), rng.uniform(0.0, 2.0 * np.pi)
    slip = size * np.array([np.cos(angle), np.sin(angle)])
    mu, slope = rng.uniform(0.01, 0.3), np.radians(rng.uniform(0.0, 20.0))
    until = 2.0
    if number == 0:
        slip, slope, until = np.array([1.0, 5.0]), np.radians(20.0), 3.0
    if number % 4 == 0:
        mu = 0.0
    given = mu, slope, G, until
    events = exact.turning_slide(tuple(slip), *given, MARGIN)
    last = np.append(exact.slip_of_slide(tuple(slip), *given), 0.0)
    return Motion((np.append(slip, 0.0), mu, slope), until, events, last)


class Family(NamedTuple):
    """Motions of a kind: what draws one, what runs it, and how many."""

    draw: Callable
    run: Callable
    count: int


FAMILIES = {
    "bouncing balls": Family(bouncing, jax.jit(bounced), 500),
    "thrown balls": Family(throwing, jax.jit(threw), 100),
    "slip onsets": Family(slipping, jax.jit(slipped), 100),
    "turning slides": Family(sliding, jax.jit(slid), 100),
    "dips of the normal force": Family(dipping, jax.jit(dipped), 50),
}


def codes(events: exact.Events) -> list[tuple[int, int]]:
    return [(before, after) for _, before, after in events]


def far(one: exact.Events, other: exact.Events) -> float:
    """Longest time between the same events [s]."""
    pairs = zip(one, other, strict=True)
    return max((abs(a[0] - b[0]) for a, b in pairs), default=0.0)


def drawn(family: Family, number: int) -> Motion:
    """One motion; what grazes is drawn again."""
    rng = np.random.default_rng([family.count, number])
    while True:
        try:
            return family.draw(rng, number, number / (family.count - 1))
        except GrazingError:
            continue


def events_of(found: Seen) -> exact.Events:
    count = min(int(found.count), SWITCHES)
    lists = found.time[:count], found.before[:count], found.after[:count]
    return list(zip(*(np.asarray(x).tolist() for x in lists), strict=True))


def complaint(family: Family, motion: Motion) -> str:
    """What is wrong with the library's runs of a motion; nothing if they are right."""
    numbers = jax.tree.map(jnp.asarray, motion.numbers)
    runs = [
        family.run(numbers, jnp.linspace(0.0, motion.until, n)) for n in (FEW, MANY)
    ]
    for name, found in zip(("few", "many"), runs, strict=True):
        events = events_of(found)
        if found.code != rk.Code.COMPLETED:
            return f"{name}: ended with code {int(found.code)}"
        if codes(events) != codes(motion.events):
            return f"{name}: {len(events)} changes for {len(motion.events)}, or others"
        if not far(events, motion.events) < CLOSE:
            return f"{name}: {far(events, motion.events):.1e} s off"
        # a slip grows with g [m/s^2]: as exact as the times, ten times over
        if motion.slip is not None and not apart(found.slip, motion.slip) < 10 * CLOSE:
            return f"{name}: slip {apart(found.slip, motion.slip):.1e} off"
    few, many = runs
    if not far(events_of(few), events_of(many)) < SAME:
        return f"outputs move times by {far(events_of(few), events_of(many)):.1e} s"
    if not apart(few.final, many.final) < SAME:
        return f"outputs move the end by {apart(few.final, many.final):.1e}"
    return ""


def apart(one, other) -> float:
    """Largest difference, relative to the largest number or to one."""
    one, other = np.asarray(one), np.asarray(other)
    return float(np.max(np.abs(one - other)) / max(1.0, np.max(np.abs(other))))


def complaints(name: str, numbers) -> dict[int, str]:
    family = FAMILIES[name]
    said = {n: complaint(family, drawn(family, n)) for n in numbers}
    return {n: words for n, words in said.items() if words}


# hills and bowls are searched densely, and three programs compiled: a minute
LONG = "thrown balls", "dips of the normal force", "turning slides"
QUICK = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
    for name in FAMILIES
]


@pytest.mark.parametrize("name", QUICK)
def test_no_change_is_missed(name):
    """Of five motions of a family, from the first to the last."""
    numbers = np.linspace(0, FAMILIES[name].count - 1, 5).astype(int).tolist()
    assert complaints(name, numbers) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_no_change_of_a_family_is_missed(name):
    assert complaints(name, range(FAMILIES[name].count)) == {}


def test_the_simulation_itself():
    """Against closed forms: a drop on a plate at rest, and a slide on the level.

    To 1e-13 s: times near 1 s, to rounding, over 20 landings.
    """
    height, e, speed, mu = 0.5, 0.8, 3.0, 0.2
    rest = lambda t: 0.0 * t
    given = {"gravity": G, "rest_speed": REST_SPEED, "until": 4.0, "restitution": e}
    events = exact.bouncing_ball(rest, rest, rest, height=height, **given)
    fall = np.sqrt(2.0 * height / G)
    hits = fall * (1.0 + 2.0 * np.cumsum([0.0, *(e ** np.arange(1, len(events)))]))
    np.testing.assert_allclose([t for t, *_ in events], hits, atol=1e-13)
    assert codes(events)[-2:] == [(exact.FLYING, exact.FLYING), (exact.FLYING, 0)]
    ((end, *_),) = exact.turning_slide((0.0, speed), mu, 0.0, G, 1.0)
    np.testing.assert_allclose(end, speed / (3.5 * mu * G), atol=1e-13)
