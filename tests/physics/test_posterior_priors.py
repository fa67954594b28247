"""Priors of a posterior are densities of the numbers, not of their coordinates."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import rollkane as rk

RADIUS, INERTIA, SPREAD = 0.1, 0.004, 0.3
TIMES = np.linspace(0.0, 1.0, 5)


def _fit(*free):
    """Of a ball that rolls on by itself, whose places tell no mass and no inertia."""
    scene = rk.Scene(rk.Body(1.0, INERTIA * np.eye(3), rk.Sphere(RADIUS)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:1],
        RADIUS * TIMES[:, None],
        sigma=0.01,
    )
    known = rk.Record(TIMES, {"place": place})
    return rk.fit(scene, start, known, [*free, rk.Free("start.angular_velocity[1]")])


MASS = rk.Free("body.mass", prior=(1.0, SPREAD))
# of all nine entries, whose mean square is that of the factor
FACTOR = rk.Free(
    "body.inertia",
    form="scale",
    prior=(INERTIA * np.eye(3), SPREAD * INERTIA / np.sqrt(3.0)),
)


def test_volumes_of_numbers_in_their_coordinates():
    """Of a logarithm the number; of a rotation by a the square of sin(a/2) / (a/2)."""
    turn = rk.Free("start.orientation", prior=((1.0, 0.0, 0.0, 0.0), 0.1))
    found = _fit(MASS, FACTOR, turn)
    volume = found.problem.prior_volume()
    mass, factor, rotation = -0.7, 0.4, np.array([0.3, -1.1, 0.8])
    names = found.names
    assert names[:2] == ("body.mass", "body.inertia (factor)")
    first = found.problem.layout.start
    there = first.copy()
    there[:2] += mass, factor
    there[2:5] += rotation
    risen = float(volume(jnp.asarray(there)) - volume(jnp.asarray(first)))
    half = 0.5 * np.linalg.norm(rotation)
    # determinants of three by three: some roundings
    assert abs(risen - (mass + factor + 2.0 * np.log(np.sin(half) / half))) < 1e-12


@pytest.mark.slow
def test_what_only_priors_tell_has_their_distribution():
    """The density of logarithms let the mass run to zero."""
    draws = rk.posterior(_fit(MASS, FACTOR), draws=4000, warmup=300)
    factor = draws["body.inertia"][:, 0, 0] / INERTIA
    known = stats.truncnorm(-1.0 / SPREAD, np.inf, 1.0, SPREAD)
    for found in (draws["body.mass"], factor):
        # of 4000 draws an eighth are worth independent ones, at least: four deviations
        error = 4.0 * known.std() / np.sqrt(500.0)
        assert abs(found.mean() - known.mean()) < error
        assert abs(found.std() - known.std()) < error
        assert abs(np.median(found) - known.median()) < 1.3 * error
