"""Which numbers of a scene have an axis of members, and which all of them share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.simulation.ensemble_members import members_of

BALL = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
TIMES = [0.0, 0.5]
PUSH, TWIST = rk.Force((1.0, 0.5, 0.0), (0.0, 0.0, 0.05)), rk.Torque((0.1, 0.0, 0.2))
SQUARE = jnp.diag(jnp.array([1.0, 2.0, 2.5]))
TURNED = (0.0, 1.0, 0.0, 0.0)
RECORD = rk.RecordedMotion(np.linspace(0.0, 1.0, 4), np.ones((4, 3)))
INNER = rk.RollingBody(
    rk.Body(0.1, 1e-5 * np.eye(3), rk.Sphere(0.02)),
    rk.Sphere(0.08, inside=True),
    position=(0.0, 0.0, 0.0),
    rotation=TURNED,
)
# scenes whose fields are vectors and matrices, by what they belong to
SCENES = {
    "forces": rk.Scene(BALL, loads=(rk.Gravity(), PUSH, TWIST)),
    "drag": rk.Scene(BALL, loads=(rk.Drag(0.1, point=(0.0, 0.0, 0.01)),)),
    "a potential": rk.Scene(BALL, loads=(rk.Potential(lambda p: p @ p),)),
    "a turntable": rk.Scene(BALL, rk.Base(motion=rk.Spin(1.0, TURNED, (0, 0, 0)))),
    "a record": rk.Scene(BALL, rk.Base(motion=RECORD)),
    "an ellipsoid": rk.Scene(rk.Body(1.0, SQUARE, rk.Ellipsoid((1.0, 1.1, 1.2)))),
    "masses": rk.Scene(BALL, supported=rk.PointMasses((1, 2, 3), lambda a: 0 * SQUARE)),
    "a carried body": rk.Scene(
        BALL,
        supported=rk.SupportedBody(
            1.0, SQUARE, lambda a: SQUARE[0] * a[0], lambda a: jnp.eye(3)
        ),
    ),
    "a rolling body": rk.Scene(BALL, supported=INNER),
    "slipping": rk.Scene(BALL, contact=rk.Slipping(rk.StribeckFriction(0.2, 0.1, 1.0))),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_vectors_of_one_scene_are_shared_by_as_many_members(scene):
    """Whatever the count: a vector of three is none of three members."""
    start = start_of(BALL, 0)
    for count in range(1, 10):
        found = members_of(scene, lambda i: start, count)
        assert set(found.scene_axes) == {None}, count


def start_of(body, i):
    spin = jnp.array([0.0, 1.0, 0.0]) * (1.0 + i)
    return rk.place(rk.Scene(body), (1.0, 0, 0, 0), spin, (0.0, 0.0, 0.0))


def agrees(runs, alone):
    """Both keep 1e-9 a step, over some ten steps of motions of about 1 m."""
    for i, run in enumerate(alone):
        np.testing.assert_allclose(runs.position[i], run.position, atol=1e-7)


@pytest.mark.parametrize("count", [3, 4])
def test_constant_forces_are_shared(count):
    scene = SCENES["forces"]
    starts = [start_of(BALL, i) for i in range(count)]
    runs = rk.ensemble(scene, starts, TIMES)
    agrees(runs, [rk.simulate(scene, start, TIMES) for start in starts])


def pushed(force, torque):
    loads = rk.Gravity(), rk.Force(force), rk.Torque(torque)
    return rk.Scene(BALL, loads=loads)


@pytest.mark.parametrize("count", [3, 4])
def test_constant_forces_differ_where_vmap_makes_them(count):
    vectors = 0.1 * jnp.arange(3.0 * count).reshape(count, 3)
    scenes, start = jax.vmap(pushed)(vectors, -vectors), start_of(BALL, 0)
    runs = rk.ensemble(scenes, start, TIMES)
    alone = [rk.simulate(pushed(v, -v), start, TIMES) for v in vectors]
    agrees(runs, alone)


def by_function(push):
    """A force that closes over a number."""
    force = lambda t, point: push * jnp.array([1.0, 0.0, 0.0]) * jnp.cos(t)
    return rk.Scene(BALL, loads=(rk.Gravity(), rk.Force(force)))


def test_what_functions_close_over_is_asked_for():
    """It may have any shape; the refusal says what to do, and that is enough."""
    scenes, start = jax.vmap(by_function)(jnp.arange(4.0)), start_of(BALL, 0)
    with pytest.raises(rk.FieldError, match=r"scene_axes=.* 0 where every number"):
        rk.ensemble(scenes, start, TIMES)
    runs = rk.ensemble(scenes, start, TIMES, scene_axes=0)
    agrees(runs, [rk.simulate(by_function(k), start, TIMES) for k in range(4)])


def test_scenes_in_a_list_differ_in_parameters():
    """Each has its own: nothing is to be asked."""
    force = lambda t, point, push: push * jnp.array([1.0, 0.0, 0.0])
    loads = [rk.Force(force, parameters=float(k)) for k in range(3)]
    scenes = [rk.Scene(BALL, loads=(rk.Gravity(), load)) for load in loads]
    start = start_of(BALL, 0)
    runs = rk.ensemble(scenes, start, TIMES)
    agrees(runs, [rk.simulate(scene, start, TIMES) for scene in scenes])
