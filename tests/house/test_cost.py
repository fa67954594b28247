"""Deterministic costs: equations of a right-hand side, and number of compilations."""

import json
import logging
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from .. import problems

BASELINE = Path(__file__).parent / "cost_baseline.json"


def scenes():
    disc, stone = problems.disc(), problems.rattleback()
    bowl = rk.Base(rk.Graph(lambda x, y: 0.4 * x**2 + 0.2 * y**2))
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Ellipsoid((0.2, 0.15, 0.1)))
    in_bowl = rk.Scene(body, bowl)
    level = (1.0, 0.0, 0.0, 0.0)
    carried = rk.Implicit(lambda p: jnp.sum(p * p) - 0.04)
    blob = rk.Scene(rk.Body(1.0, 0.01 * np.eye(3), carried))
    on_ball = rk.Scene(body, rk.Base(rk.Sphere(1.0)))
    no_load = rk.Scene(body, loads=())
    spin, origin = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    return {
        "rolling-disc": disc,
        "rattleback": stone,
        "ellipsoid-in-bowl": (in_bowl, rk.place(in_bowl, level, spin, origin)),
        "ellipsoid-on-sphere": (
            on_ball,
            rk.place(on_ball, level, spin, (0.0, 0.0, 1.0)),
        ),
        "implicit-ball": (blob, rk.place(blob, level, spin, origin)),
        "no-load": (no_load, rk.place(no_load, level, spin, origin)),
    }


def equations(scene, start):
    def rhs(scene, state):
        return rk.rolling_derivative(scene, jnp.zeros(()), state)

    return len(jax.make_jaxpr(rhs)(scene, start).eqns)


@pytest.fixture(scope="module")
def counts():
    return {name: equations(*scene) for name, scene in scenes().items()}


def test_equations_do_not_grow(counts):
    """Fewer is welcome (write the new baseline); more needs a reason.

    jax counts its own wrappers differently from release to release, so the figures are
    kept by release.
    """
    baseline = json.loads(BASELINE.read_text())
    release = ".".join(jax.__version__.split(".")[:2])
    if release not in baseline:
        newest = baseline[max(baseline)]
        for name, count in counts.items():
            assert count < 1.2 * newest[name], name
    else:
        assert counts == baseline[release]


def test_gravity_is_not_in_a_scene_without(counts):
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Ellipsoid((0.2, 0.15, 0.1)))
    heavy = rk.Scene(body)
    start = rk.place(heavy, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    assert counts["no-load"] < equations(heavy, start)


def test_a_second_call_compiles_nothing(caplog):
    """Other numbers, same structure: scene, start, tolerance and times may change."""
    first, second = problems.disc(), problems.disc(5.0, 0.31)
    jax.clear_caches()  # whatever other tests of this process have compiled
    with jax.log_compiles(True), caplog.at_level(logging.WARNING):
        result = rk.simulate(*first, (0.0, 0.1, 0.2), rtol=1e-8)
        jax.block_until_ready((result.position, result.energy))
        assert any("Compiling" in message for message in caplog.messages)
        caplog.clear()
        times, tolerances = (0.0, 0.15, 0.3), {"rtol": 1e-9, "atol": 1e-12}
        result = rk.simulate(*second, times, **tolerances)
        jax.block_until_ready((result.position, result.energy))
    assert not [message for message in caplog.messages if "Compiling" in message]
