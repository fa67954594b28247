"""Errors of fits take noise to be white; the report tells where it is not.

A ball that rolls on by itself is at ``r w t``: its speed w is known by one regression.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

RADIUS, SIGMA, COUNT = 0.1, 0.01, 401
TIMES = np.linspace(0.0, 1.0, COUNT)


def _noise(correlation, random):
    noise = random.standard_normal(COUNT)
    for k in range(1, COUNT):
        new = np.sqrt(1.0 - correlation**2) * noise[k]
        noise[k] = correlation * noise[k - 1] + new
    return SIGMA * noise


def _report(noise):
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(RADIUS)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 0.9, 0.0), (0.0, 0.0, 0.0))
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:1],
        jnp.asarray(RADIUS * TIMES + noise)[:, None],
        sigma=SIGMA,
    )
    record = rk.Record(TIMES, {"place": place})
    return rk.fit(scene, start, record, rk.Free("start.angular_velocity[1]")).report()


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_the_report_tells_how_much_larger_errors_may_be(correlation):
    random = np.random.default_rng(4)
    slopes = RADIUS * TIMES
    often = 1000
    off = [
        slopes @ _noise(correlation, random) / (slopes @ slopes) for _ in range(often)
    ]
    known = np.std(off) / (SIGMA / np.sqrt(slopes @ slopes))
    report = _report(_noise(correlation, random))
    if correlation == 0.0:
        assert abs(known - 1.0) < 4.0 / np.sqrt(2.0 * often)
        assert "alike" not in report
        return
    told = float(report.split("errors may be ")[1].split()[0])
    # of 401 samples r is 0.6 +- 0.04, and the factor has 6 %: three deviations; it is
    # told to two digits, and deviations of 1000 are good to 2 %
    assert abs(told / known - 1.0) < 0.22
    # those of exact samples are no noise
    assert "alike" not in _report(np.zeros(COUNT))
