"""A scene and a start of two precisions run in the wider one, by either backend."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

TIMES = np.linspace(0.0, 0.5, 6)
WAYS = {
    "plain": {},
    "events": {"events": (rk.Event(lambda s, t, y: t - 0.2, name="later"),)},
    "modes": {"modes": rk.Modes(friction=0.3)},
    "paper": {"formulation": "euler_lagrange"},
}


def scene_and_start():
    """A rattleback, in double precision."""
    stone = rk.Body(
        1.0,
        np.array([[2e-4, -2e-5, 0.0], [-2e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]]),
        rk.Ellipsoid((0.2, 0.03, 0.02)),
        center_of_mass=(0.0, 0.0, -0.01),
    )
    scene = rk.Scene(stone)
    place = (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, -5.0), (0.0, 0.0, 0.0)
    return scene, rk.place(scene, *place)


def single(tree):
    """As it is where it was made before ``jax_enable_x64``."""
    narrow = lambda x: x.astype(np.float32) if x.dtype == np.float64 else x
    return jax.tree.map(narrow, tree)


def double(tree):
    """The same numbers in double precision."""
    wide = lambda x: x.astype(np.float64) if x.dtype == np.float32 else x
    return jax.tree.map(wide, tree)


@pytest.mark.parametrize("method", ["native", "diffrax"])
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("narrow", ["scene", "start"])
def test_mixed_precision_runs_in_the_wider_one(narrow, way, method):
    scene, start = scene_and_start()
    scene = single(scene) if narrow == "scene" else scene
    start = single(start) if narrow == "start" else start
    how = WAYS[way] | {"rtol": 1e-9, "method": method}
    mixed = rk.simulate(scene, start, TIMES, **how)
    same = rk.simulate(double(scene), double(start), TIMES, **how)
    assert mixed.code == 0
    assert mixed.position.dtype == jnp.float64
    # the same numbers by the same program
    assert np.array_equal(mixed.position, same.position)
    if way == "events":
        assert np.array_equal(mixed.events["later"].times, same.events["later"].times)


@pytest.mark.parametrize("way", WAYS)
def test_single_precision_stays_single(way):
    scene, start = map(single, scene_and_start())
    # with modes it holds: the onset of a slip is below single precision
    how = {"modes": rk.Modes(friction=3.0)} if way == "modes" else WAYS[way]
    run = rk.simulate(scene, start, TIMES, **how)
    assert (run.code, run.method) == (0, "native")
    assert run.position.dtype == jnp.float32
