"""Mistakes of a first evening: each is refused with the way out of it."""

import re
import warnings
from pathlib import Path

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rollkane as rk

LEVEL, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TIMES = [0.0, 0.1]
BALL = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
SCENE = rk.Scene(BALL)


def placed(turn=1.0, scene=SCENE):
    return rk.place(scene, LEVEL, (0.0, turn, 0.0), STILL)


START = placed()
WIRES = rk.Scene(rk.Body(1.0, np.eye(3), rk.Ring(0.4)), rk.Base(rk.Ring(1.5)))
ACROSS = (0.5**0.5, 0.5**0.5, 0.0, 0.0)  # it stands on the other
ON_WIRE = rk.place(WIRES, ACROSS, STILL, (1.5, 0.0, 0.0), base_normal=(0.0, 0.0, 1.0))


def empty(tree):
    return jax.tree.map(lambda x: jnp.zeros((0, *x.shape), x.dtype), tree)


IN_FLIGHT = rk.release(SCENE, LEVEL, STILL, (0.0, 0.0, 0.2), STILL)
REFUSED = {
    "a body in flight without modes": (
        lambda: rk.simulate(SCENE, IN_FLIGHT, TIMES),
        "simulate.start",
        r"in flight.*give modes=",
    ),
    "bodies in flight without modes": (
        lambda: rk.ensemble(SCENE, [IN_FLIGHT, IN_FLIGHT], TIMES),
        "simulate.start",
        r"in flight.*give modes=",
    ),
    "scene and start swapped": (
        lambda: rk.simulate(START, SCENE, TIMES),
        "simulate.scene",
        r"swapped: call simulate\(scene, start, ...\)",
    ),
    "swapped in an ensemble": (
        lambda: rk.ensemble([START], SCENE, TIMES),
        "ensemble.scene",
        "swapped: call ensemble",
    ),
    "no scene at all": (
        lambda: rk.simulate(BALL, START, TIMES),
        "simulate.scene",
        "not a Body.*give the Scene first",
    ),
    "a body placed without its scene": (
        lambda: rk.place(BALL, LEVEL, STILL, STILL),
        "place.scene",
        r"not a Body.*call place\(scene",
    ),
    "a solver's name": (
        lambda: rk.simulate(SCENE, START, TIMES, solver="Dopri8"),
        "simulate.solver",
        r"solver=diffrax\.Dopri8\(",
    ),
    "a solver's class": (
        lambda: rk.ensemble(SCENE, [START], TIMES, solver=dfx.Tsit5),
        "ensemble.solver",
        r"solver=diffrax\.Tsit5\(",
    ),
    "a solver of another name": (
        lambda: rk.simulate(SCENE, START, TIMES, solver="rk45 "),
        "simulate.solver",
        r"'rk45 '.*diffrax\.Dopri8\(",
    ),
    "a solver for its energy": (
        lambda: rk.keeping_energy(SCENE, solver="Tsit5"),
        "keeping_energy.solver",
        "diffrax.Tsit5",
    ),
    "another of diffrax's parts by its name": (
        lambda: rk.simulate(SCENE, START, TIMES, adjoint="BacksolveAdjoint"),
        "simulate.adjoint",
        r"adjoint=diffrax\.BacksolveAdjoint\(",
    ),
    "no members": (
        lambda: rk.ensemble(SCENE, empty(START), TIMES),
        "ensemble",
        "has no members.*give at least one",
    ),
    "an empty list": (
        lambda: rk.ensemble(SCENE, [], TIMES),
        "ensemble.starts",
        "has no members.*give at least one",
    ),
    "something else in a list": (
        lambda: rk.ensemble(SCENE, [START, LEVEL], TIMES),
        "ensemble.starts[1]",
        "is no State",
    ),
    "scenes of two forms": (
        lambda: rk.ensemble([SCENE, rk.Scene(BALL, loads=())], START, TIMES),
        "ensemble.scene[1]",
        "another form than the first.*ensemble of each form",
    ),
    "a wire that lands on a wire": (
        lambda: rk.simulate(WIRES, ON_WIRE, TIMES, modes=rk.Modes(restitution=0.5)),
        "Modes.restitution",
        "cannot land on a Ring.*Ring.*leave restitution out",
    ),
    "a graph that returns a pair": (
        lambda: rk.Graph(lambda x, y: (x, y)),
        "Graph.f",
        "returns a tuple of 2 values.*return one number alone",
    ),
    "a surface that returns a tuple": (
        lambda: rk.Parametric(lambda u, v: (u, v, 0.0 * u)),
        "Parametric.position",
        r"returns a tuple of 3 values.*array of shape \(3,\)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_a_remedy(name):
    act, field, says = REFUSED[name]
    with pytest.raises(rk.FieldError, match="(?s)" + says) as caught:
        act()
    assert caught.value.field == field


def test_a_place_off_the_base_is_told_as_it_was_written():
    """Was: as rounded to float32, 0.20000000298023224."""
    parts = jax.tree.map(lambda x: x.astype(jnp.float32), SCENE)
    with pytest.raises(rk.FieldError, match=r"got \(0.3, 0, 0.2\)"):
        rk.place(parts, LEVEL, STILL, (0.3, 0, 0.2))


def test_lists_are_stacked():
    """A list of states, or of scenes, is what stacking them by hand gives, exactly."""
    starts = [placed(1.0), placed(2.0)]
    by_hand = jax.tree.map(lambda *x: jnp.stack(x), *starts)
    listed, stacked = (rk.ensemble(SCENE, some, TIMES) for some in (starts, by_hand))
    assert len(np.unique(listed.final.position[:, 0])) == 2
    assert np.array_equal(listed.final.position, stacked.final.position)
    heavy = rk.Body(2.0, 0.02 * np.eye(3), rk.Sphere(0.1), (0.0, 0.0, -0.05))
    both = [SCENE, rk.Scene(heavy)]
    runs = rk.ensemble(both, START, TIMES)
    # either goes by its own steps of one tolerance, 1e-9, over 0.1 s
    for i, scene in enumerate(both):
        alone = rk.simulate(scene, START, TIMES).position[-1]
        assert np.allclose(runs.final.position[i], alone, atol=1e-8, rtol=0.0)


def test_a_list_of_states_is_followed_by_derivatives():
    """x = r w t of a ball that rolls: dx/dw = r t = 0.01 m s/rad, to 1e-9 steps."""

    def way(turn):
        runs = rk.ensemble(SCENE, [placed(turn), START], TIMES)
        return runs.final.position[0, 0]

    assert np.isclose(jax.grad(way)(2.0), 0.01, atol=1e-9, rtol=0.0)


# -- docs/mistakes.md ------------------------------------------------------------------

PAGE = (Path(__file__).parents[2] / "docs" / "mistakes.md").read_text()
ROW = re.compile(r"^\| (\d+) \| `(.+?)` \| (.+?) \| (.+) \|$", re.MULTILINE)
ROWS = {row[0]: row[1:] for row in ROW.findall(PAGE)}


@pytest.fixture(scope="module")
def names():
    """What the page's programs define, and a scene in single precision."""
    found = {}
    exec("".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)), found)
    single = lambda tree: jax.tree.map(lambda x: x.astype(jnp.float32), tree)
    both = single(found["scene"]), single(found["start"])
    found["scene32"], found["start32"] = both
    return found


