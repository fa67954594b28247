"""What a study is: what it refuses, and what identifies it."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.loads import AbstractLoad
from rollkane.dynamics.observables import energy
from rollkane.dynamics.ready_observables import position
from rollkane.uncertainty.draws import Draws
from rollkane.uncertainty.fingerprint import fingerprint
from rollkane.uncertainty.made_members import MadeMembers
from rollkane.uncertainty.store import differences
from rollkane.uncertainty.unit_runs import UnitRuns
from rollkane.validation.program_digest import digest_of_program
from tests import small_studies as small
from tests.quick import slow_but

ONE = {"x": rk.Uniform(1.0, 2.0)}


def along(x):
    return x * jnp.array([1.0, 0.0, 0.0])


class Along(eqx.Module):
    """A function of time that holds two numbers, and uses the second one first."""

    a: object
    b: object

    def __call__(self, t, *at):
        return jnp.stack([self.b * t, self.a * t, 0.0 * t])


class Level(eqx.Module):
    x: object

    def __call__(self, *at):
        return self.x


class Fan(AbstractLoad):
    """A load of the user's own, whose function is no part of its numbers."""

    how: object = eqx.field(static=True)

    def wrench(self, t, body, contact):
        force = contact.rotation.T @ self.how(t)
        return force, jnp.cross(-contact.body_point, force)


def loaded(load):
    return rk.Scene(small.ball(), loads=(rk.Gravity(), load))


def moved(position):
    base = rk.Base(rk.Plane(), motion=rk.BaseMotion(position=position))
    return rk.Scene(small.ball(), base)


def carried(motion):
    where = lambda alpha: along(0.01)[None] + 0.01 * alpha[0]
    bob = rk.PointMasses(0.1, where, coordinates=1)
    return rk.Scene(small.ball(), supported=rk.Prescribed(bob, motion))


def shaped(height):
    return rk.Scene(small.ball(), rk.Base(rk.Graph(height)))


def made_of(scene_of):
    def make(draw):
        scene = scene_of(draw["x"])
        return scene, rk.place(scene, small.UPRIGHT, small.ORIGIN, small.ORIGIN)

    return make


CLOSED = {
    "force": lambda x: loaded(rk.Force(lambda t, *at: along(x))),
    "potential": lambda x: loaded(rk.Potential(lambda *at: x)),
    "own load": lambda x: loaded(Fan(lambda t: along(x))),
    "base": lambda x: moved(lambda t: along(x * t**2)),
    "place of the base": lambda x: moved(lambda t: along(x + 0.0 * t)),
    "prescribed motion": lambda x: carried(lambda t: jnp.stack([x * t**2])),
    "surface": lambda x: shaped(lambda u, v: 0.01 * x * u**2),
}
HELD = {
    "force": lambda x: loaded(rk.Force(Along(x, 7.0 + 0.0 * x))),
    "potential": lambda x: loaded(rk.Potential(Level(x))),
    "base": lambda x: moved(Along(x, 7.0 + 0.0 * x)),
    "parameters": lambda x: loaded(rk.Force(lambda t, at, c: along(c), parameters=x)),
}


@pytest.mark.parametrize("name", slow_but(CLOSED.keys() - {"surface"}, CLOSED))
def test_functions_that_close_over_a_draw_are_refused(name):
    with pytest.raises(rk.FieldError, match="closes over a drawn number") as refused:
        MadeMembers(made_of(CLOSED[name]), Draws(ONE))
    assert "equinox module" in str(refused.value)


def test_closures_that_only_observables_see_are_refused():
    """A static field hides a level from the rates, as it has no slope."""

    class Static(eqx.Module):
        how: object = eqx.field(static=True)

        def __call__(self, *at):
            return self.how()

    hidden = made_of(lambda x: loaded(rk.Potential(Static(lambda: x))))
    with pytest.raises(rk.FieldError, match="closes over a drawn number"):
        MadeMembers(hidden, Draws(ONE)).check([energy])


