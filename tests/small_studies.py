"""Studies of a tenth of a second, each compiled once for all tests of a process."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import energy
from rollkane.dynamics.ready_observables import position, spin
from rollkane.uncertainty import fingerprint as prints
from rollkane.uncertainty import monte_carlo as running
from rollkane.uncertainty.unit_runs import UnitRuns

UPRIGHT, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TIMES = (0.0, 0.05, 0.1)
RADIUS = 0.1


def ball(mass=1.0):
    return rk.Body(mass, 0.004 * np.eye(3), rk.Sphere(RADIUS))


def rolled(draw):
    """A ball of a random mass, rolling at a random rate."""
    scene = rk.Scene(ball(draw["mass"]), loads=(rk.Gravity(), rk.Drag(linear=0.5)))
    rate = jnp.stack([jnp.asarray(0.3), draw["rate"], jnp.asarray(1.0)])
    return scene, rk.place(scene, UPRIGHT, rate, ORIGIN)


DRAWN = {"mass": rk.Uniform(1.0, 2.0), "rate": rk.Normal(4.0, 1.0)}


def fast(scene, t, state):
    return state.angular_velocity[1] > 4.0


def distance(scene, t, state):
    return position(scene, t, state)[0]


@functools.cache
def rolling():
    """A ball; a number, a vector, a truth value, a series, an event."""
    passes = rk.Event(lambda *at: distance(*at) - 0.04, name="passes")
    return rk.Study(
        rolled,
        DRAWN,
        TIMES,
        {"energy": energy, "end": position, "fast": fast},
        series={"way": distance},
        events=passes,
    )


@functools.cache
def heavier():
    """The same ball, some of a larger mass."""
    given = rolling()
    drawn = DRAWN | {"mass": rk.Uniform(1.0, 2.5)}
    seen = {"series": given.series, "events": given.events}
    return rk.Study(rolled, drawn, TIMES, given.observe, **seen)


@functools.cache
def stopping():
    """The ball, whose motion ends where it has come so far."""
    there = rk.Event(lambda *at: distance(*at) - 0.04, name="there")
    return rk.Study(
        rolled, DRAWN, TIMES, {"end": position}, series={"way": distance}, stop=there
    )


@functools.cache
def failing():
    """A ball whose mass is negative one time in four; the rest takes its steps."""
    drawn = DRAWN | {"mass": rk.Uniform(-1.0, 3.0)}
    return rk.Study(
        rolled,
        drawn,
        TIMES,
        {"energy": energy, "one": lambda *at: 1.0, "fast": fast},
        series={"ones": lambda *at: 1.0, "more": lambda *at: True},
        events=rk.Event(lambda *at: distance(*at) - 0.04, name="passes"),
    )


@functools.cache
def tiring():
    """A ball that may take so few steps that none comes to the end."""
    return rk.Study(rolled, DRAWN, TIMES, {"energy": energy}, max_steps=1)


def dropped(draw):
    """A ball that hits the plane, spinning: it bounces and slips."""
    scene = rk.Scene(ball(), loads=(rk.Gravity(),))
    rate = jnp.stack([jnp.asarray(0.0), draw["rate"], jnp.asarray(0.0)])
    above = jnp.array([0.0, 0.0, RADIUS + 0.005])  # falls for 32 ms
    return scene, rk.release(scene, UPRIGHT, rate, above, ORIGIN)


@functools.cache
def bouncing():
    modes = rk.Modes(friction=0.2, restitution=0.5)
    seen = {"energy": energy, "end": position}
    return rk.Study(dropped, {"rate": DRAWN["rate"]}, TIMES, seen, modes=modes)


def shaken(draw):
    """A ball on a base that follows a record, of a random strength."""
    t = np.linspace(0.0, 0.2, 41)
    along = 3.0 * np.sin(40.0 * t)[:, None] * np.array([1.0, 0.0, 0.0])
    record = rk.RecordedMotion(t, along * draw["strength"])
    scene = rk.Scene(ball(), rk.Base(rk.Plane(), motion=record), loads=(rk.Gravity(),))
    return scene, rk.place(scene, UPRIGHT, ORIGIN, ORIGIN)


@functools.cache
def shaking():
    strength = {"strength": rk.LogNormal(1.0, 0.3)}
    return rk.Study(shaken, strength, TIMES, {"end": position, "spin": spin})


def tipped(draw):
    """A disc so low that it comes to lie on its face."""
    body = rk.Body(1.0, np.diag([0.0025, 0.0025, 0.005]), rk.DiscEdge(0.1))
    scene = rk.Scene(body, loads=(rk.Gravity(),))
    lean = draw["lean"]
    turned = jnp.stack([jnp.cos(lean), jnp.sin(lean), 0.0 * lean, 0.0 * lean])
    return scene, rk.place(scene, turned, ORIGIN, ORIGIN)


@functools.cache
def falling(ends=()):
    """A disc that falls flat from most angles in 0.1 s."""
    return rk.Study(
        tipped,
        {"lean": rk.Uniform(0.01, 0.2)},
        TIMES,
        {"energy": energy},
        ends=ends,
    )


class Push(eqx.Module):
    """A force that grows with time [N], and holds how fast."""

    rate: object

    def __call__(self, t, *at):
        return jnp.stack([self.rate * t, 0.0 * t, 0.0 * t])


@pytest.fixture
def compiled_once(monkeypatch):
    """Let calls of ``monte_carlo`` share what they trace and compile of one study."""
    monkeypatch.setattr(running, "UnitRuns", _runs)
    monkeypatch.setattr(running, "fingerprint", _print)


@functools.cache
def _kept_runs(study):
    return UnitRuns(study)


def _runs(study):
    found = _kept_runs(study)
    found._units.clear()  # of another seed, perhaps
    return found


_print = functools.cache(prints.fingerprint)


def equal(one, other):
    """Whether two results have the same members, bit for bit."""
    assert one.columns == other.columns
    for name in one.columns:
        left, right = one.values(name), other.values(name)
        assert left.dtype == right.dtype, name
        assert left.tobytes() == right.tobytes(), name
    return True
