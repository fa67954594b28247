"""What experiments would tell, against closed forms of a ball on a slope.

A ball of inertia k m r^2 with a force of m a along x is at ``r w t + a t^2 / (2 (1 +
k))``; of its spin about the vertical its place says nothing.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

RADIUS, FACTOR, PUSH, SPEED, SIGMA = 0.1, 0.4, 2.0, 0.5, 0.02
TIMES = np.linspace(0.1, 1.0, 10)


def _scene():
    inertia = FACTOR * RADIUS**2 * np.eye(3)
    gravity = rk.Gravity((PUSH, 0.0, -9.81))
    return rk.Scene(rk.Body(1.0, inertia, rk.Sphere(RADIUS)), loads=(gravity,))


def _start(scene):
    level, origin = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return rk.place(scene, level, (0.0, SPEED, 0.3), origin)


def _record(samples=0.0):
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:2],
        jnp.full((TIMES.size, 2), samples),
        sigma=SIGMA,
    )
    return rk.Record(TIMES, {"place": place}, start_time=0.0)


INERTIA = rk.Free("body.inertia", form="scale")


def _error(push):
    """Relative error of the inertia, w being found, too."""
    slope = -0.5 * push * TIMES**2 * FACTOR / (1.0 + FACTOR) ** 2
    taken = TIMES * (TIMES @ slope) / (TIMES @ TIMES)
    return SIGMA / np.linalg.norm(slope - taken)


@pytest.mark.parametrize(
    "prior",
    [
        None,
        pytest.param(((0.0, 0.5, 0.0), (1e6, 1e6, 0.1)), marks=pytest.mark.slow),
    ],
)
def test_experiments_improve_where_the_others_are_not_seen(prior):
    """A spin that no sample shows, or only a prior, does not end the ascent."""
    scene = _scene()
    free = [INERTIA, rk.Free("start.angular_velocity", prior=prior)]
    least, most = (PUSH, -0.1, -9.9), (1.5 * PUSH, 0.1, -9.7)
    found = rk.design_experiment(
        scene,
        _start(scene),
        _record(),
        free,
        wanted=["body.inertia"],
        vary=rk.Free("loads[0].acceleration", bounds=(least, most)),
        rtol=1e-10,
    )
    ends = found.history[0], found.score
    # runs are good to their tolerance, priors of 1e6 deviations count by 1e-12
    np.testing.assert_allclose(ends, -np.log([_error(PUSH), _error(most[0])]), 1e-7)
    assert float(found.scene.loads[0].acceleration[0]) == most[0]
    inertia = found.standard_errors["body.inertia"][0, 0] / RADIUS**2
    assert abs(inertia / (FACTOR * _error(most[0])) - 1.0) < 1e-7


@pytest.mark.parametrize("samples", [-3.0, 3.0])
def test_a_bound_makes_nothing_known_before_there_are_samples(samples):
    """A delay of zero, its least, had no error where samples led out of the bound."""
    scene = _scene()
    free = [INERTIA, rk.Free("place.delay", bounds=(0.0, 0.05))]
    known = scene, _start(scene), _record(samples), free
    found = rk.identifiability(*known, rtol=1e-10).standard_errors
    rate = PUSH / (1.0 + FACTOR)
    slopes = np.stack(
        [
            -0.5 * rate * TIMES**2 * FACTOR / (1.0 + FACTOR),
            -RADIUS * SPEED - rate * TIMES,
        ]
    )
    errors = SIGMA * np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    told = found["body.inertia"][0, 0] / (FACTOR * RADIUS**2), found["place.delay"]
    np.testing.assert_allclose(told, errors, rtol=1e-7)  # runs are good to 1e-10
    design = rk.design_experiment(*known, rtol=1e-10)
    np.testing.assert_allclose(design.standard_errors["place.delay"], errors[1], 1e-7)


def test_what_is_found_or_no_part_of_a_motion_is_not_varied():
    """Parts of what is free have no effect, and numbers of sensors make no motion."""
    scene = _scene()
    free = [INERTIA, rk.Free("start.angular_velocity")]
    known = scene, _start(scene), _record(), free
    for path, problem in (
        ("start.angular_velocity[1]", "part of"),
        ("place.delay", "no number of the start or scene"),
    ):
        vary = rk.Free(path, bounds=(0.0, 1.0))
        with pytest.raises(rk.FieldError, match=problem) as caught:
            rk.design_experiment(*known, wanted=["body.inertia"], vary=vary)
        assert caught.value.field == "design_experiment.vary"