@pytest.mark.parametrize("name", slow_but(["base", "potential"], HELD))
def test_modules_that_hold_a_draw_give_the_right_members(name):
    """Leaf by leaf as each member by itself, which is not traced."""
    make = made_of(HELD[name])
    made = MadeMembers(make, Draws(ONE))
    made.check([energy, position])
    u = np.array([[0.1], [0.7]])
    scenes, starts = made.block(u)
    members = made.members(2)
    axes = [*members.scene_axes, *members.start_axes]
    for i in (0, 1):
        alone = jax.tree.leaves(make(made.draws.draw(jnp.asarray(u[i]))))
        pairs = zip(jax.tree.leaves((scenes, starts)), axes, alone, strict=True)
        for together, axis, leaf in pairs:
            own = together if axis is None else together[i]
            np.testing.assert_allclose(own, leaf, rtol=1e-15)
    assert axes.count(0) >= 1


REFUSED = {
    "no function": (dict(make=3), "Study.make: must be a function"),
    "no scene": (dict(make=lambda draw: draw), "is no (scene, start)"),
    "no start": (dict(make=lambda d: (small.rolled(d)[0], 1.0)), "is not what it must"),
    "a branch": (
        dict(make=lambda d: small.rolled(d) if d["mass"] > 1.4 else None),
        "cannot be traced by JAX",
    ),
    "nothing to see": (dict(observe=None), "leaves nothing to look at"),
    "no names": (dict(observe=energy), "must give functions names"),
    "a taken name": (dict(observe={"code": energy}), "is taken"),
    "a bad name": (dict(observe={"a/b": energy}), "is no name"),
    "one name twice": (
        dict(series={"energy": energy}),
        "Study.series['energy']: is called as Study.observe['energy'] is",
    ),
    "an event called as an observable": (
        dict(events=rk.Event(energy)),
        "Study.events[0]: is called as Study.observe['energy'] is, got 'energy'; give "
        "each its own name; an event without one, Event(..., name=...), takes that of",
    ),
    "an observable called as what is kept of an event": (
        dict(observe={"x time": energy}, events=rk.Event(energy, name="x")),
        "Study.observe['x time']: is called as what is kept of the event 'x'",
    ),
    "no observable": (dict(observe={"energy": 1.0}), "must be a function"),
    "text": (dict(observe={"a": lambda *at: "text"}), "cannot be used"),
    "complex": (dict(observe={"a": lambda *at: 1j}), "gives a complex"),
    "an index": (dict(observe={"a": lambda s, t, x: x.none}), "cannot be used"),
    "no event": (dict(events="nothing"), "is no event"),
    "no code": (dict(ends=(99,)), "is no code"),
    "times": (dict(times=[0.0, 0.0]), "times"),
    "drawn modes": (
        dict(modes=lambda draw: rk.Modes(friction=draw["mass"])),
        "Study.modes: must be Modes, the same for all members",
    ),
    "modes twice": (
        dict(make=lambda draw: (*small.rolled(draw), rk.Modes()), modes=rk.Modes()),
        "gives modes, which the study has, too",
    ),
    "no modes": (
        dict(make=lambda draw: (*small.rolled(draw), draw["mass"])),
        "is not what it must be",
    ),
    "a method": (dict(method="fast"), "is not known"),
    "no draws": (dict(distributions={}), "at least one distribution"),
    "no distribution": (dict(distributions={"mass": 1.0}), "must be a distribution"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_study_is_refused(name):
    given, said = REFUSED[name]
    known = {
        "make": small.rolled,
        "distributions": small.DRAWN,
        "times": small.TIMES,
        "observe": {"energy": energy},
    }
    with pytest.raises(rk.FieldError) as refused:
        UnitRuns(rk.Study(**known | given))
    assert said in str(refused.value)


RECORD = np.sin(np.arange(3000.0))


def numbered(
    mass=1.0,
    record=RECORD,
    level=0.04,
    scale=2.0,
    direction=0,
    end=0.1,
    low=1.0,
    names=("energy", "fast"),
    modes=None,
    made=None,
    ends=(),
    stops=False,
    **options,
):
    """A study in which every number can be another one."""

    def make(draw):
        pushed = rk.Force(lambda t, *at: along(jnp.asarray(record)[7] * t))
        scene = rk.Scene(small.ball(mass), loads=(rk.Gravity(), pushed))
        rate = along(draw["rate"])
        found = scene, rk.place(scene, small.UPRIGHT, rate, small.ORIGIN)
        return found if made is None else (*found, made)

    here = rk.Event(
        lambda *at: position(*at)[0] - level, direction=direction, name="here"
    )
    seen = dict.fromkeys(names, lambda *at: scale * energy(*at))
    drawn = {"rate": rk.Uniform(low, 2.0)}
    how = {"stop" if stops else "events": here} | options
    return rk.Study(make, drawn, [0.0, end], seen, modes=modes, ends=ends, **how)


# in the same table of options, or of names, as another one is
SELDOM = {"max_steps", "names", "ends", "low"}


@pytest.fixture(scope="module")
def known():
    return fingerprint(numbered())


CHANGED = {
    "mass": (dict(mass=1.0 + 1e-15), {"scene and start", "observables"}),
    "record": (dict(record=RECORD + 1e-15), {"scene and start"}),
    "level": (dict(level=0.05), {"events"}),
    "direction": (dict(direction=1), {"events"}),
    "stops": (dict(stops=True), {"events"}),
    "scale": (dict(scale=3.0), {"observables"}),
    "names": (dict(names=("fast", "energy")), {"observables"}),
    "end": (dict(end=0.2), {"times"}),
    "low": (dict(low=1.1), {"distributions rate low (1.0, not 1.1)"}),
    "ends": (dict(ends=(rk.Code.SURFACE_EDGE,)), {"ends"}),
    "modes": (dict(modes=rk.Modes(friction=0.2)), {"modes"}),
    "impact": (dict(made=rk.Modes(restitution=0.2, impact="newton")), {"modes"}),
    "rtol": (dict(rtol=1e-6), {"options rtol (None, not 1e-06)"}),
    "max_steps": (dict(max_steps=9), {"options max_steps (None, not 9)"}),
    "solver": (dict(solver=dfx.Tsit5()), set()),
}


@pytest.mark.parametrize("name", slow_but(CHANGED.keys() - SELDOM, CHANGED))
def test_every_number_changes_the_fingerprint(known, name):
    given, told = CHANGED[name]
    apart = set(differences(known, fingerprint(numbered(**given))))
    assert apart, "nothing is told"
    assert told <= apart, apart


def test_nothing_changes_it_where_nothing_changes(known):
    """Though every function is another object."""
    assert fingerprint(numbered()) == known


@pytest.mark.slow
@pytest.mark.parametrize(
    ("one", "other"),
    [
        (rk.Modes(friction=0.2), rk.Modes(friction=0.3)),
        (rk.Modes(friction=0.2), rk.Modes(friction=0.2, lifts=False)),
        (rk.Modes(restitution=0.2), rk.Modes(friction=0.2)),
    ],
)
def test_modes_are_told_apart(one, other):
    left, right = (fingerprint(numbered(modes=m))["modes"] for m in (one, other))
    assert left != right


def test_methods_are_told_apart_by_what_they_hold():
    class Own(dfx.Tsit5):
        tableau = dfx.Dopri5.tableau

    Own.__name__ = "Tsit5"
    chords = [dfx.Kvaerno5(dfx.VeryChord(rtol=r, atol=1e-3)) for r in (1e-3, 1e-4)]
    solvers = [dfx.Tsit5(), Own(), *chords]
    found = [fingerprint(numbered(solver=s))["options"]["solver"] for s in solvers]
    assert len(set(found)) == 4
    assert fingerprint(numbered(solver=dfx.Tsit5()))["options"]["solver"] == found[0]


def test_names_of_functions_do_not_change_it():
    """Two programs that are one, but for what their functions are called."""

    @jax.jit
    def one(x):  # with a comment
        return jnp.sin(x) * 2.0

    @jax.jit
    def other(y):
        return jnp.sin(y) * 2.0

    @jax.jit
    def third(y):
        return jnp.cos(y) * 2.0

    x = jnp.ones(3)
    assert digest_of_program(one, x) == digest_of_program(other, x)
    assert digest_of_program(one, x) != digest_of_program(third, x)
    both = lambda f, g: digest_of_program(lambda x: f(x) + g(x), x)
    assert both(one, third) != both(third, one)
    assert both(one, third) != both(one, one)
    large = [lambda x, c=c: x + jnp.asarray(c)[5] for c in (RECORD, RECORD[::-1])]
    assert digest_of_program(large[0], 1.0) != digest_of_program(large[1], 1.0)
    at = lambda n: lambda x: jax.lax.cond(x > 0.0, lambda x: x + n, lambda x: x, x)
    assert digest_of_program(at(1.0), 1.0) != digest_of_program(at(2.0), 1.0)