def fixed_axes(state):
    """The angular velocity of a state on fixed axes."""
    x, y, z = np.asarray(state.orientation)[1:]
    turn = Rotation.from_quat([x, y, z, float(state.orientation[0])])
    return turn.as_matrix() @ np.asarray(state.angular_velocity)


# What a silent row's value is, which tells that it was taken as the page says.
SILENT = {
    "2": lambda state: (
        Rotation.from_quat(np.asarray(state.orientation), scalar_first=True).magnitude()
        == np.pi
    ),
    "4": lambda state: np.linalg.norm(state.angular_velocity) == 360.0,
    # orientations of 3-4-5 triangles: exact to some roundings of 9 rad/s
    "5": lambda state: (
        np.allclose(fixed_axes(state), [0, 0, 9], rtol=0, atol=1e-14)
        and abs(float(state.angular_velocity[2])) < 8.0
    ),
    "9": lambda body: body.inertia[0, 0] == 0.004 + 0.05**2,
    "24": lambda run: not run.succeeded and np.isnan(run.position[-1]).all(),
}


def test_the_page_has_twenty_rows_and_more():
    assert [int(number) for number in ROWS] == list(range(1, len(ROWS) + 1))
    assert len(ROWS) >= 20
    silent = {number for number, (_, happens, _) in ROWS.items() if "silent" in happens}
    assert silent == set(SILENT)


def test_a_run_ends_where_a_function_jumps(names):
    """F / (m + I / r^2) is the pushed ball's acceleration, which begins at 0.4 s."""
    mass, share = 1.0, 0.004 / 0.1**2
    # both runs are quadratic in time, their derivatives linear: some roundings of 1
    moved = -1.0 / (mass + share) * (1.0 - 0.4)
    np.testing.assert_allclose(names["moves"], moved, rtol=1e-14)
    push = lambda t, at, p: jnp.stack([jnp.where(t > p, 1.0, 0.0), 0.0, 0.0])

    def end_of(p):  # as the page says: silent
        loads = rk.Gravity(), rk.Force(push, parameters=p)
        run = rk.simulate(rk.Scene(names["ball"], loads=loads), names["start"], [0, 1])
        return run.position[-1, 0]

    assert jax.grad(end_of)(0.4) == 0.0


@pytest.mark.parametrize("number", ROWS)
def test_a_row_of_the_page(number, names, monkeypatch):
    written, happens, instead = ROWS[number]
    assert instead
    if number in SILENT:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert SILENT[number](eval(written, names))
        return
    kind, says = re.fullmatch(r'(\w+): "(.+)"', happens).groups()
    if kind == "FieldError":
        with pytest.raises(rk.FieldError, match=re.escape(says)):
            eval(written, names)
        return
    assert kind == "UserWarning"
    monkeypatch.setattr("rollkane.integration.integrate._warned", set())
    switched = jax.enable_x64(number != "1")  # a reader of row 1 has not set it
    with switched, pytest.warns(UserWarning, match=re.escape(says)):
        eval(written, names)
