"""Random runs that roll, slip, fly and land, checked by their outputs alone."""

import warnings

import numpy as np
import pytest

import rollkane as rk

from .. import outputs_alone
from ..carried_systems import System
from ..impact_by_scipy import impact
from ..outputs_with_modes import (
    FOUND,
    RESIDUAL,
    STEEP,
    Place,
    carrying,
    examined,
    released,
)

LIMITS = {
    # by the second run's steps; a slip that begins doubles it some times (8.5)
    "changes at other times": 1e-9,
    "depth in flight": 1e-9,  # m
    "off the surfaces": 1e-9,  # m
    "pull": 1e-6,  # N
    "out of the cone": 1e-8,
    "breakaway": STEEP,
    "rolls out of the cone": STEEP,
    "lift-off": 1e-4,  # N: a force of 100 N that vanishes within 1e-3 s
    "slip's end": 1e-6,  # m/s
    "impulse beside the contact": 1e-7,
    "impulse's torque": 1e-7,
    "impulse on what is carried": 1e-7,
}
# the law, the body, its base, the base's motion, and what is carried
QUICK = [
    ("rolling", "ball", "hoop", "rest"),
]
SLOW = [
    ("rolling", "ball", "plane", "rest", "spring"),
    ("rolling", "torus", "roller", "rest"),
    ("rolling", "ellipsoid", "hills", "sway"),
    ("rolling", "egg", "roller", "rest"),
    ("rolling", "torus", "tyre", "rest"),
    ("rolling", "ring", "ball", "sway"),
    ("rolling", "torus", "hoop", "rest"),
    ("rolling", "torus", "bowl", "spin"),
    ("rubber", "ball", "bowl", "sway"),
    ("rolling", "ball", "ball", "spin"),
    ("rolling", "ellipsoid", "tyre", "rock"),
    ("rubber", "ellipsoid", "plane", "rest"),
    ("rolling", "ellipsoid", "funnel", "rest"),
    ("rolling", "ball", "plane", "sway", "pendulum"),
    ("rolling", "ball", "bowl", "rock", "spring", "driven"),
    ("rolling", "torus", "hills", "spin", "two"),
    ("rubber", "ellipsoid", "plane", "sway", "two", "rotor"),
]


def limit(name):
    kind = name.split(",")[0]
    if kind in ("Newton", "Euler", "turning", "slip", "friction", "power", "force"):
        return RESIDUAL
    return LIMITS.get(name, FOUND)


@pytest.mark.parametrize(
    "case",
    [*QUICK, *(pytest.param(c, marks=pytest.mark.slow) for c in SLOW)],
    ids="-".join,
)
def test_runs_with_modes_obey_mechanics(case):
    (law, body, base, motion), system = case[:4], System(case[4:])
    scene = carrying(outputs_alone.scene_of(law, body, base, motion), system)
    changes = 0
    for seed in range(6):
        draw = np.random.default_rng([seed, 3])
        mu, e = draw.uniform(0.05, 0.5), draw.uniform(0.0, 0.9)
        hold = mu * draw.choice([1.0, 1.3])
        modes = rk.Modes(friction=mu, static_friction=hold, restitution=e)
        begin = outputs_alone.start_of if seed % 3 == 2 else released
        inside = 0.1 * draw.normal(size=system.count), draw.normal(size=system.count)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # contacts that pull, codes
            start = begin(scene, base, seed, inside)
            place = Place(law, body, base, motion, modes, system)
            run, found = examined(scene, start, place)
        changes += len(run.modes) - 1
        wrong = {k: x for k, x in found.items() if not x < limit(k)}
        assert not wrong, (seed, run.code, run.edges, run.modes, wrong)
    assert changes >= 2


def test_the_impact_that_is_compared_with_is_a_balls_by_hand():
    """A ball that slips all the time, and one that grips."""
    G = np.diag([3.5, 3.5, 1.0])
    slips = impact(G, np.array([10.0, 0.0, -1.0]), 0.2, 0.5)
    np.testing.assert_allclose(slips, [-0.2 * 1.5, 0.0, 1.5], rtol=1e-10, atol=1e-12)
    grips = impact(G, np.array([0.1, 0.0, -1.0]), 0.2, 0.5)
    np.testing.assert_allclose(grips, [-0.1 / 3.5, 0.0, 1.5], rtol=1e-9, atol=1e-12)
